"""Table 2: times of the gradients as ratios in one run, compiled and in plain NumPy."""

import time
import tracemalloc
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from replications.borges import setting
from replications.borges.flops import ours
from sysid.local_linear import Experiment, Problem, blocked_cost
from sysid.local_linear import gradients as g
from sysid.local_linear.blocked import BLOCK
from sysid.local_linear.passes import fly, regressors
from sysid.local_linear.recursion import plain
from sysid.local_linear.structure import course

Floats = NDArray[np.float64]

NUMPY_SAMPLES = 40
"""Ratios of loops over time do not depend on their length, and plain NumPy takes seconds."""

LONG = 20_000


def one_by_one(A: Floats, C: Floats, drives: Floats, row: int, out: Floats, first: int, x: Floats) -> int:
    """Run each system of a batch by itself, as (19) and (31) are written."""
    for j in range(x.shape[1]):
        plain(A, C, drives[:, :, j : j + 1], row, out, first + j, x[:, j : j + 1])
    return 0


def best(
    task: Callable[[], object],
    seconds: float,
    least: int = 3,
    clock: Callable[[], float] = time.process_time,
) -> float:
    """Return the shortest processor time of some repetitions [s]; of tasks on one thread, unless told."""
    shortest, spent, count = np.inf, 0.0, 0
    while spent < seconds or count < least:
        begin = clock()
        task()
        took = clock() - begin
        shortest, spent, count = min(shortest, took), spent + took, count + 1
    return float(shortest)


def operations_a_second() -> float:
    """Return what the matrix product of this machine does on one processor."""
    matrix = np.random.default_rng(0).standard_normal((300, 300))
    return 2 * 300**3 / best(lambda: matrix @ matrix, 0.1, 10)


def problem(n_samples: int) -> tuple[Problem, Floats]:
    """Return the paper's problem at its start."""
    rng = np.random.default_rng(1)
    u, y, _ = setting.experiment(rng, "20-dB", n_samples)
    found = setting.problem_of(u, y, 1)
    larger = setting.problem_of(*setting.experiment(rng, "20-dB")[:2], 1)
    return found, setting.start(larger, rng)


def compiled_times(seconds: float) -> dict[str, float]:
    """Return times of all derivatives at N = 1000 [s]; weights and the elimination are there before."""
    found, eta = problem(setting.SAMPLES)
    at = found(eta)
    one, solution, G = at.courses[0], at.solution, at.gains()
    out = np.empty((setting.SAMPLES, found.sizes.n_outputs, found.sizes.n_eta))
    flight = fly(one, G)
    return {
        "1": best(lambda: g.approach_1(one, solution), seconds),
        "2a": best(lambda: g.approach_2a(one, solution), seconds),
        "2b": best(lambda: g.approach_2b(one, G, out=out, into=flight), seconds, 50),
        "exact": best(lambda: g.exact(one, solution, out=out), seconds, 10),
        "kaufman": best(lambda: g.kaufman(one, solution, out=out), seconds, 10),
        "adjoint": best(lambda: g.cost_gradient(one, solution, into=flight), seconds, 50),
    }


def numpy_times() -> dict[str, float]:
    """Return times of the paper's three approaches in plain NumPy, system by system [s]."""
    found, eta = problem(NUMPY_SAMPLES)
    at = found(eta)
    one, solution, G = at.courses[0], at.solution, at.gains()
    return {
        "1": best(lambda: g.approach_1(one, solution, respond=one_by_one), 0.0, 1),
        "2a": best(lambda: g.approach_2a(one, solution, respond=one_by_one), 0.0, 1),
        "2b": best(lambda: g.approach_2b(one, G, respond=one_by_one), 0.0, 3),
    }


def blocked_ratios(n_samples: int = LONG) -> dict[str, float]:
    """Return time and memory of the elimination in blocks beside the one of the whole Phi."""
    found, eta = problem(n_samples)
    experiment, y = found.experiments[0], found.y[0]

    def whole() -> float:
        phi = regressors(course(found.sizes, eta, experiment)).reshape(-1, found.sizes.n_linear)
        q, r = np.linalg.qr(phi)
        residual = y.ravel() - q @ (q.T @ y.ravel())
        return float(residual @ residual + 0.0 * r[0, 0])

    def blocks() -> float:
        return blocked_cost(found.sizes, eta, experiment, y).cost

    first, second = whole(), blocks()
    tracemalloc.start()
    blocks()
    extra = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    begin = time.process_time()
    whole()
    middle = time.process_time()
    blocks()
    end = time.process_time()
    return {
        "blocked_qr_cpu_ratio": (end - middle) / (middle - begin),
        "blocked_qr_extra_mb": extra,
        "blocked_qr_cost_difference": abs(second / first - 1.0),
        "blocked_qr_block": float(BLOCK),
    }


def ratios(smoke: bool = False) -> dict[str, float]:
    """Return the pinned ratios of times."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        speed = operations_a_second()
        compiled, by_numpy = compiled_times(0.05 if smoke else 0.3), numpy_times()
        long = blocked_ratios(LONG if smoke else 5 * LONG)
    bound = ours(setting.sizes(1), setting.SAMPLES)["approach-2b"] / speed
    traffic = 8.0 * setting.SAMPLES * setting.N_OUTPUTS * setting.sizes(1).n_eta
    return {
        "ratio_1_over_2b/compiled": compiled["1"] / compiled["2b"],
        "ratio_2a_over_2b/compiled": compiled["2a"] / compiled["2b"],
        "ratio_1_over_2b/numpy": by_numpy["1"] / by_numpy["2b"],
        "ratio_2a_over_2b/numpy": by_numpy["2a"] / by_numpy["2b"],
        "flop_ratio_2b": compiled["2b"] / bound,
        "exact_over_approach1": compiled["exact"] / compiled["1"],
        "kaufman_over_approach1": compiled["kaufman"] / compiled["1"],
        "adjoint_over_2b": compiled["adjoint"] / compiled["2b"],
        "seconds_2b/compiled": compiled["2b"],
        "gigabytes_a_second_2b": traffic / compiled["2b"] / 1e9,
        "gigaflops_of_matrix_product": speed / 1e9,
        **long,
    }


__all__ = ["Experiment", "blocked_ratios", "compiled_times", "numpy_times", "ratios"]
