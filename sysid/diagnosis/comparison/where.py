"""Where the error lies: shares of regions, tested together against an error that knows no regions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.diagnosis.comparison.bands import Band, band_shares
from sysid.diagnosis.comparison.regions import LARGEST_SHARE, Division, Region, by_experiment, divisions
from sysid.diagnosis.comparison.series import Series
from sysid.diagnosis.comparison.surrogates import Contrasts, examine
from sysid.diagnosis.wording import percent, quantity
from sysid.result_files import finite

LEVEL = 0.01
# A share that is significant and yet hardly larger than that of the data is not worth a sentence.
SMALLEST_ODDS = 1.5
SMALLEST_PULL = 0.005
# A region's share of the error is worth a word if it is this many times its share of the rows.
MORE_THAN_EVEN = 1.2
SMALLEST_EXPLAINED = 0.05
LISTED_WINDOWS = 3
FEWEST_ROWS = 60


@dataclass(frozen=True)
class Finding:
    """A region in which the error is concentrated.

    Attributes
    ----------
    kind : str
        ``"time"``, ``"input"``, ``"output"``, ``"velocity"``, ``"velocity-sign"``, ``"frequency"``
        or ``"experiment"``.
    region : dict
        Its bounds.
    error_share, data_share : float
        Share of the squared error, and the share expected if nothing failed there: that of the
        rows or, for a frequency, of the noise.
    p_value : float
        Of a contrast as large anywhere if nothing fails locally, corrected for all looks.
    sentence : str
    measure : {"free-run error", "newly arising error"}
        Which error the share is of.
    """

    kind: str
    region: dict[str, Any]
    error_share: float
    data_share: float
    p_value: float
    sentence: str
    measure: str = "free-run error"

    @property
    def contrast(self) -> float:
        """Error share over data share."""
        return self.error_share / max(self.data_share, 1e-300)

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "kind": self.kind,
            "region": self.region,
            "error_share": finite(self.error_share),
            "data_share": finite(self.data_share),
            "contrast": finite(self.contrast),
            "p_value": finite(self.p_value),
            "measure": self.measure,
            "sentence": self.sentence,
        }


@dataclass(frozen=True)
class Share:
    """A bar of a picture: shares of the squared error in one region, beside their expectation.

    Attributes
    ----------
    region : Region
    error_share, new_share : float
        Of the free-run error, and of the error that newly arises.
    data_share : float
    p_value, new_p_value : float
    """

    region: Region
    error_share: float
    data_share: float
    p_value: float
    new_share: float
    new_p_value: float

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "region": self.region.place,
            "error_share": finite(self.error_share),
            "data_share": finite(self.data_share),
            "p_value": finite(self.p_value),
            "new_error_share": finite(self.new_share),
            "new_error_p_value": finite(self.new_p_value),
        }


@dataclass(frozen=True)
class Location:
    """Where the error lies.

    Attributes
    ----------
    findings : tuple of Finding
        What is significant at 1 % over all looks and large enough to matter, the clearest first.
    shares : dict of str to tuple of Share
        For each kind, or kind and signal, the bars of its picture.
    bands : tuple of Band
        Power of the error and of the noise by frequency.
    """

    findings: tuple[Finding, ...]
    shares: dict[str, tuple[Share, ...]]
    bands: tuple[Band, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the shares of all bars."""
        found: dict[str, Any] = {
            name: [share.to_json() for share in shares] for name, shares in self.shares.items()
        }
        if self.bands:
            found["frequency"] = [band.to_json() for band in self.bands]
        return found


def locate(
    series: Series, learned: Series | None = None, progress: Callable[[int, int], None] | None = None
) -> Location:
    """Find where the error lies.

    Shares of the squared error are compared with the shares of the data for time windows, levels
    of inputs, output and velocity, the sign of the velocity and experiments, each for the free-run
    error and for the error that newly arises, and frequency bands with the noise.  The largest
    contrast of all is compared with the largest of all in series that follow the same linear noise
    model and know no regions: that corrects for the many looks.

    Parameters
    ----------
    series : Series
        The judged rows.
    learned : Series, optional
        Rows of the fit, of which the experiments are compared.
    progress : callable, optional
        Called with the number of steps done and to do.

    Returns
    -------
    Location
    """
    if series.places.size < FEWEST_ROWS or not series.residual.any():
        return Location((), {}, ())
    divided = divisions(series)
    bands = band_shares(series)
    fitted = by_experiment(learned) if learned is not None and np.ptp(learned.experiment) > 0 else None
    families = 1 + bool(bands) + (fitted is not None)
    evidence = examine(series, divided, progress)
    findings = [
        finding for division in divided for finding in _of_division(division, evidence, series, families)
    ]
    findings += _of_bands(bands, families, series)
    if fitted is not None and learned is not None:
        found = examine(learned, (fitted,), None)
        findings += _of_division(fitted, found, learned, families)
    shares: dict[str, tuple[Share, ...]] = {}
    for division in divided:
        shares[_key(division)] = shares.get(_key(division), ()) + _bars(division, evidence, series, families)
    shares = {name: bars for name, bars in shares.items() if bars}
    return Location(_clearest(findings), shares, bands)


