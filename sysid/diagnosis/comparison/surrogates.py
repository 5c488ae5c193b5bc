"""Contrasts of regions in a residual, beside those of series with the same memory and no regions."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.diagnosis.comparison.regions import Division
from sysid.diagnosis.comparison.series import Series
from sysid.linear.forms import Floats
from sysid.linear.kernels import polynomial_filter
from sysid.linear.uncertainty import autoregression

# Series of more rows are thinned: by then any contrast worth a sentence is significant.
MOST_ROWS = 25_000
# As many surrogates as so many rows in all allow, between these bounds.
DRAWS_ROWS = 12_000_000
MOST_DRAWS, FEWEST_DRAWS = 999, 499
SEED = 20_260
# Rows before a surrogate begins, so that its noise model has forgotten its start.
BURN_IN = 2_000


@dataclass(frozen=True)
class Contrasts:
    """What one statistic says about the regions of one division.

    Attributes
    ----------
    division : Division
    measure : {"free", "new"}
        Free-run error, or innovations of its autoregression.
    statistic : {"share", "pull"}
        Share of the squared error, or mean of the innovations' normal scores.
    error_share, data_share : ndarray, shape (n_regions,)
        Shares of the squared error of this measure, and of the rows.
    pull : ndarray, shape (n_regions,)
        Mean of the normal scores inside less that outside.
    effect : ndarray, shape (n_regions,)
        Share of the scores' variance that this contrast explains.
    z : ndarray, shape (n_regions,)
        Contrast in standard deviations of the surrogates.
    p_values : ndarray, shape (n_regions,)
        Corrected for all looks of one examination.
    """

    division: Division
    measure: str
    statistic: str
    error_share: Floats
    data_share: Floats
    pull: Floats
    effect: Floats
    z: Floats
    p_values: Floats


@dataclass(frozen=True)
class _View:
    """One measure of the error: values, what surrogates of it are made of, and the cells of its rows."""

    measure: str
    values: Floats
    innovations: Floats
    noise: Floats
    scores: Floats
    linear: Floats
    divisions: tuple[Division, ...]

    def contrasts(self, squared: Floats) -> Floats:
        """Return by how much the mean square inside each region exceeds that outside.

        The cube root makes mean squares nearly normal (Wilson and Hilferty, 1931).
        """
        found = []
        for division in self.divisions:
            share, data = division.share(squared), division.data_share
            inside, outside = share / np.maximum(data, 1e-12), (1.0 - share) / np.maximum(1.0 - data, 1e-12)
            found.append(np.cbrt(inside) - np.cbrt(np.maximum(outside, 0.0)))
        return np.concatenate(found)

    def pulls(self, scores: Floats) -> Floats:
        """Return the mean of scores inside each region less that outside.

        What depends linearly on inputs, output and velocity is taken out first: that is a matter of
        the linear dynamics, not of a region.
        """
        left = scores - self.linear @ (self.linear.T @ scores)
        found = []
        for division in self.divisions:
            sums = np.bincount(division.cell, left, minlength=division.members.shape[1]) / left.size
            mean, data = division.members @ sums, division.data_share
            found.append(mean / np.maximum(data, 1e-12) + mean / np.maximum(1.0 - data, 1e-12))
        return np.concatenate(found)

    def surrogate(self, generator: np.random.Generator) -> tuple[Floats, Floats]:
        """Return the two statistics of a series with the same memory that knows no regions."""
        order = generator.permutation(self.innovations.size)
        if self.measure == "new":
            return self.contrasts(self.innovations[order] ** 2), self.pulls(self.scores[order])
        n = self.values.size
        burn = min(BURN_IN, n)
        drawn = self.innovations[generator.integers(0, self.innovations.size, n + burn)]
        out = np.empty_like(drawn)
        b = np.zeros_like(self.noise)
        b[0] = 1.0
        polynomial_filter(b, self.noise, drawn, np.zeros(self.noise.size - 1), out)
        return self.contrasts(out[burn:] ** 2), np.empty(0)

    def observed(self) -> tuple[Floats, Floats]:
        """Return the two statistics of the residual itself."""
        if self.measure == "new":
            return self.contrasts(self.innovations**2), self.pulls(self.scores)
        return self.contrasts(self.values**2), np.empty(0)


def newly_arising(series: Series, length: int) -> tuple[Floats, NDArray[np.int64]]:
    """Return the innovations of means over so many rows, and the middle row of each."""
    means, rows = [], []
    for run in series.runs:
        count = (run.stop - run.start) // length
        if count == 0:
            continue
        whole = series.residual[run.start : run.start + count * length]
        means.append(whole.reshape(count, length).mean(axis=1))
        rows.append(run.start + np.arange(count) * length + length // 2)
    noise, _ = autoregression(means)
    skipped = noise.size - 1
    innovations = np.concatenate([_innovations(run, noise) for run in means])
    return innovations, np.concatenate([row[skipped:] for row in rows])


def examine(
    series: Series, divisions: Sequence[Division], progress: Callable[[int, int], None] | None
) -> tuple[Contrasts, ...]:
    """Compare the regions of all divisions, by the free-run error and by what newly arises.

    The null hypothesis is an autoregressive series whose innovations are drawn independently of
    everything else (Bühlmann, 1997, Sieve bootstrap for time series, Bernoulli 3).  Newly arising
    error are these innovations, those of single rows and those of means over a part of the motion's
    time scale: a force that the model lacks is small in each row and adds up.  P-values come from the
    largest standardised contrast over all regions, divisions and measures.

    Parameters
    ----------
    series : Series
    divisions : sequence of Division
    progress : callable or None
        Called with the number of draws done and to do.

    Returns
    -------
    tuple of Contrasts
        The evidence of free-run shares, one a division, comes first.
    """
    views = [_free_view(series, divisions)]
    views += [_new_view(series, divisions, length) for length in sorted({1, series.mean_length})]
    rows = sum(view.values.size for view in views)
    draws = int(np.clip(DRAWS_ROWS // rows, FEWEST_DRAWS, MOST_DRAWS))
    generator = np.random.default_rng(SEED)
    table = [_flat(view.observed() for view in views)]
    for done in range(draws):
        table.append(_flat(view.surrogate(generator) for view in views))
        if progress is not None and done % 25 == 24:
            progress(done + 1, draws)
    z, two_sided = np.array(table), _flat(_sides(view) for view in views) > 0.0
    # The residual is standardised with its surrogates: under the hypothesis it is one of them.
    z -= np.where(two_sided, 0.0, z.mean(axis=0))
    spread = np.sqrt((z**2).mean(axis=0))
    z /= np.where(spread > 1e-12, spread, np.inf)
    z = np.where(two_sided, np.abs(z), z)
    largest = np.sort(z.max(axis=1))
    p_values = 1.0 - np.searchsorted(largest, z[0] - 1e-12, side="left") / largest.size
    return _evidence(views, np.array(table[0]), z[0], p_values)


def _flat(pairs: Iterable[tuple[Floats, Floats]]) -> Floats:
    return np.concatenate([part for pair in pairs for part in pair])


def _sides(view: _View) -> tuple[Floats, Floats]:
    count = sum(len(division.regions) for division in view.divisions)
    return np.zeros(count), np.ones(count if view.measure == "new" else 0)


def _evidence(views: list[_View], raw: Floats, z: Floats, p_values: Floats) -> tuple[Contrasts, ...]:
    found, place = [], 0
    for view in views:
        squared = (view.values if view.measure == "free" else view.innovations) ** 2
        for statistic in ("share", "pull") if view.measure == "new" else ("share",):
            for division in view.divisions:
                part = slice(place, place + len(division.regions))
                data = division.data_share
                pull = raw[part] if statistic == "pull" else np.zeros(len(division.regions))
                original = division.source or division
                found.append(
                    Contrasts(
                        original,
                        view.measure,
                        statistic,
                        division.share(squared),
                        data,
                        pull,
                        pull**2 * data * (1.0 - data),
                        z[part],
                        p_values[part],
                    )
                )
                place = part.stop
    return tuple(found)


def _free_view(series: Series, divisions: Sequence[Division]) -> _View:
    step = -(-series.residual.size // MOST_ROWS)
    kept = np.arange(0, series.residual.size, step)
    values = np.ascontiguousarray(series.residual[kept])
    noise, _ = autoregression([values])
    return _View(
        "free",
        values,
        _innovations(values, noise),
        noise,
        np.empty(0),
        np.empty((0, 0)),
        tuple(division.on(division.cell[kept]) for division in divisions),
    )


def _new_view(series: Series, divisions: Sequence[Division], length: int) -> _View:
    """Return the view of the innovations of means over so many rows."""
    innovations, places = newly_arising(series, length)
    kept = np.arange(0, innovations.size, -(-innovations.size // MOST_ROWS))
    innovations, places = innovations[kept], places[kept]
    return _View(
        "new",
        innovations,
        innovations,
        np.ones(1),
        normal_scores(innovations),
        _linear_part(series, places),
        tuple(division.on(division.cell[places]) for division in divisions),
    )


def _innovations(values: Floats, noise: Floats) -> Floats:
    return np.convolve(values, noise, mode="valid") if values.size >= noise.size else np.empty(0)


def normal_scores(values: Floats) -> Floats:
    """Return the normal quantiles of the ranks: large values keep their order and lose their weight.

    Examples
    --------
    >>> import numpy as np
    >>> np.round(normal_scores(np.array([0.0, 1e6, -1.0])), 3)
    array([ 0.   ,  0.967, -0.967])
    """
    from scipy.special import ndtri

    ranks = np.empty(values.size)
    ranks[np.argsort(values, kind="stable")] = np.arange(values.size) + 0.5
    return np.asarray(ndtri(ranks / values.size))


def _linear_part(series: Series, places: NDArray[np.int64]) -> Floats:
    """Return an orthonormal basis of constant, inputs, output and velocity on some rows."""
    signals = np.column_stack(
        [np.ones(places.size), series.u[places], series.output[places], series.velocity[places]]
    )
    size = np.linalg.norm(signals, axis=0)
    left, values, _ = np.linalg.svd(signals / np.where(size > 0.0, size, 1.0), full_matrices=False)
    return np.ascontiguousarray(left[:, values > 1e-8 * values[0]])
