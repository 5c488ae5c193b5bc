"""Effects of which a record shows too little to be told from something simpler."""

import numpy as np

from sysid.data import Record
from sysid.diagnosis.effects.base import Effect

# A jump at zero is a constant to an input of one sign.
AT_ZERO = frozenset({"in_preload"})
# Share of the rows with another sign that shows the jump.
FEWEST = 0.01
# A change of the gain is told from a load or a slow pole by two moves of the input before and two after it.
BY_THE_CLOCK, FEWEST_MOVES = "time_variation", 4


def shows(record: Record, effect: Effect) -> bool:
    """Tell whether a record can show an effect as something of its own.

    Examples
    --------
    >>> from sysid.data import make_record
    >>> from sysid.diagnosis.effects.catalogue import find_effects
    >>> (jump,) = find_effects(["in_preload"])
    >>> heating = np.random.default_rng(0).uniform(0.1, 1.0, 200)
    >>> [shows(make_record(u, u, period=1.0), jump) for u in (heating, heating - 0.5)]
    [False, True]
    >>> (variation,) = find_effects(["time_variation"])
    >>> steps = [np.repeat(levels, 200 // len(levels)) for levels in ([0.0, 7.0, 3.0, 0.0], range(20))]
    >>> [shows(make_record(u, u, period=1.0), variation) for u in steps]
    [False, True]
    """
    if effect.name == BY_THE_CLOCK:
        return int(np.count_nonzero(np.diff(record.u[record.learning, 0]))) >= FEWEST_MOVES
    if effect.name not in AT_ZERO:
        return True
    signs = np.sign(record.u[record.learning, 0])
    return all(float(np.mean(signs != sign)) >= FEWEST for sign in (-1.0, 1.0))
