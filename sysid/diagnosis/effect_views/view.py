"""What a figure of an effect shows, as plain data."""

from dataclasses import dataclass

from sysid.diagnosis.effects.base import Floats

# The speed of a linear model.
PER_SAMPLE = "change in a sample"


@dataclass(frozen=True, eq=False)
class FreeCurve:
    """A curve of free form with its 95 % band, in the place of a law.

    Attributes
    ----------
    value, centre, lower, upper : ndarray, shape (n_points,)
    """

    value: Floats
    centre: Floats
    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class EffectView:
    """A law or a course of an effect.

    Attributes
    ----------
    effect : str
    kind : {"law", "loop", "course", "time"}
        What leaves by what enters; the same in the order of time; what enters and leaves over time;
        what is multiplied or added over time.
    quantity, unit, result, result_unit : str
        Of the two axes.
    value, law : ndarray, shape (n_points,)
    without : ndarray, shape (n_points,)
        The same without the effect.
    seen : ndarray, shape (n_rows,)
        Where the record is, on the horizontal axis; empty where that is the time.
    port : {"", "input", "position", "velocity"}
        Where a curve of free form would show the same.
    free : FreeCurve, optional
        What the data say of the law without knowing it.
    """

    effect: str
    kind: str
    quantity: str
    unit: str
    result: str
    result_unit: str
    value: Floats
    law: Floats
    without: Floats
    seen: Floats
    port: str = ""
    free: FreeCurve | None = None
