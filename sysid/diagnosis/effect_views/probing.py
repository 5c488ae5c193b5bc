"""What a map depends on, found by trying it."""

from collections.abc import Callable

import numpy as np

from sysid.diagnosis.effects.base import Floats

# So many rows are changed, one at a time, to see which others feel it.
PROBES = 64


def is_instantaneous(passed: Callable[[Floats], Floats], seen: Floats) -> bool:
    """Tell whether what leaves a map depends on what enters in the same row alone, tried on values seen.

    Examples
    --------
    >>> import numpy as np
    >>> seen = np.linspace(-1.0, 1.0, 50)
    >>> is_instantaneous(np.abs, seen), is_instantaneous(np.cumsum, seen)
    (True, False)
    """
    rng = np.random.default_rng(0)
    # Behind a switch few rows are at rest, but it is there that play shows what was before.
    values = np.unique(seen)
    mixed = rng.choice(values, seen.size)
    before = passed(mixed)
    for row in rng.integers(seen.size, size=PROBES):
        other = mixed.copy()
        other[row] = rng.choice(values)
        moved = passed(other) != before
        moved[row] = False
        if moved.any():
            return False
    return True


def is_static(passed: Callable[[Floats], Floats], seen: Floats) -> bool:
    """Tell whether a map that depends on no other row does not depend on the time either.

    Examples
    --------
    >>> import numpy as np
    >>> seen = np.linspace(-1.0, 1.0, 50)
    >>> is_static(np.abs, seen), is_static(lambda s: s + np.arange(s.size), seen)
    (True, False)
    """
    rng = np.random.default_rng(0)
    order = rng.permutation(seen.size)
    return bool(np.array_equal(passed(seen[order]), passed(seen)[order]))
