import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from sysid.errors import UsageError
from sysid.statistics import BLOCK_ROWS, Moments, fold, quantiles, wilson_interval

PROBABILITIES = [0.0, 0.025, 0.25, 0.5, 0.9, 0.975, 1.0]


def same_bits(first: Moments, second: Moments) -> bool:
    return all(
        getattr(first, name).tobytes() == getattr(second, name).tobytes()
        for name in ("counts", "means", "scatter")
    )


def test_moments_agree_with_numpy_far_from_zero():
    rows = 1e9 + np.random.default_rng(1).normal(size=(5000, 3)) @ np.array([[1, 2, 0], [0, 1, 0], [0, 0, 3]])
    moments = fold([rows], 3)
    # A mean near 1e9 is rounded by 1e-7, and it meets a spread of 1 to 3: nothing else may be lost.
    exact = [math.fsum(column) / len(rows) for column in rows.T]
    np.testing.assert_allclose(moments.mean, exact, rtol=1e-15)
    np.testing.assert_allclose(moments.covariance, np.cov(rows, rowvar=False), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(moments.std, rows.std(axis=0, ddof=1), rtol=1e-7)
    np.testing.assert_allclose(moments.standard_error, stats.sem(rows), rtol=1e-7)
    np.testing.assert_array_equal(moments.covariance, moments.covariance.T)


def test_undefined_values_are_skipped_pair_by_pair():
    rng = np.random.default_rng(2)
    rows = rng.normal(loc=[5.0, 0.0, -1.0], size=(3000, 3))
    rows[:, 1] += rows[:, 0]
    rows[rng.random(rows.shape) < 0.2] = np.nan
    moments = fold([rows], 3)
    for i in range(3):
        for j in range(3):
            both = rows[~np.isnan(rows[:, i]) & ~np.isnan(rows[:, j])]
            assert moments.counts[i, j] == len(both)
            expected = np.cov(both[:, i], both[:, j])[0, 1]
            assert moments.covariance[i, j] == pytest.approx(expected, rel=1e-11, abs=1e-13)
    np.testing.assert_allclose(moments.mean, np.nanmean(rows, axis=0), rtol=1e-13)


@given(cuts=st.lists(st.integers(1, 3 * BLOCK_ROWS), max_size=6))
@settings(max_examples=25, deadline=None)
def test_fold_gives_the_same_bits_however_the_stream_is_cut(cuts):
    rows = np.random.default_rng(3).normal(size=(2 * BLOCK_ROWS + 77, 2))
    rows[5, 0] = np.nan
    pieces = np.split(rows, np.minimum(np.cumsum(cuts, dtype=int), len(rows)))
    assert same_bits(fold(pieces, 2), fold([rows], 2))


@given(
    rows=arrays(np.float64, (12, 2), elements=st.floats(-1e3, 1e3) | st.just(np.nan)),
    cut=st.integers(0, 12),
)
@settings(max_examples=60, deadline=None)
def test_merge_equals_one_pass(rows, cut):
    whole, merged = Moments.of(rows), Moments.of(rows[:cut]).merge(Moments.of(rows[cut:]))
    np.testing.assert_array_equal(merged.counts, whole.counts)
    # 12 numbers of up to 1e3: rounding of the sums and of the squares.
    np.testing.assert_allclose(merged.mean, whole.mean, atol=1e-12 * 1e3)
    np.testing.assert_allclose(merged.scatter, whole.scatter, atol=1e-13 * 12 * 1e6)


def test_moments_of_nothing_are_undefined():
    moments = fold([], 2)
    assert np.isnan(moments.mean).all()
    assert np.isnan(moments.std).all()
    single = fold([np.array([[1.0, 2.0]])], 2)
    assert single.mean.tolist() == [1.0, 2.0]
    assert np.isnan(single.std).all()


def check_quantiles(values, gather):
    pieces = np.array_split(values, 7)
    ours = quantiles(lambda: iter(pieces), PROBABILITIES, gather=gather)
    np.testing.assert_array_equal(ours, np.nanquantile(values, PROBABILITIES))


@pytest.mark.parametrize("gather", [1, 50, 10**6])
@pytest.mark.parametrize(
    "kind", ["normal", "ties", "constant", "undefined", "mixed-sign", "one", "two", "close", "wide"]
)
def test_quantiles_equal_numpy(kind, gather):
    rng = np.random.default_rng(4)
    values = {
        "normal": rng.normal(size=4001),
        "ties": rng.integers(-3, 4, size=4000).astype(float),
        "constant": np.full(1000, 0.1),
        "undefined": np.where(rng.random(3000) < 0.3, np.nan, rng.normal(size=3000)),
        "mixed-sign": np.array([0.0, -0.0, 1.0, -1.0, 5e-324, -5e-324, 0.0]),
        "one": np.array([2.5]),
        "two": np.array([2.5, -1.5]),
        "close": 1.0 + rng.integers(0, 50, size=5000) * 2.0**-52,
        "wide": rng.normal(size=999) * 10.0 ** rng.integers(-300, 300, size=999),
    }[kind]
    check_quantiles(values, gather)


@given(arrays(np.float64, st.integers(1, 60), elements=st.floats(allow_infinity=False)), st.integers(1, 20))
@settings(max_examples=100, deadline=None)
def test_quantiles_equal_numpy_for_any_numbers(values, gather):
    if np.isnan(values).all():
        return
    # Neighbours further apart than the largest number overflow, in NumPy too.
    with np.errstate(over="ignore", invalid="ignore"):
        check_quantiles(values, gather)


def test_quantiles_of_nothing_are_undefined_and_levels_are_checked():
    assert np.isnan(quantiles(lambda: [np.array([np.nan])], [0.5])).all()
    with pytest.raises(UsageError, match=r"probability 1\.5"):
        quantiles(lambda: [np.zeros(3)], [1.5])


def test_memory_of_fold_and_quantiles_does_not_grow_with_the_stream():
    def stream():
        rng = np.random.default_rng(5)
        for _ in range(200):
            yield rng.normal(size=(2000, 4))

    tracemalloc.start()
    fold(stream(), 4)
    quantiles(lambda: (rows[:, 0] for rows in stream()), [0.025, 0.5, 0.975], gather=4096)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # The stream has 12.8 MB; six histograms of 0.5 MB with their working copies are allowed.
    assert peak < 6e6


@pytest.mark.parametrize(("successes", "trials"), [(0, 10), (3, 10), (10, 10), (512, 1000)])
def test_wilson_interval_equals_scipy(successes, trials):
    expected = stats.binomtest(successes, trials).proportion_ci(0.99, method="wilson")
    assert wilson_interval(successes, trials, 0.99) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_wilson_interval_checks_its_arguments():
    assert wilson_interval(0, 0) == (0.0, 1.0)
    with pytest.raises(UsageError, match="11 successes in 10 trials"):
        wilson_interval(11, 10)
    with pytest.raises(UsageError, match="confidence 95"):
        wilson_interval(1, 10, 95)
