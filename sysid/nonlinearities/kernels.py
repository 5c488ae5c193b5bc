"""Compiled loops of the nonlinearities; arguments are trusted, never checked here.

The ``*_pieces`` kernels return ``(offset, slope, knot, sample, new_offset, new_slope)``, the
arrays of :class:`~sysid.separable.pieces.AffinePieces`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
PieceArrays = tuple[Floats, Floats, Floats, Indices, Floats, Floats]
Law = tuple[float, float, float, float, float, float, float]

BOTH_SIDES, NEGATIVE_SIDE, POSITIVE_SIDE = 0, -1, 1


@compiled
def _sign(value: float) -> float:
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)


@compiled
def static_response(u: Floats, negative: float, positive: float, law: Law) -> tuple[Floats, Floats]:
    """Return x and dx/da of a static map, with its own parameter for each sign of the input.

    ``law`` holds the magnitude inside ``|u| <= a`` and outside as
    (constant, times |u|, times a) twice, then 1 for an even map and 0 for an odd one.
    """
    inner0, inner1, inner2, outer0, outer1, outer2, even = law
    x, slope = np.empty(u.size), np.empty(u.size)
    for k in range(u.size):
        v, sign = abs(u[k]), _sign(u[k])
        a = negative if sign < 0.0 else positive
        if even:
            sign = abs(sign)
        if v <= a:
            x[k], slope[k] = sign * (inner0 + inner1 * v + inner2 * a), sign * inner2
        else:
            x[k], slope[k] = sign * (outer0 + outer1 * v + outer2 * a), sign * outer2
    return x, slope


@compiled
def static_pieces(u: Floats, lower: float, upper: float, law: Law, side: int) -> PieceArrays:
    """Return the pieces of a static map: sample k changes once, at a = |u(k)|.

    With ``side`` -1 or +1 the samples of the other sign are zero throughout.
    """
    inner0, inner1, inner2, outer0, outer1, outer2, even = law
    n = u.size
    kinked = inner0 != outer0 or inner1 != outer1 or inner2 != outer2
    offset, slope = np.zeros(n), np.zeros(n)
    knot, sample = np.empty(n), np.empty(n, np.int64)
    count = 0
    for k in range(n):
        v, sign = abs(u[k]), _sign(u[k])
        if sign * side < 0.0 or sign == 0.0:
            continue
        if even:
            sign = 1.0
        if v <= lower:
            offset[k], slope[k] = sign * (inner0 + inner1 * v), sign * inner2
        else:
            offset[k], slope[k] = sign * (outer0 + outer1 * v), sign * outer2
            if kinked and v < upper:
                knot[count], sample[count] = v, k
                count += 1
    order = np.argsort(knot[:count], kind="mergesort")
    knot, sample = knot[:count][order], sample[:count][order]
    new_offset, new_slope = np.empty(count), np.empty(count)
    for event in range(count):
        sign = 1.0 if even else _sign(u[sample[event]])
        new_offset[event] = sign * (inner0 + inner1 * knot[event])
        new_slope[event] = sign * inner2
    return offset, slope, knot, sample, new_offset, new_slope


@compiled
def direction_relay_response(u: Floats, a: float, previous_input: float, initial: float) -> Floats:
    """Return the output of the hysteresis relay as printed in Eq. (1.4) of Bai (2002)."""
    x = np.empty(u.size)
    last_input, output = previous_input, initial
    for k in range(u.size):
        if abs(u[k]) > a:
            output = _sign(u[k])
        elif u[k] != last_input:
            output = _sign(last_input - u[k])
        last_input = u[k]
        x[k] = output
    return x


@compiled
def direction_relay_pieces(
    u: Floats, lower: float, upper: float, previous_input: float, initial: float
) -> PieceArrays:
    """Return the pieces of the printed hysteresis relay: sign(u) below |u(k)|, the direction above."""
    n = u.size
    offset, knot, sample, new_offset = np.empty(n), np.empty(n), np.empty(n, np.int64), np.empty(n)
    last_input, inside = previous_input, initial
    count = 0
    for k in range(n):
        v = abs(u[k])
        if u[k] != last_input:
            inside = _sign(last_input - u[k])
        last_input = u[k]
        if v <= lower:
            offset[k] = inside
            continue
        offset[k] = _sign(u[k])
        if v < upper and inside != offset[k]:
            knot[count], sample[count], new_offset[count] = v, k, inside
            count += 1
    return _sorted_pieces(
        offset, np.zeros(n), knot[:count], sample[:count], new_offset[:count], np.zeros(count)
    )


@compiled
def schmitt_response(u: Floats, a: float, initial: float) -> Floats:
    """Return the output of the Schmitt trigger, which holds its state for |u| <= a."""
    x = np.empty(u.size)
    output = initial
    for k in range(u.size):
        if abs(u[k]) > a:
            output = _sign(u[k])
        x[k] = output
    return x


@compiled
def schmitt_pieces(u: Floats, lower: float, upper: float, initial: float) -> PieceArrays:
    """Return the pieces of the Schmitt trigger by its memory curve.

    As a function of a the state is a staircase: sample k sets it to sign(u(k)) on [0, |u(k)|) and
    leaves it above.  The stairs are a stack, innermost on top; a larger sample wipes smaller ones out.
    """
    n = u.size
    offset = np.empty(n)
    knot, sample, new_offset = np.empty(2 * n), np.empty(2 * n, np.int64), np.empty(2 * n)
    edge, state = np.empty(n + 1), np.empty(n + 1)
    edge[0], state[0] = np.inf, initial
    top, count = 0, 0
    for k in range(n):
        v, sign = abs(u[k]), _sign(u[k])
        while edge[top] <= v:
            top -= 1
        if v > 0.0 and state[top] != sign:
            top += 1
            edge[top], state[top] = v, sign
        if count + top > knot.size:
            knot, sample, new_offset = (
                _doubled(knot, count),
                _doubled(sample, count),
                _doubled(new_offset, count),
            )
        step = top
        while edge[step] <= lower:
            step -= 1
        offset[k] = state[step]
        while edge[step] < upper:
            knot[count], sample[count], new_offset[count] = edge[step], k, state[step - 1]
            count += 1
            step -= 1
    return _sorted_pieces(
        offset, np.zeros(n), knot[:count], sample[:count], new_offset[:count], np.zeros(count)
    )


@compiled
def direction_play_response(
    u: Floats, a: float, previous_input: float, initial: float
) -> tuple[Floats, Floats]:
    """Return x and dx/da of the hysteresis as printed in Eq. (1.4) of Bai (2002)."""
    x, slope = np.empty(u.size), np.empty(u.size)
    last_input, output, output_slope = previous_input, initial, 0.0
    for k in range(u.size):
        if u[k] != last_input:
            output_slope = _sign(last_input - u[k])
            output = u[k] + a * output_slope
        last_input = u[k]
        x[k], slope[k] = output, output_slope
    return x, slope


@compiled
def direction_play_pieces(
    u: Floats, lower: float, upper: float, previous_input: float, initial: float
) -> PieceArrays:
    """Return the pieces of the printed hysteresis: affine in a over the whole range, no event."""
    offset, slope = direction_play_response(u, 0.0, previous_input, initial)
    none = np.empty(0)
    return offset, slope, none, np.empty(0, np.int64), none, none


@compiled
def play_response(u: Floats, a: float, initial: float) -> tuple[Floats, Floats]:
    """Return x and dx/da of the play operator; a tie keeps the state."""
    x, slope = np.empty(u.size), np.empty(u.size)
    output, output_slope = initial, 0.0
    for k in range(u.size):
        if output < u[k] - a:
            output, output_slope = u[k] - a, -1.0
        elif output > u[k] + a:
            output, output_slope = u[k] + a, 1.0
        x[k], slope[k] = output, output_slope
    return x, slope


@compiled
def play_pieces(u: Floats, lower: float, upper: float, initial: float) -> PieceArrays:
    """Return the pieces of the play operator by its memory curve.

    As a function of a the state is a continuous zigzag of slopes -1 and +1 that starts at the last
    input and ends in the constant initial state.  A rising sample replaces the curve by u(k) - a as
    far as that lies above it, a falling one by u(k) + a as far as that lies below.  The segments are
    a stack, innermost on top, each with its right edge.
    """
    n = u.size
    offset, slope = np.empty(n), np.empty(n)
    knot, sample = np.empty(2 * n), np.empty(2 * n, np.int64)
    new_offset, new_slope = np.empty(2 * n), np.empty(2 * n)
    edge, start, rate = np.empty(n + 1), np.empty(n + 1), np.empty(n + 1)
    edge[0], start[0], rate[0] = np.inf, initial, 0.0
    top, count = 0, 0
    last_input = initial
    for k in range(n):
        direction = _sign(u[k] - last_input)
        last_input = u[k]
        if direction != 0.0:
            wiped = 0.0
            while (
                top > 0 and direction * (start[top] + rate[top] * edge[top]) <= direction * u[k] - edge[top]
            ):
                wiped = edge[top]
                top -= 1
            # Exactly, the new line always crosses what is left at or above `wiped`; rounding may differ.
            steepness = 1.0 + direction * rate[top]
            meeting = direction * (u[k] - start[top]) / steepness if steepness > 0.0 else wiped
            top += 1
            edge[top] = min(max(meeting, wiped), edge[top - 1])
            start[top], rate[top] = u[k], -direction
        if count + top > knot.size:
            knot, sample = _doubled(knot, count), _doubled(sample, count)
            new_offset, new_slope = _doubled(new_offset, count), _doubled(new_slope, count)
        step = top
        while edge[step] <= lower:
            step -= 1
        offset[k], slope[k] = start[step], rate[step]
        while edge[step] < upper:
            knot[count], sample[count] = edge[step], k
            new_offset[count], new_slope[count] = start[step - 1], rate[step - 1]
            count += 1
            step -= 1
    return _sorted_pieces(offset, slope, knot[:count], sample[:count], new_offset[:count], new_slope[:count])


@compiled
def _doubled(values: NDArray[Any], count: int) -> NDArray[Any]:
    """Return an array of twice the size with the first ``count`` values kept."""
    larger = np.empty(2 * values.size, values.dtype)
    larger[:count] = values[:count]
    return larger


@compiled
def _sorted_pieces(
    offset: Floats, slope: Floats, knot: Floats, sample: Indices, new_offset: Floats, new_slope: Floats
) -> PieceArrays:
    """Order the events by knot, those at equal knots as they were written."""
    order = np.argsort(knot, kind="mergesort")
    return offset, slope, knot[order], sample[order], new_offset[order], new_slope[order]
