"""Statistics of streams: mergeable moments, exact quantiles, the Wilson interval."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.errors import UsageError

FloatArray = NDArray[np.float64]
KeyArray = NDArray[np.uint64]

BLOCK_ROWS = 1024
"""Rows of one step of `fold`: fixed, because the rounding of a sum depends on how it is cut."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Count, mean and covariance of the columns of a stream of rows.

    A NaN means "not defined": a column's mean and variance use the rows where it is defined, the covariance
    of two columns the rows where both are. Hence all three fields are matrices over pairs of columns.

    Parameters
    ----------
    counts : (n_columns, n_columns) int array
        Rows where both columns are defined.
    means : (n_columns, n_columns) array
        ``means[i, j]`` is the mean of column i over the rows where i and j are defined.
    scatter : (n_columns, n_columns) array
        Sum of the products of the deviations from these means.

    References
    ----------
    T. F. Chan, G. H. Golub, R. J. LeVeque, "Algorithms for computing the sample variance: analysis and
    recommendations", The American Statistician 37 (1983) 242-247, Eq. (2.1).

    Examples
    --------
    >>> low = Moments.of(np.array([[1.0, 0.0], [2.0, np.nan]]))
    >>> all_rows = low.merge(Moments.of(np.array([[6.0, 4.0]])))
    >>> all_rows.mean
    array([3., 2.])
    >>> all_rows.count
    array([3, 2])
    """

    counts: NDArray[np.int64]
    means: FloatArray
    scatter: FloatArray

    @classmethod
    def empty(cls, n_columns: int) -> "Moments":
        """Moments of no row at all."""
        shape = (n_columns, n_columns)
        return cls(np.zeros(shape, dtype=np.int64), np.zeros(shape), np.zeros(shape))

    @classmethod
    def of(cls, rows: FloatArray) -> "Moments":
        """Moments of the rows of an (n_rows, n_columns) array."""
        defined = ~np.isnan(rows)
        weights = defined.astype(np.float64)
        counts = np.einsum("ri,rj->ij", weights, weights)  # einsum: a fixed order of summation, no BLAS
        share = 1.0 / np.maximum(counts, 1.0)
        filled = np.where(defined, rows, 0.0)
        centre = filled.sum(axis=0) * np.diagonal(share)
        deviations = np.where(defined, rows - centre, 0.0)
        # Where every row is defined `shift` is zero up to rounding; otherwise it moves the marginal mean
        # to the mean over the common rows.
        shift = np.einsum("ri,rj->ij", deviations, weights) * share
        scatter = np.einsum("ri,rj->ij", deviations, deviations) - counts * shift * shift.T
        means = np.where(counts > 0.0, centre[:, np.newaxis] + shift, 0.0)
        return cls(counts.astype(np.int64), means, scatter)

    def merge(self, other: "Moments") -> "Moments":
        """Moments of the rows of both, as if they had been seen together."""
        counts = self.counts + other.counts
        weight = other.counts / np.maximum(counts, 1)
        step = other.means - self.means
        return Moments(
            counts,
            self.means + step * weight,
            self.scatter + other.scatter + step * step.T * (self.counts * weight),
        )

    @property
    def count(self) -> NDArray[np.int64]:
        """Rows where the column is defined, (n_columns,)."""
        return np.diagonal(self.counts).copy()

    @property
    def mean(self) -> FloatArray:
        """Mean of each column, (n_columns,); NaN where there is none."""
        return np.where(self.count > 0, np.diagonal(self.means), np.nan)

    @property
    def covariance(self) -> FloatArray:
        """Sample covariance, divisor n - 1, (n_columns, n_columns); NaN below two rows."""
        return np.where(self.counts > 1, self.scatter / np.maximum(self.counts - 1, 1), np.nan)

    @property
    def std(self) -> FloatArray:
        """Sample standard deviation, divisor n - 1, (n_columns,); NaN below two rows."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def standard_error(self) -> FloatArray:
        """Standard error of the mean, (n_columns,); NaN below two rows."""
        return self.std / np.sqrt(np.maximum(self.count, 1))

    def mean_square_about(self, reference: FloatArray) -> FloatArray:
        """Mean squared deviation from `reference` (n_columns,); NaN where there is no row."""
        spread = np.diagonal(self.scatter) / np.maximum(self.count, 1)
        return np.asarray(np.maximum(spread, 0.0) + (self.mean - reference) ** 2)


