"""Stages that fit piecewise affine maps: against each other, and against what a user would take otherwise.

Ratios of one run, printed and kept in the ``extra_info`` of the benchmark's JSON file; no time is asserted.
The points are those of the maps of Pepona's examples 5.1 to 5.3, with jumps, a kink and uniform noise.
"""

import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from sysid.nonlinearities.piecewise_affine import (
    BoundedError,
    GlobalSearch,
    KPlane,
    global_search,
    label_error,
)
from sysid.nonlinearities.piecewise_affine.branch_and_bound import best_line_of_all
from sysid.nonlinearities.piecewise_affine.dichotomies import best_line
from sysid.nonlinearities.piecewise_affine.points import Points

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from piecewise_affine_cases import EXAMPLES

RUNS = 20
STAGES = {"bounded-error": BoundedError(0.3), "k-plane": KPlane(2), "global": GlobalSearch(2)}


@pytest.fixture
def table(capsys):
    """Print a line of a table past pytest's capture."""

    def line(text):
        with capsys.disabled():
            print(text)

    return line


def timed(call, cases):
    """Return the results and the CPU time of each call, the first one apart."""
    call(*cases[0])
    begin = time.process_time()
    results = [call(*case) for case in cases]
    return results, (time.process_time() - begin) / len(cases)


def cases_of(example, n=1000, runs=RUNS):
    n = 100 if example == "5.1" else n
    return [EXAMPLES[example](np.random.default_rng(seed), n) for seed in range(runs)]


@pytest.mark.parametrize("example", EXAMPLES)
def test_stages_side_by_side(example, benchmark, table):
    cases = cases_of(example)
    table(f"\nexample {example}, {len(cases[0][1])} points, {RUNS} runs")
    fastest = None
    for name, stage in STAGES.items():
        fits, took = timed(lambda z, w, _, stage=stage: stage(z, w, np.random.default_rng(0)), cases)
        fastest = fastest or took
        wrong = np.mean([label_error(fit.labels, case[2]) for fit, case in zip(fits, cases, strict=True)])
        table(f"  {name:14s} {took / fastest:6.2f} x bounded-error, {wrong:7.2%} of the labels wrong")
        benchmark.extra_info[f"{name}/time_ratio"] = took / fastest
        benchmark.extra_info[f"{name}/labels_wrong"] = wrong
    z, w, _ = cases[0]
    benchmark(lambda: STAGES["global"](z, w, np.random.default_rng(0)))


@pytest.mark.parametrize("n", [300, 1000, 3000])
def test_branch_and_bound_against_all_lines(n, benchmark, table):
    """Both are exact: one turns a line about every point, the other excludes most lines by a bound."""
    points = [Points.of(z, w, who="benchmark") for z, w, _ in cases_of("5.2", n, 5)]
    turned, slow = timed(lambda one: best_line(one.z, one.w, np.arange(one.n), 4), [(one,) for one in points])
    found, fast = timed(lambda one: best_line_of_all(one.z, one.w, 4), [(one,) for one in points])
    off = max(abs(a[0] / b[0] - 1) for a, b in zip(found, turned, strict=True))
    table(
        f"\n{n} points: all lines over branch and bound {slow / fast:.1f} in time, costs differ by {off:.0e}"
    )
    benchmark.extra_info["all_lines_over_branch_and_bound"] = slow / fast
    benchmark(lambda: best_line_of_all(points[0].z, points[0].w, 4))


@pytest.mark.parametrize("peer", ["pwlf", "piecewise_regression"])
def test_breakpoint_of_a_kink_beside_a_peer(peer, benchmark, table):
    """Both peers fit continuous pieces, by differential evolution and by Muggeo's iteration."""
    module = pytest.importorskip(peer, reason="the peer is not installed")

    def pwlf(z, w, _):
        return float(module.PiecewiseLinFit(z, w, seed=0).fit(2)[1])

    def piecewise_regression(z, w, _):
        fit = module.Fit(list(z), list(w), n_breakpoints=1, n_boot=10)
        found = fit.get_results()["estimates"]
        return float(found["breakpoint1"]["estimate"]) if found else np.nan

    cases = cases_of("5.1", runs=5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs, slow = timed({"pwlf": pwlf, "piecewise_regression": piecewise_regression}[peer], cases)
    ours, fast = timed(lambda z, w, _: float(global_search(z, w, 2).map.tau[0]), cases)
    table(
        f"\n{peer} over ours, 100 points: {slow / fast:.0f} in time; breakpoint off by "
        f"{np.nanmean(np.abs(theirs)):.3f} (continuous), ours by {np.mean(np.abs(ours)):.3f} (free to jump)"
    )
    benchmark.extra_info["time_ratio"] = slow / fast
    benchmark(lambda: global_search(cases[0][0], cases[0][1], 2))


def test_regions_beside_a_pipeline_of_scikit_learn(benchmark, table):
    """K-means on (z, w), a regression in each cluster, a logistic regression between them."""
    pytest.importorskip("sklearn", reason="scikit-learn is not installed")
    from sklearn.cluster import KMeans
    from sklearn.linear_model import LinearRegression, LogisticRegression
    from sklearn.preprocessing import scale

    def pipeline(z, w, _):
        both = scale(np.column_stack([z, w]))
        labels = KMeans(2, n_init=10, random_state=0).fit_predict(both)
        regions = LogisticRegression(C=100.0).fit(z, labels).predict(z)
        for i in range(2):
            LinearRegression().fit(z[regions == i], w[regions == i])
        return regions

    cases = cases_of("5.2", runs=10)
    theirs, slow = timed(pipeline, cases)
    ours, fast = timed(lambda z, w, _: KPlane(2)(z, w, np.random.default_rng(0)).labels, cases)
    wrong = [
        np.mean([label_error(a, c[2]) for a, c in zip(one, cases, strict=True)]) for one in (theirs, ours)
    ]
    table(f"\nK-means pipeline over k-plane: {slow / fast:.1f} in time")
    table(f"  labels wrong {wrong[0]:.1%}, ours {wrong[1]:.2%}")
    benchmark.extra_info["time_ratio"] = slow / fast
    benchmark(lambda: KPlane(2)(cases[0][0], cases[0][1], np.random.default_rng(0)))
