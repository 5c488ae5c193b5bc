"""Known static maps with their preimages: piecewise affine, quantiser, piecewise monotone, sine."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import ModelError, UsageError
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.hard import HardMap
from sysid.nonlinearities.preimages import KnownMap, Parts

_MEMBERSHIP = 1e-9
"""A datum this close to the range, relative to its size, lies in it: outputs carry rounding."""
_BISECTIONS = 200


@dataclass(frozen=True, eq=False)
class PiecewiseAffine(KnownMap):
    """A map that is affine between edges; it may jump at them and be constant between them.

    Parameters
    ----------
    name : str
    edges : array_like, shape (n_pieces + 1,)
        Ascending; the first and last are the domain and may be infinite.
    slope, intercept : array_like, shape (n_pieces,)
        z = slope y + intercept on each piece; at an edge the piece above counts.

    Raises
    ------
    ModelError
        If the edges do not ascend, the shapes do not match or a value is not finite.

    Examples
    --------
    >>> sign = PiecewiseAffine("sign", [-np.inf, 0.0, np.inf], [0.0, 0.0], [-1.0, 1.0])
    >>> sign([-2.0, 3.0])
    array([-1.,  1.])
    >>> found = sign.preimage([1.0, 0.4])
    >>> found.lower, found.upper, found.moved
    (array([0., 0.]), array([inf, inf]), array([1]))
    """

    name: str
    edges: Floats
    slope: Floats
    intercept: Floats

    def __post_init__(self) -> None:
        for attribute in ("edges", "slope", "intercept"):
            object.__setattr__(self, attribute, np.array(getattr(self, attribute), dtype=np.float64))
        n_pieces = self.slope.size
        if n_pieces == 0 or self.edges.shape != (n_pieces + 1,) or self.intercept.shape != (n_pieces,):
            raise ModelError(
                f"{self.name}: {self.edges.size} edges, {n_pieces} slopes and {self.intercept.size} "
                "intercepts were given: give as many slopes as intercepts and one edge more"
            )
        if not np.all(np.diff(self.edges) > 0):
            raise ModelError(f"{self.name}: the edges {self.edges.tolist()} do not ascend: sort them")
        if not np.all(np.isfinite(np.concatenate([self.slope, self.intercept, self.edges[1:-1]]))):
            raise ModelError(f"{self.name}: a slope, intercept or inner edge is not finite: correct it")

    @classmethod
    def of(
        cls, hard_map: HardMap, a: float, domain: tuple[float, float] = (-math.inf, math.inf)
    ) -> "PiecewiseAffine":
        """Return a hard map with its threshold fixed, on a domain."""
        inner, outer, even = hard_map.inner, hard_map.outer, hard_map.even
        (checked,) = hard_map._checked((a,))
        edges = [-math.inf, -checked, 0.0, checked, math.inf]
        sides = [(outer, -1.0), (inner, -1.0), (inner, 1.0), (outer, 1.0)]
        level = 1.0 if even else -1.0  # the negative half is mirrored or rotated
        pieces = [
            (
                branch.input * (side if even else 1.0),
                (branch.constant + branch.parameter * checked) * (1.0 if side > 0 else level),
            )
            for branch, side in sides
        ]
        slope, intercept = (np.array(column) for column in zip(*pieces, strict=True))
        keep = np.diff(np.clip(edges, *domain)) > 0
        ends = np.clip(np.array(edges), *domain)
        return cls(
            hard_map.name, np.append(ends[:-1][keep], ends[1:][keep][-1]), slope[keep], intercept[keep]
        )

    @classmethod
    def interpolating(cls, name: str, y: ArrayLike, z: ArrayLike) -> "PiecewiseAffine":
        """Return the piecewise linear interpolation of points; the domain ends with them.

        Raises
        ------
        ModelError
            If there are fewer than two points or the abscissae do not ascend.
        """
        abscissae, ordinates = np.array(y, dtype=np.float64), np.array(z, dtype=np.float64)
        if abscissae.shape != ordinates.shape or abscissae.size < 2 or not np.all(np.diff(abscissae) > 0):
            raise ModelError(
                f"{name}: {abscissae.size} abscissae and {ordinates.size} ordinates do not interpolate: give "
                "two or more points with ascending abscissae"
            )
        slope = np.diff(ordinates) / np.diff(abscissae)
        return cls(name, abscissae, slope, ordinates[:-1] - slope * abscissae[:-1])

    def __call__(self, y: ArrayLike) -> Floats:
        """Return z; beyond a finite domain the last piece goes on."""
        values = np.asarray(y, dtype=np.float64)
        piece = np.searchsorted(self.edges[1:-1], values, side="right")
        return np.asarray(self.slope[piece] * values + self.intercept[piece])

    def _parts(self, z: Floats) -> Parts:
        lower = np.broadcast_to(self.edges[:-1], (z.size, self.slope.size)).copy()
        upper = np.broadcast_to(self.edges[1:], lower.shape).copy()
        sloping = self.slope != 0.0
        steepness = np.where(sloping, self.slope, 1.0)
        point = (z[:, np.newaxis] - self.intercept) / steepness
        near = _MEMBERSHIP * np.maximum(1.0, np.abs(z))[:, np.newaxis] / np.abs(steepness)
        within = (point >= lower - near) & (point <= upper + near)
        level = np.abs(z[:, np.newaxis] - self.intercept) <= near
        point = np.clip(point, lower, upper)
        weight = np.broadcast_to(1.0 / np.abs(steepness), lower.shape).copy()
        return Parts(
            np.where(sloping, point, lower),
            np.where(sloping, point, upper),
            weight,
            np.where(sloping, within, level),
        )

    def _into_range(self, z: Floats) -> Floats:
        with np.errstate(invalid="ignore"):
            ends = [
                np.where(self.slope == 0.0, self.intercept, self.slope * edge + self.intercept)
                for edge in (self.edges[:-1], self.edges[1:])
            ]
        return _nearest_of_intervals(z, np.minimum(*ends), np.maximum(*ends))


@dataclass(frozen=True)
class Quantiser(KnownMap):
    """An analog-to-digital converter: the nearest multiple of a step.

    Parameters
    ----------
    step : float
        Width of a cell, > 0.
    largest : int or None
        Largest multiple; beyond it the converter saturates. None: it never does.

    Examples
    --------
    >>> Quantiser(0.5)([0.2, 0.3, -1.1])
    array([ 0. ,  0.5, -1. ])
    >>> Quantiser(0.5, largest=2).preimage([1.0, 0.5]).upper
    array([ inf, 0.75])
    """

    step: float = 1.0
    largest: int | None = None
    name: str = "quantiser"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.step) and self.step > 0):
            raise ModelError(f"{self.name}: the step is {self.step}: give a finite number > 0")
        if self.largest is not None and self.largest < 1:
            raise ModelError(f"{self.name}: the largest multiple is {self.largest}: give at least 1")

    def __call__(self, y: ArrayLike) -> Floats:
        """Return the nearest multiple of the step."""
        return self._level(np.asarray(y, dtype=np.float64)) * self.step

    def _level(self, y: Floats) -> Floats:
        level = np.floor(y / self.step + 0.5)
        return level if self.largest is None else np.clip(level, -self.largest, self.largest)

    def _parts(self, z: Floats) -> Parts:
        level = np.round(z / self.step)
        lower, upper = (level - 0.5) * self.step, (level + 0.5) * self.step
        if self.largest is not None:
            lower = np.where(level <= -self.largest, -np.inf, lower)
            upper = np.where(level >= self.largest, np.inf, upper)
        one = np.ones((z.size, 1))
        return Parts(lower[:, np.newaxis], upper[:, np.newaxis], one, one.astype(np.bool_))

    def _into_range(self, z: Floats) -> Floats:
        return self._level(z) * self.step


@dataclass(frozen=True, eq=False)
class MonotonePieces(KnownMap):
    """A continuous function that is strictly monotone between knots, such as y^2, arctan y or sin y.

    Parameters
    ----------
    name : str
    function : callable
        Array in, array out.
    knots : sequence of float
        Ascending; the first and last are the domain and may be infinite.
    inverse : callable, optional
        ``inverse(i, z)`` on piece i; by default it is found by bisection.

    Examples
    --------
    >>> square = MonotonePieces("square", np.square, [-np.inf, 0.0, np.inf])
    >>> square.preimage([4.0]).lower.round(12)
    array([-2.,  2.])
    """

    name: str
    function: Callable[[Floats], Floats]
    knots: Floats
    inverse: Callable[[int, Floats], Floats] | None = None
    _values: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        knots = np.array(self.knots, dtype=np.float64)
        object.__setattr__(self, "knots", knots)
        if knots.size < 2 or not np.all(np.diff(knots) > 0):
            raise ModelError(
                f"{self.name}: the knots {knots.tolist()} do not enclose a domain: give two or more, "
                f"ascending"
            )
        with np.errstate(all="ignore"):
            values = np.array(self.function(knots), dtype=np.float64)
        if np.any(np.isnan(values)) or np.any(np.diff(values) == 0.0):
            raise ModelError(
                f"{self.name}: the values at the knots are {values.tolist()}: the function must be defined "
                "and strictly monotone between them"
            )
        object.__setattr__(self, "_values", values)

    def __call__(self, y: ArrayLike) -> Floats:
        """Return z = function(y)."""
        return np.asarray(self.function(np.asarray(y, dtype=np.float64)), dtype=np.float64)

    def _parts(self, z: Floats) -> Parts:
        ends = self._values
        points, weights, valid = [], [], []
        for i in range(self.knots.size - 1):
            bottom, top = sorted((ends[i], ends[i + 1]))
            slack = _MEMBERSHIP * np.maximum(1.0, np.abs(z))
            # An infinite end of the domain is not attained.
            open_bottom, open_top = (
                math.isinf(self.knots[i + (ends[i] > ends[i + 1])]),
                math.isinf(self.knots[i + (ends[i] < ends[i + 1])]),
            )
            inside = (z > bottom if open_bottom else z >= bottom - slack) & (
                z < top if open_top else z <= top + slack
            )
            held = np.clip(np.where(inside, z, 0.5 * (max(bottom, -1e300) + min(top, 1e300))), bottom, top)
            found = self.inverse(i, held) if self.inverse is not None else self._bisect(i, held)
            found = np.clip(found, self.knots[i], self.knots[i + 1])
            points.append(found)
            weights.append(self._density(found))
            valid.append(inside)
        point = np.column_stack(points)
        return Parts(point, point.copy(), np.column_stack(weights), np.column_stack(valid))

    def _density(self, y: Floats) -> Floats:
        """Return |dy/dz|, bounded where the slope vanishes."""
        step = 1e-6 * np.maximum(1.0, np.abs(y))
        low, high = (np.clip(y + sign * step, self.knots[0], self.knots[-1]) for sign in (-1, 1))
        rise = np.abs(self(high) - self(low))
        return np.asarray((high - low) / np.maximum(rise, 1e-6 * (high - low)))

    def _bisect(self, i: int, z: Floats) -> Floats:
        low, high = (np.full(z.shape, end) for end in self.knots[i : i + 2])
        rising = self._values[i + 1] > self._values[i]

        def below(y: Floats) -> NDArrayBool:
            with np.errstate(all="ignore"):
                return np.asarray((self(y) < z) == rising)

        # An infinite end is replaced by one far enough out from the other end, or from zero.
        anchors = [knot if math.isfinite(knot) else 0.0 for knot in (self.knots[i + 1], self.knots[i])]
        reach = 1.0
        while (np.isinf(low).any() or np.isinf(high).any()) and reach < 1e300:
            trial_low, trial_high = np.full(z.shape, anchors[0] - reach), np.full(z.shape, anchors[1] + reach)
            if np.isinf(low).any() and np.all(below(trial_low)):
                low = trial_low
            if np.isinf(high).any() and not np.any(below(trial_high)):
                high = trial_high
            reach *= 4.0
        if np.isinf(low).any() or np.isinf(high).any():
            raise ModelError(
                f"{self.name}: the inverse between the knots {self.knots[i]:g} and {self.knots[i + 1]:g} was "
                "not found: restrict the domain or give the inverse"
            )
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            left = below(middle)
            low, high = np.where(left, middle, low), np.where(left, high, middle)
        return np.asarray(0.5 * (low + high))

    def _into_range(self, z: Floats) -> Floats:
        ends = np.stack([self._values[:-1], self._values[1:]])
        return _nearest_of_intervals(z, ends.min(axis=0), ends.max(axis=0))


NDArrayBool = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]


def sine(domain: tuple[float, float] = (-2 * math.pi, 2 * math.pi)) -> MonotonePieces:
    """Return z = sin y on a bounded domain.

    Raises
    ------
    UsageError
        If the domain is not bounded or empty: the preimage would not be a finite set.

    Examples
    --------
    >>> (sine().preimage([0.5]).lower / np.pi).round(4)
    array([-1.8333, -1.1667,  0.1667,  0.8333])
    """
    low, high = domain
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise UsageError(
            f"sine: the domain [{low}, {high}] leaves infinitely many preimages or none: give finite "
            f"low < high"
        )
    turns = np.arange(math.floor(low / math.pi - 0.5), math.ceil(high / math.pi + 0.5) + 1)
    inner = (turns + 0.5) * math.pi
    knots = np.array([low, *inner[(inner > low + 1e-12) & (inner < high - 1e-12)], high])

    def inverse(i: int, z: Floats) -> Floats:
        turn = round(0.5 * (knots[i] + knots[i + 1]) / math.pi)
        return np.asarray(turn * math.pi + (-1.0) ** turn * np.arcsin(np.clip(z, -1.0, 1.0)))

    return MonotonePieces("sine", np.sin, knots, inverse)


SIGN = PiecewiseAffine(
    "sign", np.array([-math.inf, 0.0, math.inf]), np.array([0.0, 0.0]), np.array([-1.0, 1.0])
)
"""z = -1 below zero, +1 from zero on."""


def _nearest_of_intervals(z: Floats, lower: Floats, upper: Floats) -> Floats:
    """Return the nearest point of a union of intervals, rounding errors left alone."""
    points = np.clip(z[:, np.newaxis], lower, upper)
    distance = np.abs(points - z[:, np.newaxis])
    best = np.argmin(distance, axis=1)
    rows = np.arange(z.size)
    slack = _MEMBERSHIP * np.maximum(1.0, np.abs(z))
    return np.asarray(np.where(distance[rows, best] <= slack, z, points[rows, best]))
