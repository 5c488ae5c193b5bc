"""Fits that a structure has made: the same one is asked for again when effects are seen again."""

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.structure import Choice, Effort, StructureFit

# Fits that are kept, the latest.
KEPT = 256


class Memory:
    """The latest fits of a structure, by all that they depend on.

    Examples
    --------
    >>> memory = Memory()
    >>> key = ("what a fit depends on",)
    >>> memory.recalled(key, lambda: "fit"), memory.recalled(key, lambda: "another")
    ('fit', 'fit')
    """

    def __init__(self) -> None:
        self._fits: OrderedDict[Hashable, StructureFit] = OrderedDict()

    def recalled(self, key: Hashable, make: Callable[[], StructureFit]) -> StructureFit:
        """Return the fit of a key, made if it is not known.

        Two threads that ask at a time both make it, alike.
        """
        found = self._fits.get(key)
        if found is None:
            found = make()
            self._fits[key] = found
            while len(self._fits) > KEPT:
                self._fits.popitem(last=False)
        return found


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
