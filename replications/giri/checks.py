"""The gates of the paper: what must hold, how closely, and why."""

import math
from collections.abc import Mapping, Sequence

from scipy.special import ndtri

from replications.errata import CORRECTED_TOLERANCE, Erratum, erratum_gates
from replications.giri import setting
from replications.giri.disturbance import KINDS, RANDOM_KINDS
from replications.giri.precision import NOISES, SIZES
from replications.studies import parameters_of, protocol_gates
from sysid import gates as gate
from sysid.claims import Claim
from sysid.gates import Gate
from sysid.montecarlo import Study

SMALL_SAMPLE_BIAS = 0.15
"""Bias allowed as a share of the standard deviation; least squares on lagged outputs has one of order 1/N."""

GATED_SIZE = 100
"""Periods at which bias and efficiency are gated."""


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
        *convergence_gates(numbers),
        *proposition_gates(numbers),
        *recovery_gates(numbers),
        *excitation_gates(numbers),
        *(item for kind in KINDS for item in disturbance_gates(kind, numbers)),
        *precision_gates(monte_carlo, numbers),
        *errata_gates(numbers, errata),
    ]


def convergence_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Hold the rate by two ways, the periods it implies, and the speed of least squares."""
    rate = numbers["rate_per_period"]
    simulated = numbers["rate_per_period/simulated"]
    faster = numbers["time_constant/averaged"] / numbers["time_constant"]
    found = [
        gate.relative(
            "rate-by-simulation",
            simulated,
            rate,
            1e-7,
            "eigenvalue of the period's map against a run of 1500 periods, whose last fifth holds one mode",
        ),
        gate.at_most("rate-below-one", rate, 1.0 - 1e-6, "exact", "(5.1) excites every direction"),
        gate.at_least(
            "averaged-matrix-is-off",
            faster,
            1.2,
            "relative",
            "steps near 1 are no small steps: the averaged matrix must be seen to mispredict the time",
        ),
        gate.relative(
            "theta-star-norm",
            numbers["theta_star_norm"],
            math.sqrt(sum(a * a for a in setting.A) + (1 + 4) * (25 / 9 + 16 / 9 + 1 + 1)),
            1e-12,
            "by hand: |a|^2 + |b|^2 |d|^2 with d = (5/3, 4/3, 1, 1)",
        ),
        gate.at_most(
            "rls-samples",
            numbers["rls_samples_to_1e-6"],
            2 * setting.PERIOD,
            "exact",
            "ten unknowns need ten exciting rows, which one period and its lags hold",
        ),
    ]
    for first, second in (("1e-2", "1e-3"), ("1e-3", "1e-6")):
        between = numbers[f"periods_to_{second}"] - numbers[f"periods_to_{first}"]
        expected = math.log(float(second) / float(first)) / math.log(rate)
        late = first == "1e-3"
        reason = "periods between two errors follow from the rate, up to " + (
            "counting whole periods" if late else "what the second mode still adds before an error of 1e-3"
        )
        tolerance = 2.0 if late else 15.0
        found.append(gate.absolute(f"periods/{first}-to-{second}", between, expected, tolerance, reason))
    return found


def proposition_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Proposition 4.1: bounded, increments and posterior errors square summable, excited or not."""
    found = []
    bound = numbers["proposition-4.1/bound"]
    for name in ("excited", "not-excited"):
        key = f"proposition-4.1/{name}"
        monotone = "without noise no step takes the estimate away from the truth, up to rounding"
        found.append(
            gate.at_most(f"{key}/growth", numbers[f"{key}/largest_growth_of_error"], 1e-12, "exact", monotone)
        )
        for quantity in ("increments", "posterior_errors"):
            found.append(
                gate.at_most(
                    f"{key}/{quantity}",
                    numbers[f"{key}/sum_of_squared_{quantity}"],
                    bound,
                    "exact",
                    "the sums of squares are at most the first squared error",
                )
            )
        found.append(
            gate.at_most(
                f"{key}/last_increment",
                numbers[f"{key}/last_increment"],
                1e-8,
                "exact",
                "the increments die out, excited or not",
            )
        )
    left = numbers["proposition-4.1/not-excited/last_relative_error"]
    reason = "without excitation the output is predicted and the parameters stay wrong"
    found.append(gate.at_least("proposition-4.1/not-excited/error", left, 0.1, "relative", reason))
    return found


def recovery_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """K and H come back; D and L cannot, and the two-sided proof of it."""
    found = []
    reason = "after 1500 periods the noise-free error is below 1e-8"
    for name, true in setting.TRUE.items():
        found.append(gate.absolute(f"recovered/{name}", numbers[f"recovered/{name}"], true, 1e-7, reason))
    same = "two maps with the same K and H and other D and L give the same output at the levels"
    found.append(
        gate.at_most(
            "identifiability/levels", numbers["identifiability/difference_at_levels"], 1e-12, "exact", same
        )
    )
    differ = "and different ones inside: it is the levels, not the plant, that cannot tell"
    found.append(
        gate.at_least(
            "identifiability/inside", numbers["identifiability/difference_inside"], 0.1, "exact", differ
        )
    )
    return found


