"""Derivatives of composite local linear models: against each other, the machine's bounds, and JAX.

Ratios of one run, printed and kept in the ``extra_info`` of the benchmark's JSON file; no time is asserted.
"""

import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest

from replications.borges import flops, peer, timing
from sysid.local_linear import Experiment, Sizes, blocked_cost
from sysid.local_linear import gradients as g
from sysid.local_linear.passes import fly, regressors, sensitivities
from sysid.local_linear.structure import course
from sysid.separable import BlockedQR

LENGTHS = (1_000, 10_000, 100_000, 1_000_000)
STATES, MODELS = (2, 3, 4, 8, 16), (2, 4, 8, 16)
STRETCH = 1_000
LONG = 1_000_000


@pytest.fixture
def table(capsys):
    """Print a line of a table past pytest's capture."""

    def line(text):
        with capsys.disabled():
            print(text)

    return line


@pytest.fixture(autouse=True)
def one_thread():
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


def case(n, s, n_samples, m=2, p=2, q=1):
    """Return sizes, eta, an experiment and G of a random stable model."""
    rng = np.random.default_rng(n * 100 + s)
    sizes = Sizes(n, s, m, p, q)
    A = rng.standard_normal((s, n, n))
    A *= 0.7 / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    centres = rng.uniform(-1, 1, (s, q))
    eta = sizes.pack(A, rng.standard_normal((p, n)), rng.uniform(1, 2, (s, q)), centres)
    u = rng.uniform(-1, 1, (n_samples, m))
    return sizes, eta, Experiment.of(u, u[:, :q]), rng.standard_normal((n, sizes.channels))


def bound(sizes, n_samples, speed):
    return flops.ours(sizes, n_samples)["approach-2b"] / speed


def test_derivatives_side_by_side(benchmark, table):
    found = timing.ratios()
    table("\nderivatives at N = 1000, n = 3, s = 4 (one run)")
    for name, value in found.items():
        table(f"  {name:32s} {value:10.4g}")
    benchmark.extra_info.update(found)
    _, eta, experiment, G = case(3, 4, 1000)
    one = course(Sizes(3, 4, 2, 2, 1), eta, experiment)
    out = np.empty((1000, 2, 50))
    benchmark(lambda: g.approach_2b(one, G, out=out))


def test_time_grows_as_the_record(benchmark, table):
    """Long records pass in stretches whose states go on, so that the result is never held whole."""
    speed = timing.operations_a_second()
    table(f"\n2b by length, n = 3, s = 4; matrix product {speed / 1e9:.0f} Gflop/s")
    table(f"{'N':>9s} {'ns/step':>9s} {'/bound':>7s}")
    for n_samples in LENGTHS:
        sizes, eta, experiment, G = case(3, 4, n_samples)
        one = course(sizes, eta, experiment)
        out = np.empty((STRETCH, 2, sizes.n_eta))

        def stretches(one=one, G=G, sizes=sizes, out=out, n_samples=n_samples):
            state, flight = (np.zeros((3, 3, 12)), np.zeros((3, 8))), None
            for first in range(0, n_samples, STRETCH):
                rows = slice(first, first + STRETCH)
                part = type(one)(sizes, one.local, one.C, one.weights[rows], one.slopes[rows], one.A[rows],
                                 one.z[rows], one.inputs[rows])  # fmt: skip
                start = None if flight is None else flight.x[-1].copy()
                flight = fly(part, G, start, into=flight)
                sensitivities(part, flight, state=state, out=out)

        took = timing.best(stretches, 0.5)
        ratio = took / bound(sizes, n_samples, speed)
        table(f"{n_samples:9d} {1e9 * took / n_samples:9.1f} {ratio:7.2f}")
        benchmark.extra_info[f"flop_ratio_2b/N={n_samples}"] = ratio
    benchmark.pedantic(stretches, rounds=1)


