"""Branch and bound beside brute force, the fast derivatives beside the printed ones, and beside differences.

Only ratios of times in one run mean anything; no time is asserted.  The figures are kept in ``extra_info``.
"""

import itertools
import time
from statistics import median

import numpy as np
import pytest
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from replications.lacy.exactness import brute_force
from replications.lacy.examples import ExampleRun
from replications.lacy.notation import Notation
from replications.lacy.setting import nonlinearity
from sysid.nonlinearities import sine
from sysid.wiener import Criterion, identify_wiener, maximum_likelihood

REPEATS = 7


def seconds(function, repeats=REPEATS):
    function()  # compiled and in the cache
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return times


def ratio(slow, fast):
    """Median of the ratios of runs side by side, with its quartiles."""
    ratios = np.divide(slow, fast)
    return tuple(float(q) for q in np.quantile(ratios, [0.5, 0.25, 0.75]))


@pytest.fixture(autouse=True)
def one_blas_thread():
    """Compare algorithms, not numbers of threads."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def table(capsys):
    """Print a line of a table past pytest's capture."""

    def line(text):
        with capsys.disabled():
            print(text)

    return line


def test_branch_and_bound_against_brute_force(benchmark, table):
    """Every sequence of 10 samples by a batched QR, against the search; then the 20 samples of the paper."""
    known = sine((-np.pi, np.pi))
    for seed in itertools.count():
        data = ExampleRun("sine", samples=12).experiment(np.random.default_rng(seed))
        if np.max(np.abs(data.y + data.w)) < np.pi:
            break
    preimage = known.preimage(data.z)
    sets = [preimage.lower[preimage.first[k] : preimage.first[k + 1]] for k in range(data.u.size)]
    sequences = np.array(list(itertools.product(*sets)))
    slow = seconds(lambda: brute_force(data.u, sequences, 2))
    fast = seconds(lambda: identify_wiener(data.u, data.z, known, 2))
    middle, low, high = ratio(slow, fast)
    table(
        f"\n12 samples, {len(sequences)} sequences: brute force takes {middle:.0f} ({low:.0f}-{high:.0f}) "
        "times as long"
    )
    benchmark.extra_info["brute_force_over_search"] = middle
    long = ExampleRun("sine").experiment(np.random.default_rng(0))
    whole = nonlinearity("sine")
    fit = benchmark.pedantic(identify_wiener, (long.u, long.z, whole, 2), rounds=REPEATS, warmup_rounds=1)
    benchmark.extra_info["nodes"] = fit.effort
    table(f"20 samples, {fit.preimage.regions} sequences: {fit.effort} nodes")


@pytest.mark.parametrize("samples", [30, 60, 120])
def test_fast_derivatives(benchmark, table, samples):
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2, samples))
    problem = Criterion(u, 2)
    printed = ratio(seconds(lambda: Notation(u, y, 2).gradient(y)), seconds(lambda: problem.gradient(y)))
    hessian = ratio(seconds(lambda: Notation(u, y, 2).hessian(y), 3), seconds(lambda: problem.hessian(y), 3))
    table(
        f"\n{samples} samples: the printed gradient takes {printed[0]:.0f} times as long, the printed "
        f"Hessian {hessian[0]:.0f} times"
    )
    benchmark.extra_info |= {
        "printed_over_fast_gradient": printed[0],
        "printed_over_fast_hessian": hessian[0],
    }
    benchmark(problem.gradient, y)


@pytest.mark.parametrize("case", ["dead-zone", "quantisation"])
def test_bounded_descent_against_scipy(benchmark, table, case):
    """Eight starts of ours against one of L-BFGS-B with the same gradient."""
    data = ExampleRun(case).experiment(np.random.default_rng(1))
    known = nonlinearity(case)
    preimage = known.preimage(data.z)
    problem = Criterion(data.u, 2)
    bounds = list(zip(preimage.lower, preimage.upper, strict=True))
    start = 0.5 * (preimage.lower + preimage.upper)

    def scipy():
        return minimize(problem.value, start, jac=problem.gradient, bounds=bounds, method="L-BFGS-B",
                        options={"maxiter": 1000, "ftol": 1e-14, "gtol": 1e-8})  # fmt: skip

    def ours():
        return identify_wiener(data.u, data.z, known, 2, relative=False)

    middle, low, high = ratio(seconds(scipy), seconds(ours))
    table(
        f"\n{case}: one start of L-BFGS-B takes {middle:.1f} ({low:.1f}-{high:.1f}) times as long as eight "
        f"of ours; costs {scipy().fun:.6g} and {ours().cost:.6g}"
    )
    benchmark.extra_info["scipy_over_ours"] = middle
    benchmark.pedantic(ours, rounds=REPEATS, warmup_rounds=1)


@pytest.mark.parametrize("case", ["dead-zone", "sign"])
def test_maximum_likelihood_beside_the_preimage_method(benchmark, table, case):
    data = ExampleRun(case).experiment(np.random.default_rng(2))
    known = nonlinearity(case)
    fit = identify_wiener(data.u, data.z, known, 2)
    preimage = seconds(lambda: identify_wiener(data.u, data.z, known, 2))
    likelihood = seconds(lambda: maximum_likelihood(data.u, data.z, known, fit))
    share = median(likelihood) / median(preimage)
    table(f"\n{case}: maximum likelihood adds {100 * share:.0f} % to the time of the preimage method")
    benchmark.extra_info["likelihood_over_preimage"] = share
    benchmark.pedantic(maximum_likelihood, (data.u, data.z, known, fit), rounds=REPEATS, warmup_rounds=1)
