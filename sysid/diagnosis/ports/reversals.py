"""Whether a force over the velocity changes where the velocity changes its sign."""

import numpy as np

from sysid.diagnosis.ports.uncertainty import Shape
from sysid.diagnosis.wording import NORMAL_95
from sysid.linear.forms import Floats

# Velocities below this share of their root mean square count as near zero.
NEAR_ZERO = 0.25
# Places whose data are less dense than this share of the mean tell nothing.
SPARSE = 0.02
# The change around zero stands out if it is so many times the largest one elsewhere.
STANDS_OUT = 2.0


def change_at_reversal(shape: Shape) -> tuple[float, float] | None:
    """Return by how much a force changes around zero velocity, and up to which speed.

    The change between the two sides of zero, less than a quarter of the root mean square velocity
    away, counts if the bands of the two sides are apart and if it is twice the largest change over
    a range of the same width elsewhere, where there are data.

    Parameters
    ----------
    shape : Shape
        Of a map that depends on the velocity.

    Returns
    -------
    tuple of float or None
        Size of the change and the speed; None if nothing stands out.

    Examples
    --------
    >>> import numpy as np
    >>> v = np.linspace(-1.0, 1.0, 101)
    >>> density, spread = np.full(101, 0.5), np.full(101, 0.01)
    >>> change, speed = change_at_reversal(Shape(v, np.tanh(20.0 * v), spread, density))
    >>> round(change, 1), round(speed, 2)
    (2.0, 0.15)
    >>> change_at_reversal(Shape(v, v**3, spread, density)) is None
    True
    """
    value, step = shape.value, float(shape.value[1] - shape.value[0])
    weight = shape.density * step
    speed = NEAR_ZERO * float(np.sqrt(np.sum(weight * value**2) / max(float(weight.sum()), 1e-300)))
    if not (value[0] < -speed < speed < value[-1]):
        return None
    centre, spread = _at(shape.centre, value, speed), _at(shape.spread, value, speed)
    change = abs(float(centre[1] - centre[0]))
    if change <= NORMAL_95 * float(spread.sum()):
        return None
    width = max(round(2.0 * speed / step), 1)
    first, last = value[:-width], value[width:]
    known = shape.density > SPARSE * float(shape.density.mean())
    elsewhere = known[:-width] & known[width:] & ((first >= speed) | (last <= -speed))
    others = np.abs(shape.centre[width:] - shape.centre[:-width])[elsewhere]
    if others.size == 0 or change < STANDS_OUT * float(others.max()):
        return None
    return change, speed


def _at(curve: Floats, value: Floats, speed: float) -> Floats:
    return np.interp([-speed, speed], value, curve)
