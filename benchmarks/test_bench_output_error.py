"""Output-error fits beside a hand-written fit with SciPy, in one run: time, and growth with the record."""

import numpy as np
import pytest
from scipy import signal
from scipy.optimize import least_squares

from sysid.data import make_record
from sysid.linear import choose_output_error, fit_output_error

A, B = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]


def simulated(n):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(n)
    return u, signal.lfilter(B, A, u) + 0.1 * rng.standard_normal(n)


@pytest.mark.parametrize("n", [10_000, 100_000, 1_000_000])
@pytest.mark.benchmark(group="order-2 output error")
def test_fit_from_automatic_starts(benchmark, n):
    record = make_record(*simulated(n), 1.0, split=np.full(n, "train"))
    fit = benchmark.pedantic(fit_output_error, (record, 2), rounds=3, warmup_rounds=1)
    assert np.allclose(fit.a, A, atol=0.01)


@pytest.mark.parametrize("n", [10_000, 100_000, 1_000_000])
@pytest.mark.benchmark(group="order-2 output error")
def test_hand_written_fit_started_near_the_truth(benchmark, n):
    u, y = simulated(n)

    def fit():
        return least_squares(
            lambda p: signal.lfilter([0.0, p[2], p[3]], [1.0, p[0], p[1]], u) - y,
            [-1.4, 0.6, 0.9, 0.4],
            method="lm",
        )

    result = benchmark.pedantic(fit, rounds=3, warmup_rounds=1)
    assert np.allclose(result.x[:2], A[1:], atol=0.01)


@pytest.mark.benchmark(group="choice of structure")
def test_choice_of_structure_for_100_000_rows(benchmark):
    record = make_record(*simulated(100_000), 1.0)
    choice = benchmark.pedantic(choose_output_error, (record,), rounds=1, warmup_rounds=1)
    assert choice.fit.order == 2
