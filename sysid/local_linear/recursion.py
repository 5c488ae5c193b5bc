"""The one recursion behind everything: x(k+1) = A_k x(k) + d(k), y(k) = C x(k), for many drives d at once.

A batch of systems shares A_k and C.  A block of columns of the batch is kept in vector registers over a
stretch of time, so that a step costs its multiplications and nothing else; the code is written out for the
numbers of states and outputs, as compilers do not find this form in loops over arrays.
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
Respond = Callable[[Floats, Floats, Floats, int, Floats, int, Floats], int]

LANES = 4
STRETCH = 4096
"""Entries of A_k that are used for all columns before the next: half of a first-level cache."""


def chunks_in_registers(n_states: int) -> int:
    """Return how many vectors of columns one block has, so that states and sums fit the registers."""
    return 3 if n_states <= 4 else 2 if n_states <= 8 else 1


def _emit(code: Writer, arguments: Any, n: int, n_outputs: int, lanes: int, chunks: int) -> None:
    """Write the loop over time for one block of columns."""
    steps, a, a_step, a_row, a_column, c, drives, out, out_step, out_row, x, x_row = arguments
    builder, width = code.builder, lanes * chunks

    def parts(address: Any) -> list[Any]:
        return [code.load(code.entry(address, j), lanes) for j in range(0, width, lanes)]

    def put(values: list[Any], address: Any) -> None:
        for j, value in enumerate(values):
            code.store(value, code.entry(address, j * lanes))

    gains = [[code.load(code.entry(c, o * n + b)) for b in range(n)] for o in range(n_outputs)]
    bases = [code.load_word(code.entry(drives, 2 * e)) for e in range(n)]
    strides = [code.load_word(code.entry(drives, 2 * e + 1)) for e in range(n)]
    state = [[code.variable(lanes, part) for part in parts(code.along(x, x_row, e))] for e in range(n)]
    with code.steps(steps) as loop:
        now = [[builder.load(place) for place in places] for places in state]
        here = code.step(out, out_step, loop.index)
        for o in range(n_outputs):
            row = [code.spread(gain, lanes) for gain in gains[o]]
            put([code.products(row, [now[b][j] for b in range(n)]) for j in range(chunks)],
                code.along(here, out_row, o))  # fmt: skip
        matrix = code.step(a, a_step, loop.index)
        for e in range(n):
            sums = parts(code.step(bases[e], strides[e], loop.index))
            for b in range(n):
                entry = code.load(code.along(code.along(matrix, a_row, e), a_column, b))
                entry = code.spread(entry, lanes)
                sums = [code.multiply_add(entry, now[b][j], sums[j]) for j in range(chunks)]
            for place, value in zip(state[e], sums, strict=True):
                builder.store(value, place)
    for e in range(n):
        put([builder.load(place) for place in state[e]], code.along(x, x_row, e))


def _block(  # type: ignore[no-untyped-def]
    typing, n, n_outputs, lanes, chunks,
    steps, a, a_step, a_row, a_column, c, drives, out, out_step, out_row, x, x_row,
):  # fmt: skip
    """Run one block of ``lanes * chunks`` columns; the first four arguments are constants."""
    shape = [kind.literal_value for kind in (n, n_outputs, lanes, chunks)]

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _emit(Writer(builder), arguments[4:], *shape)
        return context.get_dummy_value()

    return types.void(n, n_outputs, lanes, chunks, *[types.intp] * 12), codegen


_run: Any = intrinsic(prefer_literal=True)(_block)


@lru_cache(maxsize=64)
def recursion(n_states: int, n_outputs: int) -> Respond:
    """Return the compiled batch recursion for a number of states and outputs.

    It is called as ``respond(A, C, drives, row, out, first, x)``:

    A : ndarray, shape (n_steps, n_states, n_states), any strides
        Also a transposed or time-reversed view.
    C : ndarray, shape (n_outputs, n_states), C-contiguous
    drives : ndarray, shape (n_steps, 1 or n_states, n_columns), last axis contiguous
        What is added to the state; with one row it is added to the state ``row``.
    row : int
        The driven state, or -1 when the drives have a row for each.
    out : ndarray, shape (n_steps, n_outputs, any), last axis contiguous
        Filled from the column ``first`` on with C x(k), before the step.
    x : ndarray, shape (n_states, n_columns)
        State at the begin, overwritten by the state after the last step.
    """
    n, wide = n_states, chunks_in_registers(n_states)
    middle = max(wide - 1, 1)
    stretch = max(16, STRETCH // (n * n))

    def respond(A, C, drives, row, out, first, x):  # type: ignore[no-untyped-def]
        n_steps, n_columns = A.shape[0], x.shape[1]
        a_step, a_row, a_column = A.strides
        out_step, out_row, c = out.strides[0], out.strides[1], C.ctypes.data
        nothing = np.zeros(n_columns)
        table = np.empty((n, 2), np.int64)
        d = table.ctypes.data
        for start in range(0, n_steps, stretch):
            steps = min(stretch, n_steps - start)
            a = A.ctypes.data + start * a_step
            y = out.ctypes.data + start * out_step + 8 * first
            state = x.ctypes.data
            for e in range(n):
                if row < 0 or row == e:
                    channel = e if row < 0 else 0
                    table[e, 0] = drives.ctypes.data + start * drives.strides[0] + channel * drives.strides[1]
                    table[e, 1] = drives.strides[0]
                else:
                    table[e, 0], table[e, 1] = nothing.ctypes.data, 0
            left = n_columns
            while left > 0:
                if left >= LANES * wide:
                    _run(n, n_outputs, LANES, wide, steps, a, a_step, a_row, a_column, c, d,
                         y, out_step, out_row, state, x.strides[0])  # fmt: skip
                    moved = LANES * wide
                elif left >= LANES * middle:
                    _run(n, n_outputs, LANES, middle, steps, a, a_step, a_row, a_column, c, d,
                         y, out_step, out_row, state, x.strides[0])  # fmt: skip
                    moved = LANES * middle
                elif left >= LANES:
                    _run(n, n_outputs, LANES, 1, steps, a, a_step, a_row, a_column, c, d,
                         y, out_step, out_row, state, x.strides[0])  # fmt: skip
                    moved = LANES
                else:
                    _run(n, n_outputs, 1, 1, steps, a, a_step, a_row, a_column, c, d,
                         y, out_step, out_row, state, x.strides[0])  # fmt: skip
                    moved = 1
                left -= moved
                y += 8 * moved
                state += 8 * moved
                for e in range(n):
                    table[e, 0] += 8 * moved
        # Addresses alone do not keep arrays alive: both are used once more.
        return nothing.size + table.size

    return cast(Respond, compiled(respond))


def plain(A: Floats, C: Floats, drives: Floats, row: int, out: Floats, first: int, x: Floats) -> int:
    """Do what `recursion` compiles, step by step in NumPy: the form to check it by and to compare times."""
    columns = slice(first, first + x.shape[1])
    for k in range(A.shape[0]):
        out[k, :, columns] = C @ x
        moved = A[k] @ x
        if row < 0:
            moved += drives[k]
        else:
            moved[row] += drives[k, 0]
        x[:] = moved
    return 0
