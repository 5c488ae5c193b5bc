"""Kernels that are kept on disk: compiled anew when what is compiled into them changes."""

import subprocess
import sys

INNER = """
from sysid._compile import part_of_kernels

@part_of_kernels
def inner(x):
    return {law}
"""
OUTER = """
from sysid._compile import called_by_kernels, compiled, compiled_for
from inner import inner
from limits import LIMIT

@compiled
def outer(x):
    return min(inner(x), LIMIT)

@called_by_kernels("f8(f8)")
def called(x):
    return inner(x)

@compiled_for("f8(f8)")
def at_once(x):
    return inner(x)
"""


def test_a_kernel_is_compiled_anew_when_one_that_it_calls_or_a_constant_changes(tmp_path):
    (tmp_path / "outer.py").write_text(OUTER)

    def result(law, limit):
        (tmp_path / "inner.py").write_text(INNER.format(law=law))
        (tmp_path / "limits.py").write_text(f"LIMIT = {limit}\n")
        asked = (
            "from outer import at_once, called, outer; "
            "print(outer(3.0), sum(outer.stats.cache_hits.values()), called.ctypes(3.0), called.cache_hits, "
            "at_once(3), sum(at_once.stats.cache_hits.values()))"
        )
        run = [sys.executable, "-B", "-c", asked]  # files are as long and as old to the second as before
        said = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
        return tuple(float(value) for value in said.stdout.split())

    assert result("2.0 * x", 100.0) == (6.0, 0, 6.0, 0, 6.0, 0)
    assert result("2.0 * x", 100.0) == (6.0, 1, 6.0, 1, 6.0, 1)
    assert result("4.0 * x", 100.0) == (12.0, 0, 12.0, 0, 12.0, 0)
    assert result("4.0 * x", 10.0) == (10.0, 0, 12.0, 0, 12.0, 0)
    assert result("4.0 * x", 10.0) == (10.0, 1, 12.0, 1, 12.0, 1)
