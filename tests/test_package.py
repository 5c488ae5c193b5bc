"""The public surface: every name loads, and importing the package is cheap."""

import subprocess
import sys

import pytest

import sysid


@pytest.mark.parametrize("name", sysid.__all__)
def test_every_public_name_loads(name):
    assert getattr(sysid, name) is not None
    assert name in dir(sysid)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        sysid.nonsense  # noqa: B018


def test_importing_the_package_loads_nothing_heavy():
    script = "import sys, sysid; print('numpy' in sys.modules)"
    shown = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "False"


def test_the_library_never_imports_replications():
    from pathlib import Path

    for file in Path(sysid.__file__).parent.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert "import replications" not in text, file
        assert "from replications" not in text, file


def test_kernels_are_compiled_where_no_folder_can_hold_their_cache(monkeypatch):
    from numba.core import caching

    from sysid._compile import compiled

    # As for a user who may write neither to the installed package nor to a home.
    monkeypatch.setattr(caching.FunctionCache._impl_class, "_locator_classes", [])

    @compiled
    def twice(value):
        return 2 * value

    assert twice(21) == 42
    assert twice.signatures
