"""Effects that act within a difference equation: forces and gains, as compiled runs take them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.laws import (
    drive_of,
    drive_signature,
    no_drive,
    no_rows,
    pointer_of,
    rows_of,
    rows_signature,
)
from sysid.diagnosis.linear.drive_slopes import drive_slopes
from sysid.diagnosis.structures.structure import Choice
from sysid.errors import UsageError

# Their ports; the compiled run takes so many.
DRIVING, MOST_DRIVES = ("force", "gain"), 2
# How many there are, and each law with its parameters.
Given = tuple[int, Any, Floats, Any, Floats]
_NONE = np.empty(0)
# Slopes without drives: the input acts as it is.
_FREE = np.array([[1.0], [0.0], [0.0]])


class Drives:
    """The effects of a chain that see its output and change its input.

    Parameters
    ----------
    choices : sequence of Choice
        Of these ports.
    """

    def __init__(self, choices: Sequence[Choice]) -> None:
        if len(choices) > MOST_DRIVES:
            raise UsageError(
                f"{len(choices)} forces are asked for in a linear model: take at most {MOST_DRIVES}"
            )
        self.count, none = len(choices), MOST_DRIVES - len(choices)
        self.rows = [rows_of(choice.effect, choice.form) for choice in choices]
        if choices:
            laws = [*(drive_of(choice.effect, choice.form) for choice in choices), *[no_drive()] * none]
            self._laws = [pointer_of(law, drive_signature()) for law in laws]
            of_rows = [*self.rows, *[no_rows()] * none]
            self._laws_of_rows = [pointer_of(law, rows_signature()) for law in of_rows]
        self._scaled = any(choice.effect.port == "gain" for choice in choices)
        strengths = [p.is_strength for choice in choices for p in choice.form.parameters]
        self._strengths = np.array(strengths, dtype=bool)

    def given(self, parameters: Sequence[Floats]) -> Given:
        """Return the laws as a compiled run takes them, with the parameters of each."""
        p, q = [*parameters, _NONE][:MOST_DRIVES]
        return self.count, self._laws[0], p, self._laws[1], q

    def slopes(
        self, x: Floats, z: Floats, speed: Floats, parameters: Sequence[Floats], wanted: Mask
    ) -> Floats:
        """Return the derivative of what acts by input, position, speed and the ``wanted`` parameters.

        Shape (3 + n_wanted, n_rows).
        """
        if not self.count:
            return _FREE
        p, q = [*parameters, _NONE][:MOST_DRIVES]
        first, second = self._laws_of_rows
        return np.asarray(
            drive_slopes(x, z, speed, self.count, first, p, second, q, self._scaled, wanted, self._strengths)
        )

    def acting(self, x: Floats, z: Floats, speed: Floats, parameters: Sequence[Floats]) -> Floats:
        """Return the input that acts."""
        for law, p in zip(self.rows, parameters, strict=True):
            acting = np.empty(x.size)
            law(x, z, speed, p, acting)
            x = acting
        return x


def too_many_drives(choices: Sequence[Choice]) -> bool:
    """Tell whether more effects act within the equation than the compiled run takes."""
    return sum(choice.effect.port in DRIVING for choice in choices) > MOST_DRIVES
