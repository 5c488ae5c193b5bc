"""Published values: read from the claims file of a paper and held against what is found."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources.abc import Traversable
from typing import Any

from sysid.errors import UsageError

VERDICTS = ("reproduced", "replicated", "partial", "not replicated")
_TOLERANCES = {
    "exact": (),
    "digits": ("decimals",),
    "relative": ("tolerance",),
    "monte-carlo-band": (),
    "slope": ("tolerance",),
}
"""Tolerance types and the parameters each needs."""
_KEYS = {"id", "where", "printed", "number", "unit", "verdict", "tolerance", "note"}


@dataclass(frozen=True)
class Claim:
    """One printed value and what is found in its place.

    Attributes
    ----------
    id : str
        Name, unique within a paper.
    where : str
        Place in the paper.
    printed : float or str
        The printed value; a printed formula is a string.
    number : str
        Identifier of the number of ours it is held against.
    unit : str
        Unit of the value.
    verdict : str
        What is expected: reproduced, replicated, partial or not replicated.
    tolerance : mapping
        ``type`` and its parameters.
    note : str
        Why, where the verdict needs a reason.
    value : float or None
        Ours.
    lower, upper : float or None
        Interval the printed value (or, for a relative or digit tolerance, ours) must lie in.
    passed : bool
        Whether the expected verdict holds.
    """

    id: str
    where: str
    printed: float | str
    number: str
    unit: str
    verdict: str
    tolerance: Mapping[str, Any]
    note: str = ""
    value: float | None = None
    lower: float | None = None
    upper: float | None = None
    passed: bool = False

    def to_json(self) -> dict[str, Any]:
        """Return the claim as JSON types."""
        return {
            "id": self.id,
            "where": self.where,
            "printed": self.printed,
            "unit": self.unit,
            "value": self.value,
            "verdict": self.verdict,
            "tolerance": {**self.tolerance, "lower": self.lower, "upper": self.upper},
            "passed": self.passed,
            "note": self.note,
        }


def read(source: Traversable) -> list[Claim]:
    """Read a claims file.

    Parameters
    ----------
    source : Traversable
        TOML file with an array ``claim`` of tables.

    Returns
    -------
    list of Claim
        Claims without our values.

    Raises
    ------
    UsageError
        If the file is not TOML, a claim has an unknown key, verdict or tolerance, or an id is used twice.
    """
    try:
        entries = tomllib.loads(source.read_text(encoding="utf-8")).get("claim")
    except OSError as error:
        raise UsageError(
            f"{source.name} cannot be read ({error.strerror}): install the paper again"
        ) from None
    except UnicodeDecodeError as error:
        raise UsageError(f"{source.name} is not UTF-8 text (byte {error.start}): save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{source.name} is not TOML: {error}") from None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise UsageError(f"{source.name} has no array of tables [[claim]]: write one table a claim")
    claims: list[Claim] = []
    for entry in entries:
        name = entry.get("id", f"number {len(claims) + 1}")
        unknown = set(entry) - _KEYS
        missing = _KEYS - {"note"} - set(entry)
        if unknown or missing:
            fault = f"unknown key {sorted(unknown)[0]!r}" if unknown else f"no {sorted(missing)[0]!r}"
            raise UsageError(f"{source.name}: claim {name} has {fault}; keys are {', '.join(sorted(_KEYS))}")
        if entry["verdict"] not in VERDICTS:
            raise UsageError(
                f"{source.name}: claim {name} has verdict {entry['verdict']!r}; "
                f"use one of {', '.join(VERDICTS)}"
            )
        for key in sorted(set(entry) - {"tolerance"}):
            if not isinstance(entry[key], str) and not (key == "printed" and _is_number(entry[key])):
                raise UsageError(f"{source.name}: claim {name} has {key} = {entry[key]!r}: give it as a text")
        _check_tolerance(f"{source.name}: claim {name}", entry["tolerance"])
        if any(claim.id == entry["id"] for claim in claims):
            raise UsageError(f"{source.name}: claim id {name} is used twice")
        claims.append(Claim(**entry))
    return claims


def _check_tolerance(what: str, tolerance: Any) -> None:
    kind = tolerance.get("type") if isinstance(tolerance, dict) else tolerance
    if not isinstance(tolerance, dict) or not isinstance(kind, str) or kind not in _TOLERANCES:
        raise UsageError(f"{what} has tolerance type {kind!r}; use one of {', '.join(_TOLERANCES)}")
    for key in _TOLERANCES[kind]:
        if key not in tolerance:
            raise UsageError(f"{what} has a tolerance of type {kind} without a number {key!r}: add it")
    for key in {"decimals", "tolerance"} & set(tolerance):
        value = tolerance[key]
        if not _is_number(value) or value < 0 or (key == "decimals" and value != int(value)):
            raise UsageError(
                f"{what} has {key} = {value!r} in its tolerance, which is no {'whole ' * (key == 'decimals')}"
                "number from 0: correct it"
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def judge(claim: Claim, value: float, band: tuple[float, float] | None = None) -> Claim:
    """Hold a claim against our value.

    Parameters
    ----------
    claim : Claim
        As read from the file.
    value : float
        Ours; for a Monte-Carlo band the centre of the distribution.
    band : pair of float, optional
        Interval of single runs that the printed value must meet (Monte-Carlo band).

    Returns
    -------
    Claim
        With value, interval and verdict; a printed value counts with its rounding.  A value or band
        that is not finite passes no verdict, "not replicated" included.

    Raises
    ------
    UsageError
        If the printed value is a formula or the band is missing.

    Examples
    --------
    >>> tolerance = {"type": "monte-carlo-band", "decimals": 2}
    >>> claim = Claim("a", "Table 1", 1.02, "a", "", "replicated", tolerance)
    >>> judge(claim, 1.0, (0.9, 1.1)).passed
    True
    """
    try:
        printed = float(claim.printed)
    except ValueError:
        raise UsageError(
            f"claim {claim.id} prints {claim.printed!r}, which is no number: give `printed` as a number"
        ) from None
    kind = claim.tolerance["type"]
    half = 0.5 * 10.0 ** -int(claim.tolerance["decimals"]) if "decimals" in claim.tolerance else 0.0
    if kind == "monte-carlo-band":
        if band is None:
            raise UsageError(f"claim {claim.id} needs the band of the Monte-Carlo runs")
        lower, upper = band
        half += 1e-12 * max(abs(printed), half)  # the rounding of the printed decimal to binary
        agrees = printed + half >= lower and printed - half <= upper
    else:
        if kind == "relative":
            half = abs(printed) * float(claim.tolerance["tolerance"])
        elif kind == "slope":
            half = float(claim.tolerance["tolerance"])
        slack = 1e-12 * max(abs(printed), half)
        lower, upper = printed - half - slack, printed + half + slack
        agrees = lower <= value <= upper
    expected = claim.verdict != "not replicated"
    known = all(map(math.isfinite, (value, lower, upper)))
    return replace(
        claim,
        value=value if math.isfinite(value) else None,
        lower=lower if math.isfinite(lower) else None,
        upper=upper if math.isfinite(upper) else None,
        passed=known and agrees == expected,
    )
