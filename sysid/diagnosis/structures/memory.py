"""What a structure has made and is asked for again: fits when effects are seen again, grids of a search."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from typing import Generic, Protocol, TypeVar

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import Choice, Effort, StructureFit

# What is kept, the latest.
KEPT = 256

Made = TypeVar("Made")


class Fitting(Protocol):
    """A fit of effects by a structure; see `sysid.diagnosis.structures.structure.Structure.fit`."""

    def __call__(
        self, choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, effort: Effort
    ) -> StructureFit:
        """Fit them."""


class Memory(Generic[Made]):
    """The latest things that were made, by all that they depend on.

    Examples
    --------
    >>> memory = Memory()
    >>> key = ("what a fit depends on",)
    >>> memory.recalled(key, lambda: "fit"), memory.recalled(key, lambda: "another")
    ('fit', 'fit')
    """

    def __init__(self) -> None:
        self._made: OrderedDict[Hashable, Made] = OrderedDict()

    def recalled(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """Return what belongs to a key, made if it is not known.

        Two threads that ask at a time both make it, alike.
        """
        found = self._made.get(key)
        if found is None:
            found = make()
            self._made[key] = found
            while len(self._made) > KEPT:
                self._made.popitem(last=False)
        return found


class Fits(Memory[StructureFit]):
    """The latest fits of a structure."""

    def fitted(
        self,
        fit: Fitting,
        choices: Sequence[Choice],
        rows: Mask,
        noise: Floats,
        start: StructureFit,
        effort: Effort,
    ) -> StructureFit:
        """Return a fit, made if it was not asked for before."""
        key = key_of(choices, rows, noise, start, effort)
        return self.recalled(key, lambda: fit(choices, rows, noise, start, effort))


def key_of(
    choices: Sequence[Choice], rows: Mask, noise: Floats, start: StructureFit, effort: Effort
) -> tuple[Hashable, ...]:
    """Return all that a fit depends on, its structure apart; effects stand by their names."""
    return (
        tuple((choice.name, choice.form.name) for choice in choices),
        rows.tobytes(),
        noise.tobytes(),
        tuple((choice.name, choice.form.name) for choice in start.choices),
        start.point.tobytes(),
        start.rows.tobytes(),
        start.restarts_agree,
        effort,
    )
