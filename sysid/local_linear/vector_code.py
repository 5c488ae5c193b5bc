"""Straight-line vector instructions for small loops of fixed size, written for the compiler's back end.

Compilers do not keep small arrays in registers over a loop that reads and writes memory.  Code that is
written out for the sizes of a model does, with vectors as wide as the sizes are: the back end splits them.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import cgutils as untyped_cgutils

cgutils: Any = untyped_cgutils
WORD = ir.IntType(64)
REAL = ir.DoubleType()
INDEX = ir.IntType(32)
BYTES = 8


class Writer:
    """Writes instructions at the place of a builder; addresses and strides are in bytes."""

    def __init__(self, builder: Any) -> None:
        self.builder = builder

    @staticmethod
    def kind(lanes: int) -> Any:
        """Return the type of a vector, a plain number for one lane."""
        return ir.VectorType(REAL, lanes) if lanes > 1 else REAL

    @staticmethod
    def word(value: int) -> Any:
        """Return a whole number."""
        return ir.Constant(WORD, value)

    def along(self, base: Any, stride: Any, count: int) -> Any:
        """Return base + count * stride for a count that is known now."""
        return self.step(base, stride, self.word(count)) if count else base

    def entry(self, base: Any, index: int) -> Any:
        """Return the address of an entry of a contiguous array."""
        return self.builder.add(base, self.word(BYTES * index)) if index else base

    def step(self, base: Any, stride: Any, k: Any) -> Any:
        """Return base + k * stride for an index of a loop."""
        return self.builder.add(base, self.builder.mul(stride, k))

    def load(self, address: Any, lanes: int = 1) -> Any:
        """Return what stands at an address."""
        return self._load(address, self.kind(lanes))

    def load_word(self, address: Any) -> Any:
        """Return the whole number at an address."""
        return self._load(address, WORD)

    def _load(self, address: Any, kind: Any) -> Any:
        value = self.builder.load(self.builder.inttoptr(address, kind.as_pointer()))
        value.align = BYTES
        return value

    def store(self, value: Any, address: Any) -> None:
        """Put a value at an address."""
        self.builder.store(value, self.builder.inttoptr(address, value.type.as_pointer())).align = BYTES

    def variable(self, lanes: int = 1, value: Any = None) -> Any:
        """Return a place for a value that changes in a loop: a register, once the back end has seen it."""
        place = cgutils.alloca_once(self.builder, self.kind(lanes))
        if value is not None:
            self.builder.store(value, place)
        return place

    def zero(self, lanes: int = 1) -> Any:
        """Return zeros."""
        return ir.Constant(self.kind(lanes), [0.0] * lanes if lanes > 1 else 0.0)

    def spread(self, scalar: Any, lanes: int) -> Any:
        """Return a vector of equal entries."""
        if lanes == 1:
            return scalar
        nothing = ir.Constant(self.kind(lanes), ir.Undefined)
        return self.pick(self.put(nothing, 0, scalar), [0] * lanes)

    def pick(self, vector: Any, entries: Sequence[int]) -> Any:
        """Return the entries of a vector in the order given, each as often as named."""
        if not isinstance(vector.type, ir.VectorType):
            return self.spread(vector, len(entries))
        if len(entries) == 1:
            return self.builder.extract_element(vector, ir.Constant(INDEX, entries[0]))
        chosen = ir.Constant(ir.VectorType(INDEX, len(entries)), list(entries))
        return self.builder.shuffle_vector(vector, ir.Constant(vector.type, ir.Undefined), chosen)

    def multiply_add(self, a: Any, b: Any, c: Any) -> Any:
        """Return a b + c: fused where the processor can, and otherwise two instructions, never a call."""
        kind = c.type
        name = f"v{kind.count}f64" if isinstance(kind, ir.VectorType) else "f64"
        function = cgutils.get_or_insert_function(
            self.builder.module, ir.FunctionType(kind, [kind] * 3), f"llvm.fmuladd.{name}"
        )
        return self.builder.call(function, [a, b, c])

    def steps(self, count: Any) -> Any:
        """Return the context of a loop; its ``index`` counts from zero."""
        return cgutils.for_range(self.builder, count, intp=WORD)

    def products(self, left: Sequence[Any], right: Sequence[Any], total: Any = None) -> Any:
        """Return the sum of products of pairs, added to a total one after the other if there is one."""
        pairs = list(zip(left, right, strict=True))
        if total is None:
            total, pairs = self.builder.fmul(*pairs[0]), pairs[1:]
        for a, b in pairs:
            total = self.multiply_add(a, b, total)
        return total

    def sum(self, vector: Any) -> Any:
        """Return the sum of the entries of a vector, two halves at a time."""
        while isinstance(vector.type, ir.VectorType):
            count = vector.type.count
            half = count // 2
            total = self.builder.fadd(
                self.pick(vector, range(half)), self.pick(vector, range(half, 2 * half))
            )
            if count % 2:  # the last one goes to the first
                last, first = self.pick(vector, [count - 1]), self.pick(total, [0])
                total = self.put(total, 0, self.builder.fadd(first, last))
            vector = total
        return vector

    def put(self, vector: Any, index: int, value: Any) -> Any:
        """Return a vector with one entry replaced."""
        if not isinstance(vector.type, ir.VectorType):
            return value
        return self.builder.insert_element(vector, value, ir.Constant(INDEX, index))

    def vector(self, values: Sequence[Any]) -> Any:
        """Return numbers side by side."""
        found = ir.Constant(self.kind(len(values)), ir.Undefined)
        for i, value in enumerate(values):
            found = self.put(found, i, value)
        return found
