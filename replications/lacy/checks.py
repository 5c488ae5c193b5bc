"""The gates of the paper of Lacy, Erwin and Bernstein: what must hold, how closely, and why."""

from collections.abc import Mapping, Sequence

from replications.errata import Erratum, erratum_gates
from replications.lacy import setting
from replications.studies import parameters_of, protocol_gates
from sysid import gates as gate
from sysid.claims import Claim
from sysid.gates import Gate
from sysid.montecarlo import Study

MEDIANS: Mapping[str, Mapping[str, tuple[float, float, float]]] = {
    "sine": {"paper": (2.5, 14.0, 0.60), "ml": (1.3, 8.0, 0.28)},
    "dead-zone": {"paper": (1.6, 10.0, 0.38), "ml": (1.2, 7.0, 0.26)},
    "quantisation": {"paper": (1.1, 7.5, 0.22), "ml": (0.95, 6.5, 0.18)},
    "sign": {"paper": (2.4, 24.0, 0.55), "ml": (1.9, 18.0, 0.42)},
}
"""Bounds on the medians of 20 runs of rms_db, rms_deg and relative_h2."""

RATIO_TO_BOUND = 1.6
"""Maximum likelihood against estimates drawn at the Cramér-Rao bound, both medians of all runs: at 20 to 60
samples the bound is not attained, and with 20 runs the ratio of two medians has a spread of a quarter."""

WORSE: Mapping[str, float] = {"sine": 3.0, "dead-zone": 3.0, "quantisation": 1.4, "sign": 1.8}
"""How many times the error in dB of the naive fit is at least that of the paper's method."""

EXACT = 1e-6


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
        *(item for case in setting.EXAMPLES for item in example_gates(case, numbers)),
        *(item for case in setting.EXAMPLES for item in noise_free_gates(case, numbers)),
        *bias_gates(monte_carlo["dead-zone/ml"]),
        *exactness_gates(numbers),
        *consistency_gates(numbers),
        *step_test_gates(numbers),
        *erratum_gates(errata),
    ]


def example_gates(case: str, numbers: Mapping[str, float]) -> list[Gate]:
    """Medians of 20 runs, and the order naive > paper > maximum likelihood ~ bound."""
    found = []
    for method, bounds in MEDIANS[case].items():
        for name, bound in zip(("rms_db", "rms_deg", "relative_h2"), bounds, strict=True):
            found.append(
                gate.at_most(
                    f"median-of-20/{case}/{method}/{name}",
                    numbers[f"{case}/{method}/{name}_median_of_20"],
                    bound,
                    "monte-carlo-band",
                    "beyond what medians of 20 runs reach by chance, below what a broken method gives",
                )
            )
    paper, naive, ml, bound = (
        numbers[f"{case}/{method}/rms_db_median"] for method in ("paper", "naive", "ml", "bound")
    )
    found.append(
        gate.at_least(
            f"naive-is-worse/{case}",
            naive / paper,
            WORSE[case],
            "relative",
            "taking z for y ignores the nonlinearity",
        )
    )
    found.append(
        gate.at_most(
            f"ml-near-bound/{case}",
            ml / bound,
            RATIO_TO_BOUND,
            "relative",
            "maximum likelihood is efficient up to small-sample terms",
        )
    )
    found.append(
        gate.exact(
            f"inside-preimage/{case}", numbers[f"{case}/mismatches"], 0, "every estimated y explains its z"
        )
    )
    found.append(
        gate.exact(
            f"moved/{case}",
            numbers[f"{case}/moved"],
            0,
            "with the noise before the nonlinearity (30) no datum leaves the range",
        )
    )
    return found


def noise_free_gates(case: str, numbers: Mapping[str, float]) -> list[Gate]:
    """Without noise: exact where samples fix the parameters, an exact fit everywhere."""
    # Branch and bound is exact, so every run counts; a box may be left at a local minimum now and then.
    kind = "largest" if case == "sine" else "median"
    found = [
        gate.at_most(
            f"noise-free/{case}/criterion",
            numbers[f"noise-free/{case}/{kind}_criterion"],
            1e-14,
            "exact",
            "the true system fits without error, so the minimum is zero up to rounding",
        )
    ]
    if case in ("sine", "dead-zone"):
        found.append(
            gate.at_most(
                f"noise-free/{case}/error",
                numbers[f"noise-free/{case}/{kind}_error"],
                EXACT,
                "exact",
                "samples outside constant regions outnumber the parameters: these are recovered exactly",
            )
        )
    return found


