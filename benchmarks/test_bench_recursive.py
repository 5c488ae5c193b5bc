"""Updates a second of the recursive estimators beside the same formulas in NumPy, in one run."""

import numpy as np
import pytest

from sysid.excitation import impulse_levels
from sysid.linear.simulation import simulate_polynomial
from sysid.nonlinearities import Segments
from sysid.recursive import Kaczmarz, ProjectionGradient, RecursiveLeastSquares, regressors

LEVELS = (-6.0, -3.0, 3.0, 6.0)
KINDS = (ProjectionGradient, Kaczmarz, RecursiveLeastSquares)


@pytest.fixture(scope="module")
def record():
    u = impulse_levels(LEVELS, 2, 1500)
    y = simulate_polynomial([0.0, 1.0, -2.0], [1.0, -1.5, 0.56], Segments(1, 2, 1, -2, 1, -2)(u))
    return u, y


def one_by_one(estimator, samples):
    for u, y in samples:
        estimator.update(u, y)


def plain_gradient(rows, outputs):
    theta = np.zeros(rows.shape[1])
    for row, y in zip(rows, outputs, strict=True):
        theta += row * (y - row @ theta) / (1.0 + row @ row)


def plain_least_squares(rows, outputs):
    theta, p = np.zeros(rows.shape[1]), 1e6 * np.eye(rows.shape[1])
    for row, y in zip(rows, outputs, strict=True):
        gain = p @ row / (1.0 + row @ p @ row)
        theta += gain * (y - row @ theta)
        p -= np.outer(gain, row @ p)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.benchmark(group="order 2, ten parameters, one call a sample")
def test_updates(benchmark, record, kind):
    samples = list(zip(*(signal.tolist() for signal in record), strict=True))
    kind(2, LEVELS).update(0.0, 0.0)
    benchmark.pedantic(lambda: one_by_one(kind(2, LEVELS), samples), rounds=5, warmup_rounds=1)
    benchmark.extra_info["updates_per_second"] = len(samples) / benchmark.stats.stats.min


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.benchmark(group="order 2, ten parameters, whole record")
def test_run(benchmark, record, kind):
    benchmark.pedantic(lambda: kind(2, LEVELS).run(*record, every=14), rounds=5, warmup_rounds=1)
    benchmark.extra_info["updates_per_second"] = record[0].size / benchmark.stats.stats.min


@pytest.mark.parametrize("peer", [plain_gradient, plain_least_squares])
@pytest.mark.benchmark(group="order 2, ten parameters, one call a sample")
def test_peer(benchmark, record, peer):
    rows = regressors(*record, 2, LEVELS)[:5000]
    benchmark.pedantic(peer, (rows, record[1][:5000]), rounds=3, warmup_rounds=1)
    benchmark.extra_info["updates_per_second"] = 5000 / benchmark.stats.stats.min
