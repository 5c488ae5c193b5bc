"""Units that stand in a column's name, and times in another unit than seconds."""

import re
from collections.abc import Sequence

from sysid.data.labels import Floats

SECONDS = {
    "s": 1.0,
    "sec": 1.0,
    "second": 1.0,
    "seconds": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "µs": 1e-6,
    "μs": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
}
_NAMED = re.compile(r".*\S\s+\[([^\d\W][^\[\]]*|[%°][^\[\]]*)\]|.*\S\s+\(([^\d\W][^()]*|[%°][^()]*)\)")
# Endings that tell the unit of a time, and names that are such units.
_TIMED = {"ms": "ms", "us": "us", "ns": "ns", "millis": "ms", "micros": "us"}


def named_units(names: Sequence[str]) -> dict[str, str]:
    """Return the units that stand in brackets behind the names of columns.

    Examples
    --------
    >>> named_units(["speed [rad/s]", "u", "x[1]", "force (N)"])
    {'speed [rad/s]': 'rad/s', 'force (N)': 'N'}
    """
    found = {name: _NAMED.fullmatch(name) for name in names}
    return {name: (match[1] or match[2]).strip() for name, match in found.items() if match}


def per_second(unit: str) -> str:
    """Return the unit of a rate of change.

    Examples
    --------
    >>> per_second("m"), per_second("rad/s"), per_second("")
    ('m/s', 'rad/s^2', '1/s')
    """
    return f"{unit}^2" if unit.endswith("/s") else f"{unit or '1'}/s"


def time_unit(name: str) -> str:
    """Return the unit that the name of a time column ends with; empty if it tells none.

    Examples
    --------
    >>> time_unit("t_ms"), time_unit("millis"), time_unit("terms")
    ('ms', 'ms', '')
    """
    return _TIMED.get(re.split(r"[\W_]+", name.strip().lower())[-1], "")


def in_seconds(times: Floats, name: str, unit: str, remarks: list[str]) -> Floats:
    """Return times in seconds if their unit is known; add a remark where they were in another one."""
    factor = SECONDS.get(unit, 1.0)
    if factor == 1.0:
        return times
    remarks.append(f"The times in {name!r} are in {unit}: they were brought to seconds.")
    return times * factor