def test_where_the_cache_ends(benchmark, table):
    speed = timing.operations_a_second()
    table("\n2b over its bound at N = 1000, by states n and local models s (MB written in brackets)")
    table("  n " + "".join(f"{'s = ' + str(s):>16s}" for s in MODELS))
    for n in STATES:
        cells = []
        for s in MODELS:
            sizes, eta, experiment, G = case(n, s, 1000)
            one = course(sizes, eta, experiment)
            out = np.empty((1000, 2, sizes.n_eta))
            flight = fly(one, G)
            took = timing.best(
                lambda one=one, G=G, out=out, flight=flight: g.approach_2b(one, G, out=out, into=flight), 0.1
            )
            ratio = took / bound(sizes, 1000, speed)
            cells.append(f"{ratio:8.2f} ({out.nbytes / 1e6:4.1f})")
            benchmark.extra_info[f"flop_ratio_2b/n={n}/s={s}"] = ratio
        table(f"{n:3d} " + "".join(f"{cell:>16s}" for cell in cells))
    benchmark.pedantic(lambda: g.approach_2b(one, G, out=out), rounds=3)


def test_elimination_in_blocks(benchmark, table):
    """A million samples, Phi of 2,000,000 by 36: the whole Phi by QR against blocks by R alone."""
    sizes, eta, experiment, _ = case(3, 4, LONG)
    y = np.random.default_rng(1).standard_normal((LONG, 2))

    def whole():
        phi = regressors(course(sizes, eta, experiment)).reshape(-1, sizes.n_linear)
        q, _ = np.linalg.qr(phi)
        residual = y.ravel() - q @ (q.T @ y.ravel())
        return residual @ residual

    blocked_cost(sizes, eta, Experiment(experiment.inputs[:3000], experiment.scheduling[:3000]), y[:3000])
    begin = time.process_time()
    expected = whole()
    middle = time.process_time()
    found = blocked_cost(sizes, eta, experiment, y).cost
    end = time.process_time()
    tracemalloc.start()
    blocked_cost(sizes, eta, experiment, y)
    extra = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    ratios = {
        "blocked_qr_cpu_ratio": (end - middle) / (middle - begin),
        "blocked_qr_extra_mb": extra,
        "blocked_qr_cost_difference": abs(found / expected - 1),
    }
    words = ", ".join(f"{name} {value:.3g}" for name, value in ratios.items())
    table(f"\nelimination at N = 1e6, in blocks over whole: {words}")
    benchmark.extra_info.update(ratios)
    factor = BlockedQR(sizes.n_linear)
    benchmark.pedantic(lambda: factor.update(np.ones((2000, sizes.n_linear))), rounds=3)


START = """
import time
begin = time.perf_counter()
from replications.borges import timing
from sysid.local_linear import gradients as g
imported = time.perf_counter()
problem, eta = timing.problem(200)
at = problem(eta)
g.exact(at.courses[0], at.solution)
print(imported - begin, time.perf_counter() - imported)
"""


def test_first_call_and_the_cache(benchmark, table, tmp_path, monkeypatch):
    """A process that compiles, and one that starts from what the first left on disk."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for name in ("first call, compiling", "second process, from the cache"):
        ran = subprocess.run([sys.executable, "-c", START], capture_output=True, text=True, check=True)
        imported, called = map(float, ran.stdout.split())
        table(f"\n{name}: import {imported:.1f} s, regressors and exact Jacobian {called:.1f} s")
        benchmark.extra_info[name] = called
    benchmark.pedantic(lambda: None, rounds=1)


def test_jax_beside_ours(benchmark, table):
    pytest.importorskip("jax", reason="the peer comes with the extra `benchmark`")
    found = peer.times()
    assert found["jax_difference"] < 1e-9
    benchmark.extra_info.update(found)
    table(f"\nJAX (jit, jacfwd, scan) over ours, 2b at N = 1000: {found[peer.NAME]:.1f}")
    table(f"first call of JAX {found['jax_compiling_seconds']:.1f} s")
    sizes, eta, experiment, G = case(3, 4, 1000)
    out = np.empty((1000, 2, sizes.n_eta))
    benchmark(lambda: g.approach_2b(course(sizes, eta, experiment), G, out=out))
