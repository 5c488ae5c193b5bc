"""Fits behind a quantiser: each reading tells the cell in which the output was, and no more."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import Choice

QUANTISER = "out_quantisation"
# Readings tell their cells while the noise is below this share of the step.
LOUDEST = 0.25
# Readings that miss their counts by less, as a share of the step, are whole counts written with a few digits.
ROUNDING, TINY = 1e-6, 1e-300
# The output may miss its cell by these shares of the step, one search after the other.
WIDTHS = (0.1, 0.03, 0.01, 0.003)
ITERATIONS = 12
FIRST_DAMPING, LARGEST_DAMPING = 1e-3, 1e8
NEGLIGIBLE = 1e-6
LEAST_CURVATURE = 1e-6
# The sums over so many stretches of rows tell how far noise with a memory can pull the step.
STRETCHES = 30

# Steps that are looked for in readings: from so few to so many of them in all that was read, each so much
# smaller than the one before.  The mean on the circle is this far from its centre for noise of 0.19 steps.
FEWEST, MOST, FINER, PLAINLY = 3.0, 40.0, 1.01, 0.5
# So many of the readings are neither at the upper nor at the lower end.
LEAST_BETWEEN = 0.1

Output = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class Cells:
    """What readings in steps say about the output before the quantiser.

    Attributes
    ----------
    step : float
        One count.
    counts : ndarray, shape (n_rows,)
    noise : float
        Standard deviation of the readings about their counts.
    step_error : float
        Standard error of the step.
    """

    step: float
    counts: Floats
    noise: float
    step_error: float

    def widening(self, n_parameters: int, spread: float) -> float:
        """Return the factor by which a fit inside the cells scatters more than the noise alone would have it.

        Of n rows some place the output to about a step times n_parameters / n, whatever the noise.

        Parameters
        ----------
        n_parameters : int
        spread : float
            Standard deviation of the residual, by which the fit was said to scatter: it counts as the noise
            where the readings are whole counts, so that what noise there is came before the quantiser.

        Examples
        --------
        >>> Cells(1.0, np.zeros(400), 0.1, 0.0).widening(4, 0.1)
        1.4142135623730951
        >>> Cells(1.0, np.zeros(400), 0.0, 0.0).widening(4, 0.1)
        1.4142135623730951
        """
        noise = self.noise if self.noise > ROUNDING * self.step else spread
        return float(np.hypot(1.0, np.sqrt(n_parameters / self.counts.size) * self.step / max(noise, TINY)))


def cells_of(y: Floats, step: float) -> Cells | None:
    """Tell the cells of measured values; None where the noise hides them.

    The step is the one that fits the readings best, given their counts.

    Parameters
    ----------
    y : ndarray, shape (n_rows,)
    step : float
        Nearly one count.

    Examples
    --------
    >>> found = cells_of(np.array([0.99, 2.03, -1.01, 0.01, 3.02]), 1.02)
    >>> round(found.step, 3), found.counts
    (1.008, array([ 1.,  2., -1.,  0.,  3.]))
    """
    if not step > 0.0:
        return None
    counts = np.round(y / step)
    for _ in range(3):
        if not counts.any():
            return None
        step = float(y @ counts) / float(counts @ counts)
        if not step > 0.0:
            return None
        counts = np.round(y / step)
    misses = y - step * counts
    noise = float(np.std(misses))
    return Cells(step, counts, noise, _step_error(counts, misses)) if noise < LOUDEST * step else None


def are_steps(y: Floats) -> bool:
    """Tell whether measured values plainly stand at multiples of one step, whatever made them.

    Around a circle as long as the step, values of any other kind spread out evenly, so that their mean is
    near the centre.  Two ends at which values are held, some carried beyond them by noise, are no steps, nor
    is one place at which a body rests: those between the ends must show it, and those elsewhere.

    Parameters
    ----------
    y : ndarray, shape (n_rows,)

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> smooth, noise = rng.standard_normal((2, 500))
    >>> are_steps(smooth), are_steps(np.round(smooth / 0.8) * 0.8 + 0.1 * noise)
    (False, True)

    References
    ----------
    Mardia & Jupp (2000), Directional Statistics, section 6.3.
    """
    low, high = float(np.min(y)), float(np.max(y))
    if not high > low:
        return False
    for step in (high - low) / np.exp(np.arange(np.log(FEWEST), np.log(MOST), np.log(FINER))):
        between = y[(y > low + 0.5 * step) & (y < high - 0.5 * step)]
        if _at_multiples(between, step, y.size):
            counts = np.round(between / step)
            values, sizes = np.unique(counts, return_counts=True)
            inside = (counts > values[0]) & (counts < values[-1])
            elsewhere = counts != values[np.argmax(sizes)]
            if all(_at_multiples(between[rows], step, y.size) for rows in (inside, elsewhere)):
                return True
    return False


def _at_multiples(values: Floats, step: float, among: int) -> bool:
    """Tell whether values stand at multiples of a step, and are no few among so many."""
    return values.size > LEAST_BETWEEN * among and bool(
        abs(np.mean(np.exp(2j * np.pi / step * values))) > PLAINLY
    )


def place_of_quantiser(choices: Sequence[Choice]) -> int | None:
    """Return which effect is a quantiser, if the last one of the sensor is."""
    sensor = [place for place, choice in enumerate(choices) if choice.effect.port == "output"]
    return sensor[-1] if sensor and choices[sensor[-1]].name == QUANTISER else None


def read_cells(
    choices: Sequence[Choice], places: Sequence[slice], point: Floats, y: Floats
) -> tuple[Cells, int] | None:
    """Return what the readings say, and where the step stands, if a quantiser is the last of the sensor.

    Parameters
    ----------
    choices : sequence of Choice
    places : sequence of slice
        Where the parameters of each of them stand in a point.
    point : ndarray, shape (n_unknowns,)
    y : ndarray, shape (n_rows,)
        The readings.
    """
    quantiser = place_of_quantiser(choices)
    if quantiser is None:
        return None
    place = places[quantiser].start
    cells = cells_of(y, float(point[place]))
    return None if cells is None else (cells, place)


def _step_error(counts: Floats, misses: Floats) -> float:
    """Return the standard error of the step, the slope of the readings over their counts.

    Noise with a memory misses in the same sense while the counts stay the same: its sums over stretches
    of rows scatter more than single rows would have it.
    """
    pulls = counts * misses
    sums = np.array([stretch.sum() for stretch in np.array_split(pulls, min(STRETCHES, pulls.size))])
    size = float(np.linalg.norm(counts))
    return max(float(np.std(misses)), float(np.linalg.norm(sums)) / size) / size


def inside_cells(cells: Cells, output: Output, slopes: Output, start: Floats) -> Floats:
    """Return the parameters under which the output is in the cells that were read.

    The squared error behind a quantiser changes by jumps.  Here each row is taken to have missed its
    cell by a normal deviation, whose width falls from search to search; the logarithm of its likelihood is
    smooth and concave in the output, and Newton steps with the slopes of the output lead to its maximum.

    Parameters
    ----------
    cells : Cells
    output : callable
        Output before the quantiser at a point, shape (n_rows,); not finite where it diverges.
    slopes : callable
        Its derivative, shape (n_rows, n_parameters).
    start : ndarray, shape (n_parameters,)

    Returns
    -------
    ndarray, shape (n_parameters,)

    References
    ----------
    Wang, Yin, Zhang & Zhao (2010), System Identification with Quantized Observations.
    """
    point = start
    for share in WIDTHS:
        point = _most_likely(cells, share * cells.step, output, slopes, point)
    return point


def _most_likely(cells: Cells, width: float, output: Output, slopes: Output, start: Floats) -> Floats:
    low, high = (cells.counts - 0.5) * cells.step, (cells.counts + 0.5) * cells.step
    point, w = start, output(start)
    cost, slope, curvature = _missed(w, low, high, width)
    damping = FIRST_DAMPING
    for _ in range(ITERATIONS):
        J = slopes(point)
        scale = np.linalg.norm(J * np.sqrt(curvature)[:, np.newaxis], axis=0)
        scale[scale == 0.0] = np.inf
        J = J / scale
        H, g, before = J.T @ (curvature[:, np.newaxis] * J), J.T @ slope, cost
        if not (np.isfinite(H).all() and np.isfinite(g).all()):
            return point
        while damping < LARGEST_DAMPING:
            trial: Floats = point - np.linalg.solve(H + damping * np.eye(point.size), g) / scale
            w = output(trial)
            tried = _missed(w, low, high, width) if np.isfinite(w).all() else (np.inf, slope, curvature)
            if tried[0] < cost:
                point, damping = trial, max(0.1 * damping, 1e-12)
                cost, slope, curvature = tried
                break
            damping = max(10.0 * damping, 1e-6)
        else:
            return point
        if before - cost <= NEGLIGIBLE * before:
            return point
    return point


def _missed(w: Floats, low: Floats, high: Floats, width: float) -> tuple[float, Floats, Floats]:
    """Return the negative log-likelihood, its slope and its curvature by the output."""
    from scipy.special import log_ndtr

    a, b = (low - w) / width, (high - w) / width
    # The farther side is the small one: differences of large probabilities would lose their digits.
    flipped = a + b < 0.0
    near, far = np.where(flipped, -b, a), np.where(flipped, -a, b)
    # log(P(z < -near) - P(z < -far)) with near < far, both counted outwards.
    first, second = log_ndtr(-near), log_ndtr(-far)
    log_inside = first + np.log1p(-np.exp(np.minimum(second - first, -1e-300)))
    density_a = np.exp(-0.5 * a * a - 0.5 * np.log(2.0 * np.pi) - log_inside)
    density_b = np.exp(-0.5 * b * b - 0.5 * np.log(2.0 * np.pi) - log_inside)
    slope = -(density_a - density_b) / width
    curvature = slope**2 - (a * density_a - b * density_b) / width**2
    curvature = np.clip(curvature, LEAST_CURVATURE / width**2, 1.0 / width**2)
    return -float(log_inside.sum()), np.asarray(slope), np.asarray(curvature)
