"""The gates of Chapter 5: what must hold, how closely, and why."""

import math
from collections.abc import Mapping

from replications.pepona.chapter import MonteCarlo, Numbers, Studies
from replications.pepona.chapter5_pwarx import PRINTED_TABLE_5_3
from replications.pepona.chapter5_setting import BOUNDARY, EXAMPLES
from sysid import gates as gate
from sysid.gates import Gate

RATIO = 1.4
"""RMSE of the joint fit over the bound of the known partition."""


def gates5(studies: Studies, monte_carlo: MonteCarlo, numbers: Numbers) -> list[Gate]:
    """Return the gates of Chapter 5."""
    found: dict[str, float] = {name: value for name, value in numbers.items() if value is not None}
    return [
        *table_gates(found),
        *count_gates(found),
        *theory_gates(found),
        *precision_gates(studies, monte_carlo, found),
        *bias_gates(found),
        *stage_gates(found),
        *threshold_gates(found),
        *pwarx_gates(found),
    ]


def table_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Hold the last column of Table 5.3 against the printed Table 5.2, exactly."""
    found = [
        gate.absolute(
            f"table-5.3/{pair}",
            numbers[f"table_5.3_lft/{pair}"],
            printed,
            numbers[f"table_5.3_lft/slack/{pair}"],
            "the estimates are printed with four decimals; their rounding moves the entry by no more",
        )
        for pair, printed in PRINTED_TABLE_5_3.items()
    ]
    reason = "one set of estimates that rounds to Table 5.2 gives all four entries to their last decimal"
    found.append(
        gate.at_most("table-5.3/together", numbers["table_5.3_lft/unrounded"], 5e-5, "digits", reason)
    )
    reason = "the LFT model is better in most of the four modes, as the text says"
    found.append(
        gate.at_least("table-5.3/better", numbers["table_5.3/better_share"], 0.75, "relative", reason)
    )
    return found


def count_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Count parameters and modes."""
    expected = {
        "setting/5.2/parameters": (9, "a1, b1, g1 and two submodels of three"),
        "setting/5.2/pwarx-parameters": (28, "four submodels of seven; the text counts 21"),
        "setting/5.3/pwarx-modes": (32, "two to the power of five"),
        "setting/5.3/pwarx-width": (11, "five lags of y, five of u, and one"),
    }
    return [gate.exact(f"count/{n}", numbers[n], value, reason) for n, (value, reason) in expected.items()]