def fold(arrays: Iterable[FloatArray], n_columns: int) -> Moments:
    """Moments of a stream of rows, in bounded memory.

    The rows are cut anew into blocks of `BLOCK_ROWS`, so the result is the same to the bit however the
    stream was cut.

    Parameters
    ----------
    arrays : iterable of (n, n_columns) arrays
        The rows in their order; n may differ from array to array.
    n_columns : int
        Number of columns.

    Examples
    --------
    >>> rows = np.arange(6.0).reshape(3, 2)
    >>> fold([rows[:1], rows[1:]], 2).mean
    array([2., 3.])
    """
    total = Moments.empty(n_columns)
    for block in _cut(arrays, n_columns, BLOCK_ROWS):
        total = total.merge(Moments.of(block))
    return total


def _cut(arrays: Iterable[FloatArray], n_columns: int, size: int) -> Iterator[FloatArray]:
    """Cut a stream of rows into blocks of `size` rows; the last may be shorter."""
    block = np.empty((size, n_columns))
    filled = 0
    for array in arrays:
        taken = 0
        while taken < len(array):
            step = min(size - filled, len(array) - taken)
            block[filled : filled + step] = array[taken : taken + step]
            filled, taken = filled + step, taken + step
            if filled == size:
                yield block
                filled = 0
    if filled:
        yield block[:filled]


def quantiles(
    read: Callable[[], Iterable[FloatArray]], probabilities: Sequence[float], gather: int = 65536
) -> FloatArray:
    """Quantiles of a stream that is too long to hold, exact (NumPy's "linear" method).

    The stream is read two to five times. Each pass counts the values by the next 16 bits of an integer whose
    order is that of the numbers, among those that share the bits found so far; as soon as at most `gather`
    values are left they are collected and sorted. NaN values are skipped.

    Parameters
    ----------
    read : callable
        Starts a new pass over the stream: an iterable of (n,) arrays.
    probabilities : sequence of float
        Between 0 and 1.
    gather : int
        Largest number of values to hold.

    Returns
    -------
    (n_probabilities,) array
        NaN when no value is defined.

    Raises
    ------
    UsageError
        When a probability lies outside [0, 1].

    Examples
    --------
    >>> quantiles(lambda: [np.array([3.0, 1.0]), np.array([2.0])], [0.5, 0.75])
    array([2. , 2.5])
    """
    levels = np.asarray(probabilities, dtype=np.float64)
    for level in levels:
        if not 0.0 <= level <= 1.0:
            raise UsageError(f"the probability {level:g} of a quantile must lie between 0 and 1")
    histogram = _count_digits(read, {0}, depth=0)[0]
    count = int(histogram.sum())
    if count == 0:
        return np.full(levels.shape, np.nan)
    positions = (count - 1) * levels
    below = np.floor(positions)
    ranks = sorted({int(rank) for rank in below} | {min(int(rank) + 1, count - 1) for rank in below})
    values = dict(zip(ranks, _order_statistics(read, histogram, ranks, gather), strict=True))
    pairs = [(values[int(rank)], values[min(int(rank) + 1, count - 1)]) for rank in below]
    # NumPy's own interpolation between the two neighbours keeps the result equal to the bit.
    return np.array([np.quantile(pair, share) for pair, share in zip(pairs, positions - below, strict=True)])


_DIGIT_BITS = 16
_DIGITS = 64 // _DIGIT_BITS
_SIGN = np.uint64(1 << 63)


def _order_statistics(
    read: Callable[[], Iterable[FloatArray]], histogram: NDArray[np.int64], ranks: Sequence[int], gather: int
) -> list[float]:
    """Values of the given ranks (0 = smallest), given the counts of the first digit."""
    histograms = {0: histogram}
    targets = [(0, rank) for rank in ranks]  # bits found so far, rank among the values that share them
    for depth in range(1, _DIGITS + 1):
        sizes: dict[int, int] = {}
        for index, (prefix, rank) in enumerate(targets):
            ends = np.cumsum(histograms[prefix])
            digit = int(np.searchsorted(ends, rank, side="right"))
            size = int(histograms[prefix][digit])
            targets[index] = ((prefix << _DIGIT_BITS) | digit, rank - int(ends[digit]) + size)
            sizes[targets[index][0]] = size
        if depth == _DIGITS:
            break
        if sum(sizes.values()) <= gather:
            groups = _collect(read, set(sizes), depth)
            return [_number_of_key(int(groups[prefix][rank])) for prefix, rank in targets]
        histograms = _count_digits(read, set(sizes), depth)
    return [_number_of_key(prefix) for prefix, _ in targets]


