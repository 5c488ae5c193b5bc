"""Numbers and units as an engineer writes them."""

from collections.abc import Sequence
from math import floor, isfinite, log10

# 97.5 % quantile of the normal distribution.
NORMAL_95 = 1.959963984540054
PREFIXED_UNITS = ("m", "V", "A", "N", "W", "s", "Pa", "Hz", "J")
PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a value with its unit, with a prefix where the unit takes one.

    Examples
    --------
    >>> quantity(0.02013, "m")
    '20.1 mm'
    >>> quantity(1234.5, "rpm")
    '1230 rpm'
    """
    if not isfinite(value):
        return "not defined"
    if unit in PREFIXED_UNITS and value != 0.0:
        power = int(min(max(3 * floor(log10(abs(value)) / 3.0), min(PREFIXES)), max(PREFIXES)))
        return f"{significant(value / 10.0**power, digits)} {PREFIXES[power]}{unit}"
    return f"{significant(value, digits)} {unit}".strip()


def significant(value: float, digits: int = 3) -> str:
    """Write a value with so many significant digits, without an exponent where it is readable.

    Examples
    --------
    >>> significant(0.60389), significant(123456.0), significant(1.2e-7)
    ('0.604', '123000', '1.2e-07')
    """
    if value == 0.0 or not isfinite(value):
        return f"{value:g}"
    power = floor(log10(abs(value)))
    if not -4 <= power <= 6:
        return f"{value:.{digits}g}"
    rounded = round(value, digits - 1 - power)
    return f"{rounded:.{max(digits - 1 - power, 0)}f}"


def percent(share: float) -> str:
    """Write a share as a percentage.

    Examples
    --------
    >>> percent(0.9312), percent(0.0042), percent(0.99985), percent(1.0)
    ('93 %', '0.42 %', '99.98 %', '100 %')
    """
    value = 100.0 * share
    if not isfinite(value):
        return "not defined"
    if abs(value) < 99.0 or value >= 100.0:
        return f"{significant(value, 2 if abs(value) < 99.0 else 3)} %"
    return f"{min(value, 99.99):.2f} %"


ORDINALS = (
    "zeroth",
    "first",
    "second",
    "third",
    "fourth",
    "fifth",
    "sixth",
    "seventh",
    "eighth",
    "ninth",
    "tenth",
)


def ordinal(number: int) -> str:
    """Write an order as a word: second, third, 12th."""
    return ORDINALS[number] if number < len(ORDINALS) else f"{number}th"


def interval_text(value: float, std_error: float | None) -> str:
    """Return the 95 % interval of a parameter, or a dash.

    Examples
    --------
    >>> interval_text(0.4, 0.01), interval_text(1.0, None)
    ('0.3804 to 0.4196', '–')
    """
    if std_error is None or not isfinite(std_error):
        return "–"
    half = NORMAL_95 * std_error
    return f"{value - half:.4g} to {value + half:.4g}"


def plus_minus(std_error: float) -> str:
    """Return half the 95 % interval behind its sign, or nothing where it is not known.

    Examples
    --------
    >>> plus_minus(0.01), plus_minus(float("nan"))
    ('± 0.020', '')
    """
    return f"± {significant(NORMAL_95 * std_error, 2)}" if isfinite(std_error) else ""


def all_of(names: Sequence[str]) -> str:
    """Join names of which all are meant.

    Examples
    --------
    >>> all_of(["the squared input", "the cubed input", "the squared output"])
    'the squared input, the cubed input and the squared output'
    >>> all_of([])
    ''
    """
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def value_beside(value: float, std_error: float) -> str:
    """Return a value down to the last digit of `plus_minus`, four significant digits where that is not known.

    Examples
    --------
    >>> value_beside(0.46213, 0.000277), value_beside(0.46213, 1.2), value_beside(0.46213, float("nan"))
    ('0.46213', '0.5', '0.4621')
    """
    interval = plus_minus(std_error)
    if not interval or "e" in interval or not isfinite(value):
        return significant(value, 4)
    return f"{value:.{len(interval.partition('.')[2])}f}"