def theory_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require what holds without chance: identifiability, equivalence, smoothing."""
    found = [
        gate.exact("5.14/free", numbers["identifiability/5.14/free"], 1, "u(k-1) stands in both parts"),
        gate.exact("5.15/free", numbers["identifiability/5.15/free"], 0, "no regressor is common"),
        gate.at_most(
            "5.15/same-output",
            numbers["identifiability/5.15/difference"],
            1e-12,
            "exact",
            "rounding of the same sums",
        ),
    ]
    for case in EXAMPLES:
        reason = "the examples of Section 5.4 are identifiable"
        found.append(gate.exact(f"{case}/free", numbers[f"identifiability/{case}/free"], 0, reason))
    for side in ("inside", "outside"):
        error = numbers[f"smoothing/{side}/least_norm_error"]
        reason = "300 samples from both ends the smoother has forgotten them: 0.9^300 and rounding"
        found.append(gate.at_most(f"smoothing/{side}", error, 1e-9, "exact", reason))
    blown = numbers["smoothing/outside/recursion_error"]
    reason = "with its zero at 2 the recursion doubles every error: 300 samples make at least 1e80"
    found.append(gate.at_least("smoothing/recursion-blows-up", blown, 1e80, "exact", reason))
    return found


def precision_gates(studies: Studies, monte_carlo: MonteCarlo, numbers: Mapping[str, float]) -> list[Gate]:
    """Require that the joint fit is unbiased and reaches the bound of the known partition."""
    found = []
    for case in ("5.2", "5.3"):
        runs = studies[case].n_runs
        # The RMSE of n runs has a relative spread of 1/sqrt(2n); ten parameters are looked at.
        bound = max(RATIO, 1.0 + 5.0 / math.sqrt(2 * runs))
        largest = numbers[f"ratio_to_bound/{case}/joint/largest"]
        reason = "least squares with all samples in their modes attains it"
        found.append(gate.at_most(f"joint-reaches-bound/{case}", largest, bound, "monte-carlo-band", reason))
        for name, quality in monte_carlo[f"{case}/joint"]["parameters"].items():
            if name in BOUNDARY[case]:
                continue
            reason = "unbiased but for small-sample terms, a fifth of the spread at most"
            found.append(
                gate.monte_carlo_band(
                    f"joint-unbiased/{case}/{name}",
                    quality["bias"],
                    0.0,
                    quality["bias_std_error"],
                    reason,
                    allowance=0.2 * quality["std"],
                )
            )
    for case in EXAMPLES:
        share = monte_carlo[f"{case}/joint"]["success_share"]
        found.append(
            gate.at_least(
                f"joint-success/{case}", share, 0.9, "relative", "two modes, 95 % of samples in the right one"
            )
        )
    return found


def bias_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require that the alternating scheme is biased at 20,000 samples and the joint fit is not."""
    found = []
    for case in ("5.2", "5.3"):
        score = numbers[f"bias/{case}/alternating/theta1_1/z"]
        reason = "z holds lagged outputs and n_g > 0: the noise of v is coloured and correlated with z"
        found.append(gate.at_least(f"alternating-is-biased/{case}", score, 3.5, "monte-carlo-band", reason))
        score = numbers[f"bias/{case}/joint/largest_z"]
        reason = "ten normal scores stay below 4.5 but for one study in ten thousand"
        found.append(gate.at_most(f"joint-is-not/{case}", score, 4.5, "monte-carlo-band", reason))
    return found


SUCCESS: Mapping[tuple[str, str], float] = {
    ("5.1", "global"): 0.85, ("5.1", "k-plane"): 0.85, ("5.1", "bounded-error"): 0.9,
    ("5.2", "global"): 0.99, ("5.2", "k-plane"): 0.99, ("5.2", "bounded-error"): 0.97,
    ("5.3", "global"): 0.99, ("5.3", "k-plane"): 0.97,
}  # fmt: skip
"""Share of successes of each map stage, found over hundreds of runs."""


def stage_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require how often each map stage leads to the system."""
    found = []
    for (case, stage), share in SUCCESS.items():
        start = f"stage/{case}/{stage}"
        least = share - 4.0 * math.sqrt(share * (1.0 - share) / numbers[f"{start}/runs"])
        reason = "four standard deviations of a count below its usual share; a broken stage falls far below"
        found.append(gate.at_least(start, numbers[f"{start}/success"], least, "monte-carlo-band", reason))
    return found


def threshold_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require how the regression (5.23) creeps without a constant, and what a constant changes."""
    creeping = numbers["5.1/as_printed/iterations"]
    reason = "the rate is mean(y)^2 / mean(y^2) = 0.95; the text stops after 5"
    found = [gate.at_least("5.1/creeps-as-printed", creeping, 25, "relative", reason)]
    reason = "with a constant only the slope is left to iterate"
    quick = numbers["threshold/5.1/constant/0.001/iterations"]
    found.append(gate.at_most("5.1/quick-with-constant", quick, 6, "relative", reason))
    reason = "gamma = 0.001 with a rate above 0.8 stops some 0.004 of the parameters away"
    left = numbers["threshold/5.2/as_printed/0.001/distance"]
    found.append(gate.at_least("5.2/stops-early", left, 1.5e-3, "relative", reason))
    return found


def pwarx_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require what the direct fits of the text find."""
    reason = "two modes at delta = 0.4, as the text says"
    found = [
        gate.at_least("5.2/pwarx-0.4", numbers["5.2/pwarx-0.4/two_modes_share"], 0.6, "relative", reason)
    ]
    reason = "at the bound of the noise the four clusters are not found"
    found.append(
        gate.at_least("5.2/pwarx-0.25", numbers["5.2/pwarx-0.25/least_misplaced"], 0.15, "relative", reason)
    )
    return found
