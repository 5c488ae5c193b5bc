"""Starts of a Wiener-Hammerstein fit: the best linear approximation, shared between the blocks.

For a Gaussian-like input the best linear approximation of G2 f(G1 u) is a multiple of G1 G2 (Bussgang), so
that each of its poles and zeros belongs to one of the blocks.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sysid.errors import SysidError
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.lft.wiener_hammerstein.reduction import Point, Problem
from sysid.linear.forms import Complexes, Floats
from sysid.linear.output_error import coefficients
from sysid.linear.reduction import Segment, Structure
from sysid.linear.restarts import best_search, shortened
from sysid.linear.simulation import simulate_polynomial
from sysid.nonlinearities.spline import Spline, supported_knots
from sysid.separable.factor import project

LINEAR_ROWS = 20_000
RANKING_ROWS = 4_000
RANKING_INTERVALS = 10
# Points that an interval between knots must hold.
FEWEST_POINTS = 10
REAL = 1e-9
# A response has died out when this share of its energy is left.
DEAD_ENERGY = 1e-8
LARGEST_SETTLING_SHARE = 0.1


@dataclass(frozen=True)
class LinearApproximation:
    """Best linear approximation: poles, and numerator by rising powers of q^-1."""

    poles: Complexes
    b: Floats

    @property
    def zeros(self) -> Complexes:
        """Zeros in q; leading zeros of B are a delay and left out."""
        return np.asarray(np.roots(np.trim_zeros(self.b, "f")), dtype=np.complex128)

    def settling_rows(self, limit: int) -> int:
        """Return after how many rows the impulse response has died out, at most ``limit``."""
        impulse = np.zeros(limit)
        impulse[:1] = 1.0
        response = simulate_polynomial(self.b, np.atleast_1d(np.real(np.poly(self.poles))), impulse)
        left = np.cumsum(response[::-1] ** 2)[::-1]
        return int(np.sum(left > DEAD_ENERGY * left[:1]))


def linear_approximation(
    segments: tuple[Segment, ...], order: int, delay: int, resting: bool
) -> LinearApproximation:
    """Fit the best linear approximation with a direct term, on the first rows."""
    late = tuple(Segment(_late(s.u, delay, resting), s.y, s.used) for s in shortened(segments, LINEAR_ROWS))
    structure = Structure(order, 0, constant=True, free_start=not resting)
    search = best_search(late, structure)
    a, b, _ = coefficients(structure, search.reflections, search.projection.shared, 1)
    return LinearApproximation(np.asarray(np.roots(a), dtype=np.complex128), b[0])


def allocations(
    approximation: LinearApproximation, orders: tuple[int, int]
) -> Iterator[tuple[LinearBlock, LinearBlock]]:
    """Give all pairs of blocks that share poles and zeros between them, conjugate ones together.

    A block that gets fewer poles than its order has the rest at zero.
    """
    for poles in _shares(approximation.poles, orders):
        for zeros in _shares(approximation.zeros, orders):
            yield _block(poles[0], zeros[0], orders[0]), _block(poles[1], zeros[1], orders[1])


def ranked_starts(
    segments: tuple[Segment, ...],
    approximations: list[LinearApproximation],
    orders: tuple[int, int],
    form: WienerHammerstein,
) -> list[WienerHammerstein]:
    """Return all allocations, each with its best map, the best first.

    Parameters
    ----------
    segments : tuple of Segment
    approximations : list of LinearApproximation
    orders : (int, int)
    form : WienerHammerstein
        Gives degree, extrapolation, delay and initial state; the map acts at samples.
    """
    few = shortened(segments, RANKING_ROWS)
    found: list[tuple[float, WienerHammerstein]] = []
    for approximation in approximations:
        for front, back in allocations(approximation, orders):
            try:
                model = with_knots(replace(form, front=front, back=back), few, RANKING_INTERVALS)
                point = Point(Problem(few, model), Problem(few, model).start)
                found.append((point.cost, point.model))
            except SysidError:  # a front block whose output does not vary
                continue
    found.sort(key=lambda pair: pair[0])
    return [model for cost, model in found if np.isfinite(cost)]


def with_knots(model: WienerHammerstein, segments: tuple[Segment, ...], intervals: int) -> WienerHammerstein:
    """Return the model with a map over the range that its input has now, and blocks of ordinary gain.

    Parameters
    ----------
    model : WienerHammerstein
    segments : tuple of Segment
    intervals : int
        Equally wide; those that hold too few points are merged.
    """
    runs = [(model.map_input(s.u[:, 0])[: s.y.size], s.used) for s in segments]
    z = np.concatenate([run[used] for run, used in runs])
    size = float(np.std(z)) or 1.0
    front, back = model.front.scaled(1.0 / size), model.back
    gain = float(np.linalg.norm(back.weights)) or 1.0
    knots = supported_knots(z / size, intervals, FEWEST_POINTS)
    old = model.map
    places = np.linspace(knots[0], knots[-1], 4 * (knots.size + old.degree))
    spline = Spline(knots, np.zeros(knots.size - 1 + old.degree), old.degree, old.extrapolation)
    values = project(spline.basis(places), gain * old(size * places)).theta
    return replace(model, front=front, back=back.scaled(1.0 / gain), map=replace(spline, coefficients=values))


def settled_segments(
    segments: tuple[Segment, ...], approximation: LinearApproximation
) -> tuple[Segment, ...]:
    """Leave out the first rows of each experiment, in which its unknown past still shows."""
    found = []
    for segment in segments:
        used = segment.used.copy()
        first = int(np.argmax(used))
        limit = int(LARGEST_SETTLING_SHARE * used.sum())
        used[: max(approximation.settling_rows(max(limit, 1)), first)] = False
        found.append(Segment(segment.u, segment.y, used))
    return tuple(found)


def _shares(roots: Complexes, orders: tuple[int, int]) -> Iterator[tuple[Complexes, Complexes]]:
    """Give all ways to share roots between two blocks, no more to a block than its order."""
    groups = [np.array([root, root.conjugate()]) for root in roots[roots.imag > REAL]]
    groups += [np.array([root.real + 0j]) for root in roots[np.abs(roots.imag) <= REAL]]
    for places in itertools.product((False, True), repeat=len(groups)):
        shares = tuple(
            np.concatenate(
                [np.zeros(0, complex), *(g for g, p in zip(groups, places, strict=True) if p == side)]
            )
            for side in (False, True)
        )
        if shares[0].size <= orders[0] and shares[1].size <= orders[1]:
            yield shares[0], shares[1]


def _block(poles: Complexes, zeros: Complexes, order: int) -> LinearBlock:
    rest = np.zeros(order - poles.size, dtype=np.complex128)
    return LinearBlock.from_poles(np.concatenate([poles, rest]), np.atleast_1d(np.real(np.poly(zeros))))


def _late(u: Floats, delay: int, resting: bool) -> Floats:
    if delay == 0:
        return u
    before = np.full((delay, u.shape[1]), 0.0) if resting else np.repeat(u[:1], delay, axis=0)
    return np.concatenate([before, u])[: u.shape[0]]
