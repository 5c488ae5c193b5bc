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
SUBSPACE_ROWS = 30_000


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


def subspace_poles(segments: tuple[Segment, ...], orders: range) -> dict[int, Complexes]:
    """Return poles of each order from one past-output subspace factorisation (PO-MOESP).

    Source: Verhaegen (1994), Identification of the deterministic part of MIMO state space models
    given in innovations form from input-output data, Automatica 30(1).
    """
    depth = max(orders) + 4
    triangle: Floats | None = None
    n_inputs = segments[0].u.shape[1]
    rows_left = SUBSPACE_ROWS
    for segment in segments:
        if rows_left <= 0:
            break
        usable = _runs(segment.used, 2 * depth - 1)[:rows_left]
        rows_left -= usable.size
        if usable.size == 0:
            continue
        u = segment.u - segment.u[segment.used].mean(axis=0)
        y = segment.y - segment.y[segment.used].mean()
        past = [usable - lag for lag in range(2 * depth - 1, depth - 1, -1)]
        future = [usable - lag for lag in range(depth - 1, -1, -1)]
        rows = np.vstack(
            [u[k, i] for i in range(n_inputs) for k in future]
            + [u[k, i] for i in range(n_inputs) for k in past]
            + [y[k] for k in past]
            + [y[k] for k in future]
        )
        for first in range(0, usable.size, BLOCK_ROWS):
            triangle = fold(triangle, np.ascontiguousarray(rows[:, first : first + BLOCK_ROWS]))
    if triangle is None:
        return {}
    n_future = depth * n_inputs
    past_to_future = triangle[n_future:-depth, -depth:].T
    left, values, _ = np.linalg.svd(past_to_future, full_matrices=False)
    found = {}
    for order in orders:
        observability = left[:, :order] * np.sqrt(values[:order])
        A = np.linalg.lstsq(observability[:-1], observability[1:], rcond=None)[0]
        found[order] = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    return found


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
    all_pole_filter(np.ascontiguousarray(signal), a1, a2, np.zeros((a1.size, 2)), out)
    return out
