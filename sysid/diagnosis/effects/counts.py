"""The step of a quantiser, read off the values that a measured signal takes."""

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Steps are looked for between these multiples of the deviation; finer ones hide in any noise.
SMALLEST, LARGEST = 0.05, 4.0
MOST_ROWS, MOST_STEPS = 1_000, 4_000
# Points in the reciprocal of the step for a turn of the phase at the largest value.
RESOLUTION = 8
KEPT = 3
# Of the values so many have another count from one step of a grid to the next, from this multiple of the
# deviation on: a finer step is lost in any noise where no gathering of the values shows it.
CHANGED, FINE_FROM, MOST_BETWEEN = 0.1, 0.25, 8
# A step that is read off twice differs by less, as a share: a search narrows it down between its neighbours.
APART = 0.02
# A sum of cosines of random phases has a deviation of the root of half their number.
SIGNIFICANT = 5.0


def counts(signal: Floats, *, shifted: bool = False) -> Floats:
    """Return the steps at whose multiples the values of a signal gather, the clearest first.

    The values are taken for angles that turn once in a step: where they gather at its multiples the mean
    of their cosines is large, by how much depends on the noise added after the quantiser.  The estimate
    needs no model, and the grid of a search is too coarse for it: a step that is off by a few per cent
    is off by half a count at large values.  A signal of few levels, or of an uneven distribution, may have
    gaps like those between counts, so these are steps to be tried, no evidence of a quantiser.

    Parameters
    ----------
    signal : ndarray, shape (n_samples,)
    shifted : bool
        Whether the values may gather beside the multiples, all by as much: what was added behind a quantiser.

    Returns
    -------
    ndarray, shape (n_found,)
        At most three; none where no step stands out.

    Examples
    --------
    >>> y = 0.3 * np.round(np.random.default_rng(0).standard_normal(900) / 0.3)
    >>> y += 0.04 * np.random.default_rng(1).standard_normal(900)
    >>> bool(np.abs(counts(y) - 0.3).min() < 0.002)
    True
    >>> bool(np.abs(counts(y + 0.1, shifted=True) - 0.3).min() < 0.002)
    True
    >>> counts(np.random.default_rng(2).standard_normal(900)).size
    0

    References
    ----------
    Widrow & Kollár (2008), Quantization Noise, chapter 4: the characteristic function of quantised values.
    """
    y = signal[:: max(signal.size // MOST_ROWS, 1)]
    deviation, largest = float(np.std(y)), float(np.abs(y).max(initial=0.0))
    if not deviation > 0.0 or not np.isfinite(largest):
        return np.empty(0)
    spacing = 1.0 / (RESOLUTION * largest)
    first, last = 1.0 / (LARGEST * deviation), 1.0 / (SMALLEST * deviation)
    reciprocals = first + spacing * np.arange(min(int((last - first) / spacing) + 2, MOST_STEPS))
    gathered = _gathered(2.0 * np.pi * first * y, 2.0 * np.pi * spacing * y, reciprocals.size, shifted)
    before, here, after = gathered[:-2], gathered[1:-1], gathered[2:]
    peaks = np.flatnonzero((here > before) & (here >= after) & (here > SIGNIFICANT / np.sqrt(2.0 * y.size)))
    peaks = peaks[np.argsort(-here[peaks], kind="stable")][:KEPT]
    bend = before[peaks] - 2.0 * here[peaks] + after[peaks]
    shift = np.where(bend < 0.0, 0.5 * (before[peaks] - after[peaks]) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.asarray(1.0 / (reciprocals[1 + peaks] + spacing * shift))


def closely(steps: Floats, signal: Floats) -> Floats:
    """Return a grid of steps so close that between two of them few values change their count.

    Next to the right step most values still have their counts, and from there a search finds it; farther off
    each value that has the count beside it costs more than the quantiser does, as if there were none.

    Parameters
    ----------
    steps : ndarray
        In rising order.
    signal : ndarray, shape (n_samples,)

    Examples
    --------
    >>> closely(np.array([0.5, 0.6, 4.0]), np.array([-1.0, 1.0])).round(2).tolist()[:5]
    [0.5, 0.53, 0.56, 0.6, 0.76]
    """
    size, deviation = float(np.sqrt(np.mean(signal**2))), float(np.std(signal))
    found = [steps[:1]]
    for low, high in itertools.pairwise(steps):
        changed = size / low - size / high if low >= FINE_FROM * deviation else 0.0
        found.append(np.geomspace(low, high, 1 + int(np.clip(changed / CHANGED, 1, MOST_BETWEEN)))[1:])
    return np.concatenate(found)


def counts_tried(signal: Floats) -> Floats:
    """Return the steps at whose multiples values gather, and those beside whose multiples they do.

    Examples
    --------
    >>> y = 0.3 * np.round(np.random.default_rng(0).standard_normal(900) / 0.3)
    >>> y += 0.04 * np.random.default_rng(1).standard_normal(900)
    >>> [float(np.sum(np.abs(counts_tried(y + c) - 0.3) < 0.005)) for c in (0.0, 0.1)]
    [1.0, 1.0]
    """
    plain, shifted = counts(signal), counts(signal, shifted=True)
    new = [step for step in shifted.tolist() if (np.abs(plain - step) > APART * step).all()]
    return np.concatenate([plain, new])


def _gathered(angles: Floats, steps: Floats, count: int, shifted: bool) -> Floats:
    """Return the mean over all angles of cos(angle + k step) for k = 0, 1, ..., count - 1.

    Or, of angles that are all ``shifted`` by as much, the size of the mean on the circle.

    The steps are taken in blocks, so that of each angle only twice the root of so many cosines are needed:
    cos(a + b) = cos(a) cos(b) - sin(a) sin(b).
    """
    block = int(np.ceil(np.sqrt(count)))
    coarse = angles + block * np.outer(np.arange(-(-count // block)), steps)
    fine = np.outer(np.arange(block), steps)
    sums = np.cos(coarse) @ np.cos(fine).T - np.sin(coarse) @ np.sin(fine).T
    if shifted:
        sums = np.hypot(sums, np.sin(coarse) @ np.cos(fine).T + np.cos(coarse) @ np.sin(fine).T)
    return np.asarray(sums.ravel()[:count] / angles.size)