def _clearest(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Sort by clearness; of two findings on the sign of the velocity keep the clearer one."""
    ordered = sorted(findings, key=_clearness, reverse=True)
    signs = [finding for finding in ordered if finding.kind == "velocity-sign"]
    return tuple(finding for finding in ordered if finding not in signs[1:])


def _clearness(finding: Finding) -> float:
    """Rank findings for the reader: by how far the shares are apart."""
    return _divergence(finding.error_share, finding.data_share)


def _key(division: Division) -> str:
    return division.kind if division.kind != "input" else division.signal


def _bars(
    division: Division, evidence: Sequence[Contrasts], series: Series, families: int
) -> tuple[Share, ...]:
    shares = division.share(series.residual**2)
    own = [e for e in evidence if e.division is division and e.statistic == "share"]
    free, new = own[0], own[-1]  # the last measure is that on the time scale of the motion
    return tuple(
        Share(
            region,
            float(shares[i]),
            float(division.data_share[i]),
            min(1.0, families * float(free.p_values[i])),
            float(new.error_share[i]),
            min(1.0, families * float(new.p_values[i])),
        )
        for i, region in enumerate(division.regions)
        if region.bar
    )


def _of_division(
    division: Division, evidence: Sequence[Contrasts], series: Series, families: int
) -> list[Finding]:
    """Return the clearest finding of a division; of time the worst windows that do not overlap."""
    candidates = []
    for found in (e for e in evidence if e.division is division):
        for index in np.flatnonzero(found.p_values * families <= LEVEL).tolist():
            if _matters(found, index):
                candidates.append((_plainness(found), -_information(found, index), found, index))
    candidates.sort(key=lambda item: item[:2])
    chosen: list[Finding] = []
    taken = np.zeros(division.members.shape[1], dtype=bool)
    for _, _, found, index in candidates:
        cells = division.members[index] > 0.0
        if (taken & cells).any():
            continue
        taken |= cells
        chosen.append(_finding(division, found, index, series, families))
        if len(chosen) == (LISTED_WINDOWS if division.kind == "time" else 1):
            break
    return chosen


def _plainness(found: Contrasts) -> int:
    """Rank the measures: a share of the error itself says most to a reader, a pull least."""
    return 0 if found.measure == "free" else 1 if found.statistic == "share" else 2


def _information(found: Contrasts, index: int) -> float:
    """Return how much a region tells: the divergence of error and data shares, or a pull's effect."""
    if found.statistic == "pull":
        return float(found.effect[index])
    return _divergence(found.error_share[index], found.data_share[index])


def _divergence(error_share: float, data_share: float) -> float:
    """Return s log(s/d) + (1-s) log((1-s)/(1-d)), zero if the shares are equal."""
    s, d = (float(np.clip(share, 1e-12, 1.0 - 1e-12)) for share in (error_share, data_share))
    return s * float(np.log(s / d)) + (1.0 - s) * float(np.log((1.0 - s) / (1.0 - d)))


def _matters(found: Contrasts, index: int) -> bool:
    """Tell whether a contrast is large enough to be worth a sentence."""
    share, data = found.error_share[index], found.data_share[index]
    if data > LARGEST_SHARE:
        return False
    if found.statistic == "share":
        return bool(share * (1.0 - data) >= SMALLEST_ODDS * data * (1.0 - share))
    return bool(found.effect[index] >= SMALLEST_PULL)


def _finding(division: Division, found: Contrasts, index: int, series: Series, families: int) -> Finding:
    region = division.regions[index]
    p_value = min(1.0, families * float(found.p_values[index]))
    error, data = float(found.error_share[index]), float(found.data_share[index])
    return Finding(
        division.kind,
        region.place,
        error,
        data,
        p_value,
        _sentence(division.kind, region, found, index, series),
        "free-run error" if found.measure == "free" else "newly arising error",
    )


def _sentence(kind: str, region: Region, found: Contrasts, index: int, series: Series) -> str:
    judged = series.judged
    error, data = percent(found.error_share[index]), percent(found.data_share[index])
    place = region.words if kind in ("time", "experiment") else f"while {region.words}"
    of_data = "of the rows" if kind == "experiment" else "of the time"
    if found.statistic == "pull":
        side = "above" if found.pull[index] > 0.0 else "below"
        where = place[0].upper() + place[1:]
        pulled = f"{where}, {data} {of_data}, the measurement is pulled {side} the model time and again"
        if found.error_share[index] < MORE_THAN_EVEN * found.data_share[index]:
            return f"{pulled}."
        return f"{pulled}; {error} of the error that newly arises on {judged} lies there."
    if found.measure == "free":
        return f"{error} of the squared error on {judged} lies {place}, {data} {of_data}."
    return f"{error} of the error that newly arises on {judged} comes {place}, {data} {of_data}."


def _of_bands(bands: tuple[Band, ...], families: int, series: Series) -> list[Finding]:
    """Return the frequency band in which most of the power follows the input, if any does."""
    significant = [
        band for band in bands if band.p_value * families <= LEVEL and band.explained >= SMALLEST_EXPLAINED
    ]
    if not significant:
        return []
    band = max(significant, key=lambda b: b.explained)
    low, high = quantity(band.low, "Hz"), quantity(band.high, "Hz")
    sentence = (
        f"Between {low} and {high} {percent(band.coherence)} of the error on {series.judged} follows the "
        f"input linearly: dynamics are missing there; the band holds {percent(band.error_share)} of the "
        f"error and {percent(band.noise_share)} of the noise."
    )
    return [
        Finding(
            "frequency",
            {"from_hz": band.low, "to_hz": band.high},
            band.error_share,
            band.noise_share,
            min(1.0, families * band.p_value),
            sentence,
        )
    ]
