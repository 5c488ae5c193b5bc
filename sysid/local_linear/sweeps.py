"""One pass forward and one backward in time, with the states and all sums in registers.

Both know the sizes of the model when they are compiled and write their steps out; a step of the loop over
time waits for the n multiplications of its state, and does everything else meanwhile.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.local_linear.vector_code import Writer

Floats = NDArray[np.float64]
LANES = 4

Forward = Callable[[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats], int]
Backward = Callable[[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats], int]


def _forward_code(code: Writer, arguments: Any, n: int, s: int, n_channels: int, q: int) -> None:
    """Write the simulation; ``gains`` is (n_channels + n, n, s): entries of [B_i O_i A_i] with i last."""
    steps, A, weights, slopes, inputs, gains, x, drives, moves = arguments
    builder = code.builder
    state = [code.variable(1, code.load(code.entry(x, e))) for e in range(n)]

    def gain(b: int, e: int) -> Any:
        return code.load(code.entry(gains, (b * n + e) * s), s)

    def row(base: Any, size: int) -> Any:
        return code.step(base, code.word(8 * size), loop.index)

    with code.steps(steps) as loop:
        p = code.load(row(weights, s), s)
        u = [code.load(code.entry(row(inputs, n_channels), b)) for b in range(n_channels)]
        now = [builder.load(place) for place in state]
        forced = [
            code.products([code.spread(value, s) for value in u], [gain(b, e) for b in range(n_channels)])
            for e in range(n)
        ]
        # x(k+1) by the mixed A: the shortest way from one state to the next.
        after = []
        for e in range(n):
            drive = code.sum(builder.fmul(p, forced[e]) if s > 1 else forced[e])
            matrix_row = code.entry(row(A, n * n), e * n)
            after.append(code.products([code.load(code.entry(matrix_row, b)) for b in range(n)], now, drive))
            builder.store(after[e], state[e])
            code.store(after[e], code.entry(row(x, n), n + e))
        _products_of_rows(code, p, now, row(drives, s * n), s, n)
        # How widths, then centres, move each state: p_i slope (local step i - mixed step).
        every = [i for i in range(s) for _ in range(q)]
        slope = [code.load(code.entry(row(slopes, 2 * s * q), kind * s * q), s * q) for kind in range(2)]
        factors = [builder.fmul(code.pick(p, every), values) for values in slope]
        for e in range(n):
            matrix = [gain(n_channels + b, e) for b in range(n)]
            local = code.products([code.spread(value, s) for value in now], matrix, forced[e])
            off = builder.fsub(local, code.spread(after[e], s))
            off = code.pick(off, every) if q > 1 else off
            for kind in range(2):
                place = code.entry(row(moves, 2 * n * s * q), (2 * e + kind) * s * q)
                code.store(builder.fmul(factors[kind], off), place)


def _products_of_rows(code: Writer, p: Any, x: list[Any], out: Any, s: int, n: int) -> None:
    """Write p kron x, some entries at a time."""
    state = code.vector(x)
    for first in range(0, s * n, LANES):
        entries = range(first, min(first + LANES, s * n))
        left, right = code.pick(p, [j // n for j in entries]), code.pick(state, [j % n for j in entries])
        code.store(code.builder.fmul(left, right), code.entry(out, first))


def _backward_code(code: Writer, arguments: Any, n: int, s: int, q: int, p: int) -> None:
    """Write the adjoint pass; the sums are added to ``by_A``, ``by_C`` and ``by_weights`` at the end."""
    steps, A, C, r, x, drives, moves, mu, by_A, by_C, by_weights = arguments
    builder, columns, factors = code.builder, s * n, 2 * s * q
    gains = [[code.load(code.entry(C, o * n + e)) for o in range(p)] for e in range(n)]
    before = [code.variable(1, code.zero()) for _ in range(n)]
    sums_A = [_Sums(code, code.entry(by_A, e * columns), columns) for e in range(n)]
    sums_C = [_Sums(code, code.entry(by_C, o * n), n) for o in range(p)]
    sums_weights = _Sums(code, by_weights, factors)
    with code.steps(steps) as loop:
        k = builder.sub(builder.sub(steps, code.word(1)), loop.index)

        def row(base: Any, size: int) -> Any:
            return code.step(base, code.word(8 * size), k)

        now = [builder.load(place) for place in before]
        pull = [code.load(code.entry(row(r, p), o)) for o in range(p)]
        for e in range(n):
            code.store(now[e], code.entry(row(mu, n), e))
            column = [code.load(code.entry(row(A, n * n), b * n + e)) for b in range(n)]
            builder.store(code.products(column, now, code.products(gains[e], pull)), before[e])
        for e in range(n):
            sums_A[e].add(now[e], row(drives, columns))
        sums_weights.add_rows(now, row(moves, n * factors))
        for o in range(p):
            sums_C[o].add(pull[o], row(x, n))
    for sums in (*sums_A, *sums_C, sums_weights):
        sums.write()


class _Sums:
    """Sums over time of numbers times rows of memory, in registers as far as they go."""

    def __init__(self, code: Writer, place: Any, size: int) -> None:
        self.code, self.place, self.size = code, place, size
        self.parts = [(first, min(LANES, size - first)) for first in range(0, size, LANES)]
        self.totals = [
            code.variable(lanes, code.load(code.entry(place, first), lanes)) for first, lanes in self.parts
        ]

    def add(self, factor: Any, row: Any) -> None:
        """Add factor * row."""
        self.add_rows([factor], row)

    def add_rows(self, factors: list[Any], rows: Any) -> None:
        """Add the sum of some factors times as many rows that stand one after the other."""
        code = self.code
        for (first, lanes), total in zip(self.parts, self.totals, strict=True):
            values = [code.load(code.entry(rows, i * self.size + first), lanes) for i in range(len(factors))]
            spread = [code.spread(factor, lanes) for factor in factors]
            now = code.builder.load(total)
            if len(factors) == 1:
                moved = code.multiply_add(spread[0], values[0], now)
            else:  # added up apart, so that one step waits for the last by one addition only
                moved = code.builder.fadd(now, code.products(spread, values))
            code.builder.store(moved, total)

    def write(self) -> None:
        """Put the sums in their place."""
        for (first, _), total in zip(self.parts, self.totals, strict=True):
            self.code.store(self.code.builder.load(total), self.code.entry(self.place, first))


def _typed_forward(  # type: ignore[no-untyped-def]
    typing, n, s, n_channels, q, steps, A, weights, slopes, inputs, gains, x, drives, moves
):
    """Run the simulation of some steps; the first four arguments are constants, the others addresses."""
    shape = [kind.literal_value for kind in (n, s, n_channels, q)]

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _forward_code(Writer(builder), arguments[4:], *shape)
        return context.get_dummy_value()

    return types.void(n, s, n_channels, q, *[types.intp] * 9), codegen


def _typed_backward(  # type: ignore[no-untyped-def]
    typing, n, s, q, p, steps, A, C, r, x, drives, moves, mu, by_A, by_C, by_weights
):
    """Run the adjoint pass over some steps; the first four arguments are constants, the others addresses."""
    shape = [kind.literal_value for kind in (n, s, q, p)]

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _backward_code(Writer(builder), arguments[4:], *shape)
        return context.get_dummy_value()

    return types.void(n, s, q, p, *[types.intp] * 11), codegen


_forward: Any = intrinsic(prefer_literal=True)(_typed_forward)
_backward: Any = intrinsic(prefer_literal=True)(_typed_backward)


@lru_cache(maxsize=64)
def forward(n: int, s: int, n_channels: int, q: int) -> Forward:
    """Return the simulation that leaves the drives of all sensitivities behind.

    It is called as ``forward(A, weights, slopes, inputs, gains, x, drives, moves)`` with contiguous arrays;
    ``gains`` has the shape (n_channels + n, n, s) and holds the entries [B_i O_i A_i]_eb, b first and i last.
    It goes on from x(0) and fills x(1) ... x(n_samples), ``drives`` with p kron x and ``moves`` with
    p_i slope (local step i - x(k+1)).
    """

    def run(A, weights, slopes, inputs, gains, x, drives, moves):  # type: ignore[no-untyped-def]
        _forward(n, s, n_channels, q, A.shape[0], A.ctypes.data, weights.ctypes.data, slopes.ctypes.data,
                 inputs.ctypes.data, gains.ctypes.data, x.ctypes.data, drives.ctypes.data,
                 moves.ctypes.data)  # fmt: skip
        return gains.size  # used once more: an address alone does not keep an array alive

    return cast(Forward, compiled(run))


@lru_cache(maxsize=64)
def backward(n: int, s: int, q: int, p: int) -> Backward:
    """Return the backward pass that sums the gradient while it goes.

    It is called as ``backward(A, C, r, x, drives, moves, mu, by_A, by_C, by_weights)`` with contiguous
    arrays: ``mu`` is filled with the adjoint of x(k+1), and the last three are added to.
    """

    def run(A, C, r, x, drives, moves, mu, by_A, by_C, by_weights):  # type: ignore[no-untyped-def]
        _backward(n, s, q, p, A.shape[0], A.ctypes.data, C.ctypes.data, r.ctypes.data, x.ctypes.data,
                  drives.ctypes.data, moves.ctypes.data, mu.ctypes.data, by_A.ctypes.data, by_C.ctypes.data,
                  by_weights.ctypes.data)  # fmt: skip
        return mu.size + by_A.size + by_C.size + by_weights.size + r.size

    return cast(Backward, compiled(run))
