"""The one recursion behind everything: x(k+1) = A_k x(k) + d(k), y(k) = C x(k), for many drives d at once.

A batch of systems shares A_k and C.  A block of columns of the batch is kept in vector registers over a
stretch of time, so that a step costs its multiplications and nothing else; the code is written out for the
numbers of states and outputs, as compilers do not find this form in loops over arrays.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba.core import cgutils as untyped_cgutils
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from sysid._compile import compiled

Floats = NDArray[np.float64]
Respond = Callable[[Floats, Floats, Floats, int, Floats, int, Floats], int]

LANES = 4
STRETCH = 4096
"""Entries of A_k that are used for all columns before the next: half of a first-level cache."""

cgutils: Any = untyped_cgutils
_WORD = ir.IntType(64)
_REAL = ir.DoubleType()


def chunks_in_registers(n_states: int) -> int:
    """Return how many vectors of columns one block has, so that states and sums fit the registers."""
    return 3 if n_states <= 4 else 2 if n_states <= 8 else 1


def _emit(builder: Any, arguments: Any, n: int, n_outputs: int, lanes: int, chunks: int) -> None:
    """Write the loop over time for one block of columns; addresses and strides are in bytes."""
    steps, a, a_step, a_row, a_column, c, drives, out, out_step, out_row, x, x_row = arguments
    vector = ir.VectorType(_REAL, lanes) if lanes > 1 else _REAL
    # Fused where the processor can, and otherwise two instructions: never a call.
    multiply_add = cgutils.get_or_insert_function(
        builder.module,
        ir.FunctionType(vector, [vector] * 3),
        f"llvm.fmuladd.v{lanes}f64" if lanes > 1 else "llvm.fmuladd.f64",
    )

    def word(value: int) -> Any:
        return ir.Constant(_WORD, value)

    def along(base: Any, stride: Any, count: int) -> Any:
        return builder.add(base, builder.mul(stride, word(count))) if count else base

    def pointer(address: Any, kind: Any) -> Any:
        return builder.inttoptr(address, kind.as_pointer())

    def load(address: Any, kind: Any) -> Any:
        value = builder.load(pointer(address, kind))
        value.align = 8
        return value

    def store(value: Any, address: Any) -> None:
        builder.store(value, pointer(address, vector)).align = 8

    def spread(scalar: Any) -> Any:
        if lanes == 1:
            return scalar
        first = builder.insert_element(
            ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0)
        )
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
        return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)

    width = 8 * lanes
    gains = [[load(builder.add(c, word(8 * (o * n + b))), _REAL) for b in range(n)] for o in range(n_outputs)]
    bases = [load(builder.add(drives, word(16 * e)), _WORD) for e in range(n)]
    strides = [load(builder.add(drives, word(16 * e + 8)), _WORD) for e in range(n)]
    state = [[cgutils.alloca_once(builder, vector) for _ in range(chunks)] for _ in range(n)]
    for e in range(n):
        for j in range(chunks):
            address = builder.add(along(x, x_row, e), word(j * width))
            builder.store(load(address, vector), state[e][j])
    with cgutils.for_range(builder, steps, intp=_WORD) as loop:
        k = loop.index
        now = [[builder.load(state[e][j]) for j in range(chunks)] for e in range(n)]
        here = builder.add(out, builder.mul(k, out_step))
        for o in range(n_outputs):
            for j in range(chunks):
                total = builder.fmul(spread(gains[o][0]), now[0][j])
                for b in range(1, n):
                    total = builder.call(multiply_add, [spread(gains[o][b]), now[b][j], total])
                store(total, builder.add(along(here, out_row, o), word(j * width)))
        matrix = builder.add(a, builder.mul(k, a_step))
        for e in range(n):
            drive = builder.add(bases[e], builder.mul(k, strides[e]))
            sums = [load(builder.add(drive, word(j * width)), vector) for j in range(chunks)]
            for b in range(n):
                entry = spread(load(along(along(matrix, a_row, e), a_column, b), _REAL))
                for j in range(chunks):
                    sums[j] = builder.call(multiply_add, [entry, now[b][j], sums[j]])
            for j in range(chunks):
                builder.store(sums[j], state[e][j])
    for e in range(n):
        for j in range(chunks):
            store(builder.load(state[e][j]), builder.add(along(x, x_row, e), word(j * width)))


def _block(  # type: ignore[no-untyped-def]
    typing, n, n_outputs, lanes, chunks,
    steps, a, a_step, a_row, a_column, c, drives, out, out_step, out_row, x, x_row,
):  # fmt: skip
    """Run one block of ``lanes * chunks`` columns; the first four arguments are constants."""
    shape = [kind.literal_value for kind in (n, n_outputs, lanes, chunks)]

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        _emit(builder, arguments[4:], *shape)
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
