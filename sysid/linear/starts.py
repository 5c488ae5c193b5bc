"""Where a search over the poles may start: least squares, Steiglitz-McBride, subspace, a grid."""

import itertools

import numpy as np

from sysid.linear.forms import Complexes, Floats, reflections_from_poles, section_coefficients
from sysid.linear.kernels import all_pole_filter
from sysid.linear.reduction import BLOCK_ROWS, Segment, Structure, solve
from sysid.separable.factor import fold

STEIGLITZ_MCBRIDE_ROUNDS = 8
GRID_FREQUENCIES = 8
GRID_DAMPING = (0.03, 0.2, 0.7)


def least_squares_poles(
    segments: tuple[Segment, ...], structure: Structure, prefilter: Floats | None = None
) -> Complexes:
    """Return the poles of the least-squares difference equation (ARX).

    With ``prefilter`` (reflection coefficients) both signals first pass 1/A of that filter: one
    round of Steiglitz and McBride (1965).
    """
    order, delay = structure.order, structure.delay
    triangle: Floats | None = None
    for segment in segments:
        y, moved = segment.y, np.ascontiguousarray(segment.u.T)
        if prefilter is not None:
            y = _filtered(y, prefilter)
            moved = np.stack([_filtered(channel, prefilter) for channel in moved])
        memory = max(order, delay + structure.n_numerator - 1)
        usable = _runs(segment.used, memory)
        if usable.size == 0:
            continue
        lagged = [y[usable - lag] for lag in range(1, order + 1)]
        lagged += [u[usable - lag] for u in moved for lag in range(delay, delay + structure.n_numerator)]
        level = np.ones(y.size) if prefilter is None else _filtered(np.ones(y.size), prefilter)
        lagged += [level[usable], y[usable]]
        rows = np.vstack(lagged)
        for first in range(0, usable.size, BLOCK_ROWS):
            triangle = fold(triangle, np.ascontiguousarray(rows[:, first : first + BLOCK_ROWS]))
    if triangle is None:
        return np.zeros(order, dtype=np.complex128)
    weights = solve(triangle[:-1, :-1], triangle[:-1, -1])
    return np.asarray(np.roots(np.concatenate([[1.0], -weights[:order]])), dtype=np.complex128)


def steiglitz_mcbride_poles(
    segments: tuple[Segment, ...], structure: Structure, poles: Complexes
) -> list[Complexes]:
    """Return the poles after each of a few rounds of Steiglitz and McBride."""
    rounds = []
    for _ in range(STEIGLITZ_MCBRIDE_ROUNDS):
        following = least_squares_poles(
            segments, structure, reflections_from_poles(_padded(poles, structure.order))
        )
        rounds.append(following)
        if following.size == poles.size and np.allclose(np.sort(following), np.sort(poles), rtol=1e-7):
            break
        poles = following
    return rounds


def pole_grid(order: int, n_rows: int) -> list[Complexes]:
    """Return a coarse grid of one pole or of pairs of poles, from the record's length to Nyquist.

    Frequencies are spaced evenly in the logarithm; pairs are lightly to well damped, or real.
    """
    frequencies = np.geomspace(2.0 / n_rows, 2.0, GRID_FREQUENCIES)  # [rad/sample]
    real = np.exp(-frequencies)
    if order == 1:
        return [np.array([pole], dtype=np.complex128) for pole in real]
    pairs = [np.array(pair, dtype=np.complex128) for pair in itertools.combinations(real, 2)]
    for frequency, damping in itertools.product(frequencies, GRID_DAMPING):
        pole = np.exp(frequency * (-damping + 1j * np.sqrt(1.0 - damping**2)))
        pairs.append(np.array([pole, pole.conjugate()]))
    return pairs


def _padded(poles: Complexes, order: int) -> Complexes:
    """Return exactly ``order`` poles: ``numpy.roots`` leaves out those at zero."""
    return np.concatenate([poles, np.zeros(order - poles.size)])


def _runs(
    used: np.ndarray[tuple[int], np.dtype[np.bool_]], memory: int
) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """Return the used rows that have ``memory`` rows before them."""
    rows = np.flatnonzero(used)
    return rows[rows >= memory]


def _filtered(signal: Floats, reflections: Floats) -> Floats:
    a1, a2 = section_coefficients(reflections)
    out = np.empty_like(signal)
    all_pole_filter(signal.copy(), a1, a2, np.zeros((a1.size, 2)), out)
    return out
