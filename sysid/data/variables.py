"""A variable of a file that is no text: its shape, its values, and why it can be no column."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import DataError


@dataclass(frozen=True)
class Variable:
    """One variable of a file.

    Attributes
    ----------
    shape : tuple of int
        As stored; of text, without the letters.
    load : callable
        Returns the values, as numbers or as text.
    unusable : str
        Why it can be no column, as the end of a sentence; empty if it can.
    """

    shape: tuple[int, ...]
    load: Callable[[], NDArray[Any]]
    unusable: str = ""

    @property
    def length(self) -> int:
        """Number of values."""
        return int(np.prod(self.shape, dtype=object))

    @property
    def objection(self) -> str:
        """Why it can be no column, with the remedy, or nothing."""
        if self.unusable:
            return self.unusable
        if self.length == 0:
            return "is empty: a column holds one value for each row"
        if self.length == 1:
            return "is a single value: a column holds one value for each row"
        if sum(size > 1 for size in self.shape) > 1:
            size = " x ".join(str(size) for size in self.shape)
            return f"has the shape {size}: a column is n x 1, so save each column under a name of its own"
        return ""


def refused(reason: str, shape: tuple[int, ...] = (1,)) -> Variable:
    """Return a variable that is listed and cannot be read."""

    def load() -> NDArray[Any]:
        raise DataError(reason)

    return Variable(shape, load, reason)


def by_type(dtype: np.dtype[Any]) -> str:
    """Return why values of this type are refused, or nothing."""
    kind = dtype.kind
    if kind in "biufUS":
        return ""
    if kind == "O":
        return "is an array of objects, which is not read: save it as plain numbers"
    if kind == "c":
        return "is complex: save its real and imaginary parts as two variables"
    if kind in "mM":
        return "holds dates: save the time as a number of seconds"
    return f"is an array of type {dtype}: save each column under a name of its own"