def bias_gates(entry: Mapping[str, object]) -> list[Gate]:
    """Maximum likelihood behind the dead zone is unbiased up to small-sample terms."""
    return [
        gate.monte_carlo_band(
            f"bias/dead-zone/ml/{name}",
            quality["bias"],
            0.0,
            quality["bias_std_error"],
            "unbiased up to half a standard deviation: 30 samples for eight unknowns",
            allowance=0.5 * quality["std"],
        )
        for name, quality in parameters_of(entry).items()
    ]


def exactness_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Branch and bound, the fast derivatives, the special cases of Section 5."""
    found = [
        gate.exact(
            "branch-and-bound",
            numbers["branch_and_bound/agrees_with_brute_force"],
            1.0,
            "the search is exact: it finds the minimum over every sequence",
        ),
        gate.exact("special/square", numbers["special/square/minimisers"], 2, "y and -y explain y^2"),
        gate.at_most(
            "section-4/j-theta",
            numbers["section-4/j_theta_at_minimum"],
            1e-12,
            "exact",
            "eq. (16) leaves J_LS = J_y",
        ),
        gate.at_most(
            "scale/relative",
            abs(numbers["scale/relative_shrunk_over_relative"] - 1.0),
            1e-9,
            "exact",
            "the relative criterion does not depend on the scale of y",
        ),
        gate.at_most(
            "scale/j-y",
            numbers["scale/j_y_shrunk_over_j_y"],
            1e-5,
            "exact",
            "J_y falls with the square of y: useless behind sign",
        ),
    ]
    for name in ("gradient", "hessian"):
        found.append(
            gate.at_most(
                f"fast-form/{name}",
                numbers[f"fast-form/{name}"],
                1e-9,
                "relative",
                "finite differences of eighth order are good to 1e-12",
            )
        )
    return found


def consistency_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Maximum likelihood is consistent and nears the bound; the paper's method keeps a bias."""
    found = []
    for name in setting.PARAMETERS:
        found.append(
            gate.slope(
                f"slope/dead-zone/ml/{name}",
                numbers[f"slope/ml/{name}"] - numbers[f"slope/bound/{name}"],
                0.0,
                0.45,
                "falls with N as the bound does; the slope of three RMSEs over 40 runs has a standard "
                "error of 0.12",
            )
        )
        found.append(
            gate.at_least(
                f"efficiency/dead-zone/ml/{name}",
                numbers[f"efficiency/ml/{name}/240"],
                0.4,
                "monte-carlo-band",
                "near one at 240 samples; over 40 runs it has a spread of a quarter",
            )
        )
    for name in ("a1", "a2"):
        found.append(
            gate.monte_carlo_band(
                f"consistent/dead-zone/ml/{name}",
                numbers["bias/ml/" + name],
                0.0,
                numbers["bias_std_error/ml/" + name],
                "no bias at 240 samples up to half a standard deviation at the bound",
                allowance=0.5 * numbers[f"crlb/{name}/240"],
            )
        )
        found.append(
            gate.at_least(
                f"inconsistent/dead-zone/paper/{name}",
                abs(numbers["bias/paper/" + name]) / numbers["bias_std_error/paper/" + name],
                3.0,
                "monte-carlo-band",
                "the regressors of the equation error carry the noise: at 240 samples the bias is many "
                "standard errors, and it does not fall with more",
            )
        )
    return found


def step_test_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Section 6: the nonlinearity from step tests."""
    return [
        gate.at_most(
            "step-tests/noise-free",
            numbers["step-tests/noise-free/largest_error"],
            1e-2,
            "relative",
            "the kinks of the dead zone lie 1e-4 beside the nearest step: G(1) is 1.0001",
        ),
        gate.at_most(
            "step-tests/median",
            numbers["step-tests/rms_db_median"],
            0.9,
            "monte-carlo-band",
            "60 samples behind a dead zone that was measured: as good as one that is known",
        ),
        gate.at_most(
            "step-tests/normalisation",
            numbers["step-tests/normalisation-error"],
            1e-12,
            "exact",
            "eq. (28) gives G(1) = 1",
        ),
    ]
