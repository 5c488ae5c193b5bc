"""Numbers as a reader wants them: the digits that the uncertainty allows, true minus signs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from numbers import Integral, Real

MINUS = "\N{MINUS SIGN}"
MISSING = "\N{EN DASH}"
TIED = "\N{NO-BREAK SPACE}"
_THIN = "\N{NARROW NO-BREAK SPACE}"
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def number(value: object, std_error: float | None = None, digits: int = 4) -> str:
    """Write one value.

    Parameters
    ----------
    value : object
        A number, ``None`` (a dash), a truth value (yes, no) or a text (unchanged).
    std_error : float, optional
        Standard error of the value: it decides the last digit shown (two digits of the error).
    digits : int
        Significant digits where no standard error is known; trailing zeros of the fraction are dropped.

    Returns
    -------
    str

    Examples
    --------
    >>> number(-0.83331746, std_error=0.0042)
    '−0.8333'
    >>> number(0.000012345), number(None), number(1000), number(True)
    ('1.234×10⁻⁵', '–', '1000', 'yes')
    """
    if value is None:
        return MISSING
    if isinstance(value, bool) or type(value).__name__ == "bool":
        return "yes" if value else "no"
    if not isinstance(value, Real):
        return str(value)
    if isinstance(value, Integral):
        return _grouped(int(value))
    size = float(value)
    if not math.isfinite(size):
        return "not a number" if math.isnan(size) else ("∞" if size > 0 else MINUS + "∞")
    if std_error is not None and math.isfinite(std_error) and std_error > 0:
        return _to_decimals(size, _decimals(std_error))
    return _significant(size, digits)


def with_error(value: float | None, std_error: float | None) -> str:
    """Write a value with its standard error, both to the error's second digit.

    Examples
    --------
    >>> with_error(-0.00123, 0.0031).replace(TIED, " ")
    '−0.0012 ± 0.0031'
    """
    if value is None or std_error is None or not math.isfinite(std_error) or std_error <= 0:
        return number(value)
    return f"{number(value, std_error)}{TIED}±{TIED}{number(std_error, std_error)}"


def values(value: object, digits: int = 4) -> str:
    """Write a number, a text, a list or a mapping of them in one line.

    Examples
    --------
    >>> values([-0.83, -0.17, 1.0, 1.0])
    '(−0.83, −0.17, 1, 1)'
    >>> values({"lower": 0.5, "upper": None})
    'lower 0.5, upper –'
    """
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {values(item, digits)}" for key, item in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "(" + ", ".join(values(item, digits) for item in value) + ")"
    return number(value, digits=digits)


def formatted(value: object, specification: str) -> str:
    """Write a value by a format specification, with true minus signs and powers of ten.

    Examples
    --------
    >>> formatted(-1.5e-9, ".1e"), formatted(0.0, ".1e"), formatted(12.345, ".1f")
    ('−1.5×10⁻⁹', '0', '12.3')
    """
    plain = format(value, specification)
    found = re.fullmatch(r"(-?[0-9.]+)e([+-][0-9]+)", plain)
    if found is None:
        return plain.replace("-", MINUS) if isinstance(value, Real) else plain
    if float(found[1]) == 0:
        return "0"
    power = int(found[2])
    return _signed(found[1]) + (f"×10{str(power).translate(_RAISED)}" if power else "")


def _decimals(std_error: float) -> int:
    return 1 - math.floor(math.log10(std_error))


def _to_decimals(size: float, decimals: int) -> str:
    if decimals > 7 or decimals < -6:
        return _scientific(size, max(1, decimals + 1 + _exponent(size)))
    rounded = round(size, decimals)
    return _signed(f"{rounded:.{max(decimals, 0)}f}")


def _significant(size: float, digits: int) -> str:
    if size == 0:
        return "0"
    exponent = _exponent(size)
    if not -5 < exponent < 7:
        return _scientific(size, digits)
    text = f"{size:.{max(digits - 1 - exponent, 0)}f}"
    return _signed(text.rstrip("0").rstrip(".") if "." in text else text)


def _exponent(size: float) -> int:
    return math.floor(math.log10(abs(size))) if size else 0


def _scientific(size: float, digits: int) -> str:
    mantissa, _, exponent = f"{size:.{digits - 1}e}".partition("e")
    if "." in mantissa:
        mantissa = mantissa.rstrip("0").rstrip(".")
    return f"{_signed(mantissa)}×10{str(int(exponent)).translate(_RAISED)}"


def _signed(text: str) -> str:
    digits = text.lstrip("-")
    negative = text.startswith("-") and any(char in "123456789" for char in digits)
    return (MINUS if negative else "") + digits


def _grouped(count: int) -> str:
    digits = str(abs(count))
    text = f"{abs(count):,}".replace(",", _THIN) if len(digits) > 4 else digits
    return (MINUS if count < 0 else "") + text
