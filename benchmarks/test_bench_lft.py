"""The separated search of an LFT model beside joint ones: time, how often the best minimum is found.

All methods see the same data and start in turns in one run; only ratios of times mean anything, and no
time is asserted.  The figures are kept in ``extra_info``.
"""

import time

import numpy as np
import pytest
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from sysid.lft import LftStructure, compare_problems, fit_lft, initial_estimate, lags, refine_free_run
from sysid.lft.problem import LftProblem
from sysid.lft.signals import signals_of, usable_rows
from sysid.lft.theorems import joint_jacobian, joint_search
from sysid.separable import project

STRUCTURE = LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=15)
DATA_SETS = 40
FOUND = 1e-6  # relative distance to the best cost known within which a minimum counts as found
SIZES = (1_000, 10_000, 100_000)


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


def data_set(seed, n=1000):
    rng = np.random.default_rng(seed)
    u, y, w = rng.uniform(-2.5, 2.5, n), np.zeros(n), np.zeros(n)
    for k in range(2, n):
        w[k] = np.arctan(0.53 * u[k - 1] - 0.848 * u[k - 2] - 1.0)
        y[k] = 0.4 * y[k - 1] + w[k] - 0.5 * w[k - 1] + 0.1 * rng.standard_normal()
    return u, y


def joint_start(problem, start):
    eta = np.concatenate([np.zeros(problem.n_tangents), start.g[1:]])
    return np.concatenate([eta, project(problem.regressors(eta), problem.y).theta])


def scipy_joint(problem, x):
    n_eta = problem.n_tangents + problem.structure.n_g
    found = least_squares(
        lambda p: problem.y - problem.regressors(p[:n_eta]) @ p[n_eta:],
        x,
        jac=lambda p: joint_jacobian(problem, p),
        x_scale="jac",
        max_nfev=200,
    )
    return 2.0 * found.cost


def test_separated_against_joint(benchmark, table):
    """From one start: whole fits by the separated search, and the joint searches alone."""
    methods = {
        "separated, exact": lambda data, problem, start: fit_lft(data, STRUCTURE, start=start).cost,
        "separated, Kaufman": lambda data, problem, start: (
            fit_lft(data, STRUCTURE, start=start, jacobian="kaufman").cost
        ),
        "joint": lambda data, problem, start: joint_search(problem, joint_start(problem, start), 200).cost,
        "joint, SciPy": lambda data, problem, start: scipy_joint(problem, joint_start(problem, start)),
    }
    seconds, costs = {name: [] for name in methods}, {name: [] for name in methods}
    for seed in range(DATA_SETS + 1):
        data = data_set(seed)
        start = initial_estimate(data, STRUCTURE)
        signals = signals_of(data)
        problem = LftProblem.of(signals, STRUCTURE, usable_rows(signals, STRUCTURE, None)).around(start.d)
        for name, method in methods.items():
            begin = time.perf_counter()
            costs[name].append(method(data, problem, start))
            seconds[name].append(time.perf_counter() - begin)
    best = np.min([values[1:] for values in costs.values()], axis=0)
    table("\nmethod               time over the first   best minimum found")
    for name in methods:
        ratio = np.quantile(np.divide(seconds[name][1:], seconds["separated, exact"][1:]), [0.5, 0.25, 0.75])
        share = float(np.mean(np.array(costs[name][1:]) <= best * (1.0 + FOUND)))
        table(f"{name:20s} {ratio[0]:6.2f} ({ratio[1]:.2f}-{ratio[2]:.2f})   {100 * share:6.0f} %")
        benchmark.extra_info[name] = {"time_ratio": float(ratio[0]), "found": share}
    conditions = compare_problems(data_set(0), STRUCTURE)
    benchmark.extra_info["condition"] = [conditions.condition_separated, conditions.condition_joint]
    benchmark.pedantic(fit_lft, (data_set(0), STRUCTURE), rounds=7, warmup_rounds=1)


@pytest.mark.parametrize("n", SIZES)
def test_time_grows_as_the_rows(benchmark, table, n):
    """Time of a fit, and of its refinement by the free run, over that of one with 1000 rows."""
    short, data = data_set(1), data_set(1, n)

    def seconds(rows):
        begin = time.perf_counter()
        fit = fit_lft(rows, STRUCTURE)
        middle = time.perf_counter()
        refine_free_run(rows, fit)
        return np.array([middle - begin, time.perf_counter() - middle])

    seconds(short)
    ratios = np.median([seconds(data) / seconds(short) for _ in range(3)], axis=0)
    table(f"\n{n} rows: {ratios[0]:.1f} times the fit of 1000 rows, {ratios[1]:.1f} times its refinement")
    benchmark.extra_info["over_1000_rows"] = ratios.tolist()
    benchmark.pedantic(fit_lft, (data, STRUCTURE), rounds=1)