def excitation_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require that (5.1) excites, that even spacing need not, and that F(V1) = 0 spoils it."""
    full, found = 5 * setting.ORDER, []
    expected = {
        "example": full,
        "example/even": full,
        "hidden-pole": full,
        "hidden-pole/even": full - 1,
        "zero-at-V1": full - 1,
        "zero-at-V1/V1-moved": full,
    }
    for name, rank in expected.items():
        reason = "rank of a period's regressors; the two lost directions are lost by construction"
        found.append(gate.exact(f"excitation/{name}/rank", numbers[f"excitation/{name}/rank"], rank, reason))
        if rank < full:
            stuck = "a direction that is not excited has the rate 1"
            found.append(
                gate.absolute(
                    f"excitation/{name}/rate", numbers[f"excitation/{name}/rate"], 1.0, 1e-10, stuck
                )
            )
    share = numbers["confirmed/Proposition 5.1, random plants"]
    reason = "200 random plants of orders 1 to 4, all with F(V1) != 0"
    found.append(gate.exact("excitation/random-plants", share, 1.0, reason))
    return found


def disturbance_gates(kind: str, numbers: Mapping[str, float]) -> list[Gate]:
    """Proposition 5.2: error proportional to the disturbance, with the factor that theory gives."""
    found = [
        gate.slope(
            f"noise-slope/{kind}",
            numbers[f"noise_slope/{kind}"],
            1.0,
            0.01,
            "proportional over four decades; at the largest, z in the regressors adds below one percent",
        )
    ]
    for quantity in ("increment_ratio", "posterior_ratio"):
        found.append(
            gate.at_most(
                f"proposition-4.1/{quantity}/{kind}",
                numbers[f"proposition-4.1/{quantity}/{kind}/spread"],
                0.05,
                "relative",
                "mean over mean |eta| does not depend on the amplitude (Proposition 4.1, part 1)",
            )
        )
    ratio = numbers[f"noise_ratio/{kind}"]
    if kind in RANDOM_KINDS:
        theory = numbers[f"noise_ratio/{kind}/theory"]
        found.append(
            gate.monte_carlo_band(
                f"noise-ratio/{kind}",
                ratio,
                theory,
                numbers[f"noise_ratio/{kind}/std_error"],
                "covariance of the error from a periodic Lyapunov equation; 1 % for terms of order z^2",
                allowance=0.01 * theory,
            )
        )
    elif f"noise_ratio/{kind}/theory" in numbers:
        theory = numbers[f"noise_ratio/{kind}/theory"]
        reason = "periodic solution of the error recursion; terms of order z^2 are below 1 %"
        found.append(gate.relative(f"noise-ratio/{kind}", ratio, theory, 0.01, reason))
    return found


def precision_gates(
    monte_carlo: Mapping[str, Mapping[str, object]], numbers: Mapping[str, float]
) -> list[Gate]:
    """Bias, efficiency, exponent: structured least squares attains the bound, the printed method not."""
    found = []
    case = monte_carlo[f"equation/structured/periods={GATED_SIZE}"]
    n_runs = int(str(case["n_runs"]))
    for method in ("least-squares", "structured"):
        entry = monte_carlo[f"equation/{method}/periods={GATED_SIZE}"]
        for name, quality in parameters_of(entry).items():
            found.append(
                gate.monte_carlo_band(
                    f"bias/equation/{method}/{name}",
                    quality["bias"],
                    0.0,
                    quality["bias_std_error"],
                    f"unbiased up to {SMALL_SAMPLE_BIAS} standard deviations of small-sample bias",
                    allowance=SMALL_SAMPLE_BIAS * quality["std"],
                )
            )
    for name, quality in parameters_of(case).items():
        efficiency = _number(quality["efficiency"])
        found.append(
            gate.monte_carlo_band(
                f"efficiency/equation/structured/{name}",
                efficiency,
                1.0,
                efficiency * math.sqrt(2 / (n_runs - 1)),
                "attains the Cramér-Rao bound of the seven free parameters, up to terms of order 1/N",
                allowance=0.1,
            )
        )
    for name in setting.PARAMETERS:
        chance = -float(ndtri(gate.FALSE_ALARM / 2)) * numbers["slope_std_error"]
        value = numbers[f"slope/equation/structured/{name}"]
        reason = "least squares with regular regressors"
        found.append(gate.slope(f"slope/equation/structured/{name}", value, -0.5, 0.04 + chance, reason))
    last = SIZES[-1]
    for noise in NOISES:
        for name, quality in parameters_of(monte_carlo[f"{noise}/gradient/periods={last}"]).items():
            found.append(
                gate.at_most(
                    f"inefficient/{noise}/gradient/{name}",
                    _number(quality["efficiency"]),
                    0.5,
                    "relative",
                    "with a constant step the printed algorithm forgets and cannot gain from more data",
                )
            )
    worst = parameters_of(monte_carlo[f"output/least-squares/periods={last}"])["a1"]
    found.append(
        gate.at_least(
            "biased/output/least-squares/a1",
            abs(worst["bias"]) / worst["std"],
            1.0,
            "monte-carlo-band",
            "with a white disturbance of the output the lagged outputs correlate with eta = A z",
        )
    )
    return found


def errata_gates(numbers: Mapping[str, float], errata: Sequence[Erratum]) -> list[Gate]:
    """Require printed forms to be wrong, corrected ones right, and the rest confirmed."""
    found = erratum_gates(errata)
    for name, value in numbers.items():
        if name.startswith("confirmed/("):
            reason = "printed formula against the map it was made from"
            found.append(gate.at_most(name, value, CORRECTED_TOLERANCE, "exact", reason))
    return found


def _number(value: float | None) -> float:
    """Return the value; no value is never green."""
    return math.nan if value is None else value
