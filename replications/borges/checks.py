"""The gates of the paper: what must hold, how closely, and why."""

from collections.abc import Mapping, Sequence

from replications.errata import Erratum, erratum_gates
from replications.studies import protocol_gates
from sysid import gates as gate
from sysid.claims import Claim
from sysid.gates import Gate
from sysid.montecarlo import Study

DIFFERENCES = 1e-6
"""Central differences of the projected residual: 1e-10 times the condition of Phi, below 1e4."""


def gates(
    studies: Mapping[str, Study],
    numbers: Mapping[str, float],
    errata: Sequence[Erratum],
    claims: Sequence[Claim],
) -> list[Gate]:
    """Return every gate with its value."""
    return [
        *protocol_gates(studies, claims),
        *derivative_gates(numbers),
        *redundancy_gates(numbers),
        *algebra_gates(numbers),
        *study_gates(numbers),
        *erratum_gates(errata),
    ]


def derivative_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require what is a Jacobian to be one, and what is none to be none; all give the gradient."""
    found = [
        gate.at_most(
            "condition-of-phi", numbers["jacobian/condition_of_phi"], 1e4, "exact", "differences need digits"
        )
    ]
    for name in ("approach-1", "exact"):
        reason = "central differences of the projected residual"
        found.append(
            gate.at_most(
                f"jacobian/{name}", numbers[f"jacobian_error/{name}"], DIFFERENCES, "relative", reason
            )
        )
    for name in ("2a", "2b", "kaufman"):
        reason = "not the Jacobian of the projected residual: (37) and (39) are false"
        found.append(
            gate.at_least(f"jacobian/{name}", numbers[f"jacobian_error/{name}"], 0.1, "relative", reason)
        )
    for name in ("approach-1", "2a", "2b", "kaufman", "exact", "adjoint"):
        reason = "and the gradient of the cost all the same"
        found.append(
            gate.at_most(
                f"gradient/{name}", numbers[f"gradient_error/{name}"], DIFFERENCES, "relative", reason
            )
        )
    return found


def redundancy_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Hold the dimension of the null space, and what projection changes."""
    found = []
    for q, weights in ((1, 0), (2, 1)):
        reason = "n^2 = 9 for a change of the state, and 2 q + 1 - s more for (w, c) where that is positive"
        value = numbers[f"redundancy/q{q}/null-space"]
        found.append(gate.exact(f"null-space/q{q}", value, 9 + weights, reason))
    for name in ("exact", "kaufman"):
        reason = "rows of this Jacobian are orthogonal to changes of the state: projection changes no step"
        value = numbers[f"projection/step_difference/{name}"]
        found.append(gate.at_most(f"projection/{name}", value, 1e-8, "relative", reason))
    reason = "the rows of 2b are not, so that projection does change its steps"
    value = numbers["projection/step_difference/2b"]
    found.append(gate.at_least("projection/2b", value, 1e-2, "relative", reason))
    return found


def algebra_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Hold our count of operations against what is done, and normal equations against QR."""
    found = []
    for name in ("phi", "approach-2b", "slopes"):
        reason = "operations of the formula and of a counting run"
        value = numbers[f"table-1/{name}/counted_over_ours"]
        found.append(gate.relative(f"operations/{name}", value, 1.0, 1e-12, reason))
    loss = numbers["condition/theta_error/normal-equations"] / numbers["condition/theta_error/qr"]
    reason = "normal equations square the condition of Phi and lose theta"
    found.append(gate.at_least("normal-equations", loss, 100.0, "relative", reason))
    share = numbers["setting/diverging_share"]
    found.append(gate.exact("diverging-inputs", share, 1.0, "normal inputs of variance one"))
    return found


def study_gates(numbers: Mapping[str, float]) -> list[Gate]:
    """Require both outputs with q = 2, the second one lost with q = 1, and the order of the searches."""
    found = []
    for output in (1, 2):
        value = numbers[f"q2/vaf_validation/output-{output}"]
        reason = "median over the runs; both inputs schedule"
        found.append(gate.at_least(f"q2/vaf/output-{output}", value, 98.0, "absolute", reason))
    reason = "one scheduling input cannot give the product of the other with a state"
    found.append(
        gate.at_most("q1/vaf/output-2", numbers["q1/vaf_validation/output-2"], 90.0, "absolute", reason)
    )
    reason = "a model linear in the state and the inputs explains less than the composite one"
    linear = max(numbers[f"q2/vaf_validation/linear/output-{output}"] for output in (1, 2))
    found.append(gate.at_most("linear/vaf", linear, 90.0, "absolute", reason))
    slower = numbers["lm_iterations/approach-2b"] / max(numbers["lm_iterations/exact"], 1.0)
    reason = "without noise the wrong Gauss-Newton matrix of 2b costs iterations"
    found.append(gate.at_least("iterations/2b-over-exact", slower, 1.5, "relative", reason))
    ratio = numbers["lm_iterations/kaufman"] / max(numbers["lm_iterations/approach-2b"], 1.0)
    reason = "Kaufman's is cheaper than the exact one and stays ahead of 2b"
    found.append(gate.at_most("iterations/kaufman-over-2b", ratio, 1.0, "relative", reason))
    return found
