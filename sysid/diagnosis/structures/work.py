"""How much a whole search has simulated: counted, not timed, so that results repeat."""

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable


@dataclass
class Steps:
    """Steps that one fit has taken so far."""

    taken: int = 0


@dataclass
class Work:
    """Work of all fits of one search, in steps of a run without laws.

    A fit that is asked for again counts once, whether it was kept or is made anew, so that the sum depends
    neither on threads nor on memory.

    Attributes
    ----------
    given : float
        After so much no further stage of a search begins.
    whole : bool
        Whether the search counts only if it comes to its end: it is given up where it would have to stop.

    Examples
    --------
    >>> work = Work(given=100.0)
    >>> work.note("a fit", 60), work.note("another", 60), work.note("a fit", 60)
    (None, None, None)
    >>> work.done
    120
    """

    given: float
    whole: bool = False
    _parts: dict[int, int] = field(default_factory=dict, repr=False)

    def note(self, key: Hashable, amount: int) -> None:
        """Count what a fit has cost, by all that it depends on."""
        self._parts[hash(key)] = amount

    @property
    def done(self) -> int:
        """Work of all fits so far: to be read only while none is made."""
        return sum(self._parts.values())


@runtime_checkable
class Working(Protocol):
    """A structure that counts the work of its fits."""

    work: Work
