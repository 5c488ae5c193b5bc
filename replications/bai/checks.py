"""The gates of Bai's paper: what must hold, how closely, and why."""

import math
from collections.abc import Mapping, Sequence

from scipy.special import ndtri

from replications.bai import example_2, setting
from replications.bai.worked import WORKED
from replications.errata import CORRECTED_TOLERANCE, Erratum, erratum_gates
from replications.studies import parameters_of, protocol_gates
from sysid import gates as gate
from sysid.claims import Claim
from sysid.gates import Gate
from sysid.montecarlo import Study

SMALL_SAMPLE_BIAS = 0.15
"""Bias allowed as a share of the standard deviation at N = 100: with lagged outputs as regressors least
squares is biased of order 1/N, up to 0.1 standard deviations here (measured over 20,000 runs)."""

HIGHER_ORDER = 0.04
"""Distance of an exponent over N = 100 .. 6400 from its limit that higher-order terms at N = 100 explain."""


def gates(
    studies: Mapping[str, Study],
    monte_carlo: Mapping[str, Mapping[str, object]],
    numbers: Mapping[str, float],
    errata: Sequence[Erratum],
    claims: Sequence[Claim],
) -> list[Gate]:
    """Return every gate with its value."""
    return [
        *protocol_gates(studies, claims),
        *(item for case in setting.CASES for item in case_gates(case, monte_carlo[case], numbers)),
        *(item for case in setting.CASES for item in consistency_gates(case, numbers)),
        *example_2_gates(studies["example-2"], monte_carlo, numbers),
        *(item for case in WORKED for item in worked_gates(case, monte_carlo[f"worked/{case}"])),
        *errata_gates(numbers, errata),
    ]


def case_gates(case: str, entry: Mapping[str, object], numbers: Mapping[str, float]) -> list[Gate]:
    """Bias, efficiency and mean cost of one case of Example 1."""
    found = []
    n, n_runs = setting.EXAMPLE_1_SAMPLES, int(str(entry["n_runs"]))
    for name, quality in parameters_of(entry).items():
        found.append(
            gate.monte_carlo_band(
                f"bias/{case}/{name}",
                quality["bias"],
                0.0,
                quality["bias_std_error"],
                f"unbiased up to {SMALL_SAMPLE_BIAS} standard deviations of small-sample bias",
                allowance=SMALL_SAMPLE_BIAS * quality["std"],
            )
        )
        if case not in setting.RELAYS:
            # No spread, no efficiency: a NaN is never green.
            efficiency = math.nan if quality["efficiency"] is None else quality["efficiency"]
            found.append(
                gate.monte_carlo_band(
                    f"efficiency/{case}/{name}",
                    efficiency,
                    0.93,
                    efficiency * math.sqrt(2 / (n_runs - 1)),
                    "attains the asymptotic least-squares bound up to terms of order 1/N",
                    allowance=0.12,
                )
            )
    variance = setting.EXAMPLE_1_NOISE**2 / 3
    found.append(
        gate.monte_carlo_band(
            f"mean-cost/{case}",
            numbers[f"ej/{case}/{n}"],
            variance * (1 - len(setting.PARAMETERS) / n),
            numbers[f"ej_std_error/{case}/{n}"],
            "E[J] = noise variance times (1 - 5/N); one parameter more or less for a of the relays",
            allowance=(1.0 if case in setting.RELAYS else 0.2) * variance / n,
        )
    )
    return found


def consistency_gates(case: str, numbers: Mapping[str, float]) -> list[Gate]:
    """Error against N: exponent -1/2, and -1 for the threshold of a relay."""
    found = []
    for name in setting.PARAMETERS:
        fast = name == "a" and case in setting.RELAYS
        reason = (
            "the threshold of a relay lies between two samples, whose distance falls as 1/N"
            if fast
            else "least squares with regular regressors"
        )
        # The error of a relay's threshold is nearly Laplace distributed: with kurtosis 6 the logarithm
        # of an RMSE is 2.5 times as variable as for a normal error.
        chance = numbers["slope_std_error"] * (math.sqrt(2.5) if fast else 1.0)
        tolerance = (2 if fast else 1) * HIGHER_ORDER - float(ndtri(gate.FALSE_ALARM / 2)) * chance
        value = numbers[f"slope/{case}/{name}"]
        found.append(gate.slope(f"slope/{case}/{name}", value, -1.0 if fast else -0.5, tolerance, reason))
    return found


def example_2_gates(
    study: Study, monte_carlo: Mapping[str, Mapping[str, object]], numbers: Mapping[str, float]
) -> list[Gate]:
    """Correlation method: consistent, and much wider than least squares on the same data."""
    found = []
    for name, quality in parameters_of(monte_carlo["example-2/separable"]).items():
        found.append(
            gate.monte_carlo_band(
                f"bias/example-2/separable/{name}",
                quality["bias"],
                0.0,
                quality["bias_std_error"],
                "least squares on both experiments; at N = 4000 the bias of order 1/N is below 0.05 std",
                allowance=0.05 * quality["std"],
            )
        )
    for name in example_2.variants():
        median = numbers[f"example-2/{name}/median/a"]
        low, high = study.quantile(f"{name}/a", [0.25, 0.75])
        # Standard error of a median: 1.25 sigma / sqrt(n), with sigma from the quartiles.
        spread = float(high - low) / 1.349
        found.append(
            gate.monte_carlo_band(
                f"median/example-2/{name}/a",
                median,
                setting.THRESHOLD,
                1.253 * spread / math.sqrt(study.n_runs),
                "median-unbiased up to 0.2 of the spread: a is a curved function of the ratio c",
                allowance=0.2 * spread,
            )
        )
        found.append(
            gate.at_least(
                f"gain/example-2/{name}/a",
                numbers[f"example-2/{name}/band_over_separable/a"],
                5.0,
                "relative",
                "the correlations carry the whole output as noise, least squares only the equation error",
            )
        )
    return found


def worked_gates(case: str, entry: Mapping[str, object]) -> list[Gate]:
    """Require a worked nonlinearity of section 3 to be recovered, and the broken one not."""
    found = []
    for name, quality in parameters_of(entry).items():
        if case.endswith("as-printed"):
            ratio = abs(quality["bias"]) / quality["std"]
            reason = "the input (3.10) has a nonzero mean, which makes the printed method inconsistent"
            found.append(gate.at_least(f"broken/{case}/{name}", ratio, 2.0, "monte-carlo-band", reason))
        else:
            found.append(
                gate.monte_carlo_band(
                    f"bias/worked/{case}/{name}",
                    quality["bias"],
                    0.0,
                    quality["bias_std_error"],
                    "unbiased up to 0.3 std: the parameters are curved functions of the ratios",
                    allowance=0.3 * quality["std"],
                )
            )
    return found


def errata_gates(numbers: Mapping[str, float], errata: Sequence[Erratum]) -> list[Gate]:
    """Require printed forms to be wrong, corrected ones right, and the rest confirmed."""
    found = erratum_gates(errata)
    for name, value in numbers.items():
        if name.startswith("confirmed/(3.16)"):
            found.append(
                gate.exact(name, value, 1.0, "one root in each of the three intervals, in every case")
            )
        elif name.startswith("confirmed/"):
            found.append(
                gate.at_most(name, value, CORRECTED_TOLERANCE, "exact", "printed moment against quadrature")
            )
    return found
