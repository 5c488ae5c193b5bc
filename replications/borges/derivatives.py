"""Which derivative is the Jacobian of the projected residual: finite differences decide."""

import numpy as np
from numpy.typing import NDArray

from replications.borges import setting
from sysid.local_linear import Problem
from sysid.local_linear import gradients as g
from sysid.local_linear.projected import complement, identity_step, tangent

Floats = NDArray[np.float64]

STEP = 1e-6
SAMPLES = 300
DAMPINGS = (1e-2, 1.0, 1e2)


def point(q: int = 1) -> tuple[Problem, Floats]:
    """Return a problem and an eta where Phi is well conditioned, of distinct stable models."""
    rng = np.random.default_rng(12)
    u, y, _ = setting.experiment(rng, "20-dB", SAMPLES)
    problem = setting.problem_of(u, y, q)
    A = rng.standard_normal((setting.N_MODELS, setting.N_STATES, setting.N_STATES))
    A *= 0.6 / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    C = rng.standard_normal((setting.N_OUTPUTS, setting.N_STATES))
    centres = rng.uniform(-1, 1, (setting.N_MODELS, q))
    centres[:, 0] = [-0.9, -0.3, 0.3, 0.9]
    return problem, problem.sizes.pack(A, C, rng.uniform(1.5, 2.5, centres.shape), centres)


def differences(problem: Problem, eta: Floats) -> Floats:
    """Return the Jacobian of the projected residual by central differences."""
    columns = []
    for direction in np.eye(eta.size):
        ahead, behind = (problem(eta + sign * STEP * direction).solution.residual for sign in (1, -1))
        columns.append((ahead - behind) / (2 * STEP))
    return np.column_stack(columns)


def derivative_numbers() -> dict[str, float]:
    """Return errors of Jacobians and gradients, and the effects of projection."""
    problem, eta = point()
    at = problem(eta)
    one, found = at.courses[0], at.solution
    expected = differences(problem, eta)
    slopes = {
        "approach-1": g.approach_1(one, found),
        "2a": g.approach_2a(one, found),
        "2b": g.approach_2b(one, at.gains()),
        "exact": found.back(*g.exact(one, found)),
        "kaufman": found.back(np.zeros((found.n_linear, eta.size)), g.kaufman(one, found)),
    }
    gradient = 2.0 * expected.T @ found.residual
    numbers = {}
    for name, slope in slopes.items():
        numbers[f"jacobian_error/{name}"] = _relative(slope, expected)
        numbers[f"gradient_error/{name}"] = _relative(2.0 * slope.T @ found.residual, gradient)
    numbers["gradient_error/adjoint"] = _relative(g.cost_gradient(one, found), gradient)
    phi = found.R
    numbers["jacobian/condition_of_phi"] = float(np.linalg.cond(phi))
    return numbers | _redundancy() | _projection(problem, eta, slopes)


def _redundancy() -> dict[str, float]:
    """Return dimensions of the null space of the exact Jacobian, and what (w, c) add to a change of state."""
    numbers = {}
    for q in (1, 2):
        problem, eta = point(q)
        at = problem(eta)
        one, found = at.courses[0], at.solution
        values = np.linalg.svd(np.vstack(g.exact(one, found)), compute_uv=False)
        null = int(np.sum(values < 1e-9 * values[0]))
        numbers[f"redundancy/q{q}/null-space"] = float(null)
        numbers[f"redundancy/q{q}/change-of-state"] = float(
            np.linalg.matrix_rank(tangent(problem.sizes, eta), tol=1e-9)
        )
        numbers[f"redundancy/q{q}/weights"] = float(null - setting.N_STATES**2)
    return numbers


def _projection(problem: Problem, eta: Floats, slopes: dict[str, Floats]) -> dict[str, float]:
    """Return the largest relative difference of steps with and without projection, at equal lambda."""
    basis, residual = complement(problem.sizes, eta), problem(eta).solution.residual
    numbers = {}
    for name in ("exact", "kaufman", "2b"):
        errors = []
        for damping in DAMPINGS:
            free, bound = (identity_step(slopes[name], residual, damping, b) for b in (None, basis))
            errors.append(_relative(bound, free))
        numbers[f"projection/step_difference/{name}"] = max(errors)
    return numbers


def _relative(found: Floats, expected: Floats) -> float:
    return float(np.linalg.norm(found - expected) / np.linalg.norm(expected))