def _count_digits(
    read: Callable[[], Iterable[FloatArray]], prefixes: set[int], depth: int
) -> dict[int, NDArray[np.int64]]:
    """For each prefix of `depth` digits, how often each next digit occurs."""
    base = 1 << _DIGIT_BITS
    shift = np.uint64(64 - (depth + 1) * _DIGIT_BITS)
    counts = {prefix: np.zeros(base, dtype=np.int64) for prefix in prefixes}
    for keys in _keys(read):
        for prefix, members in _members(keys, prefixes, depth):
            digits = ((members >> shift) & np.uint64(base - 1)).astype(np.int64)
            counts[prefix] += np.bincount(digits, minlength=base)
    return counts


def _collect(read: Callable[[], Iterable[FloatArray]], prefixes: set[int], depth: int) -> dict[int, KeyArray]:
    """For each prefix of `depth` digits, the sorted keys that begin with it."""
    parts: dict[int, list[KeyArray]] = {prefix: [] for prefix in prefixes}
    for keys in _keys(read):
        for prefix, members in _members(keys, prefixes, depth):
            parts[prefix].append(members)
    return {prefix: np.sort(np.concatenate(found)) for prefix, found in parts.items()}


def _members(keys: KeyArray, prefixes: set[int], depth: int) -> Iterator[tuple[int, KeyArray]]:
    if depth == 0:
        yield 0, keys
        return
    heads = keys >> np.uint64(64 - depth * _DIGIT_BITS)
    for prefix in prefixes:
        yield prefix, keys[heads == np.uint64(prefix)]


def _keys(read: Callable[[], Iterable[FloatArray]]) -> Iterator[KeyArray]:
    """Turn the defined numbers into unsigned integers of the same order."""
    for values in read():
        numbers = np.asarray(values, dtype=np.float64)
        bits = (numbers[~np.isnan(numbers)] + 0.0).view(np.uint64)  # + 0.0: -0.0 and 0.0 are one number
        yield np.where(bits & _SIGN, ~bits, bits | _SIGN)


def _number_of_key(key: int) -> float:
    bits = np.uint64(key)
    return float(np.where(bits & _SIGN, bits ^ _SIGN, ~bits).astype(np.uint64).view(np.float64))


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval for a share, right also near 0 and 1.

    Parameters
    ----------
    successes, trials : int
        0 <= successes <= trials.
    confidence : float
        Coverage probability, between 0 and 1.

    Returns
    -------
    low, high : float
        (0, 1) when there was no trial.

    Raises
    ------
    UsageError
        When the counts or the confidence are out of their range.

    References
    ----------
    E. B. Wilson, "Probable inference, the law of succession, and statistical inference", Journal of the
    American Statistical Association 22 (1927) 209-212.

    Examples
    --------
    >>> low, high = wilson_interval(0, 100)
    >>> round(low, 4), round(high, 4)
    (0.0, 0.037)
    """
    from scipy.special import ndtri

    if not 0 <= successes <= trials:
        raise UsageError(f"a share of {successes} successes in {trials} trials is not between 0 and 1")
    if not 0.0 < confidence < 1.0:
        raise UsageError(f"the confidence {confidence:g} must lie between 0 and 1, e.g. 0.95")
    if trials == 0:
        return 0.0, 1.0
    z = float(ndtri(0.5 + confidence / 2.0))
    share = successes / trials
    scale = 1.0 + z * z / trials
    centre = share + z * z / (2.0 * trials)
    half = z * math.sqrt(share * (1.0 - share) / trials + (z / (2.0 * trials)) ** 2)
    low = 0.0 if successes == 0 else (centre - half) / scale
    high = 1.0 if successes == trials else (centre + half) / scale
    return low, high
