"""Starts of a search for local linear models, and where the searches end."""

import numpy as np
from numpy.typing import NDArray

from sysid.errors import IdentifiabilityError, ModelError
from sysid.linear.subspace import INSTRUMENTS, Run, factorise
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.problem import At, Problem
from sysid.local_linear.signals import Scaled
from sysid.separable.descent import Minimum, descend

Floats = NDArray[np.float64]
EVALUATIONS, TRIAL_EVALUATIONS = 300, 40
DEEPEST = 20


def check_enough(problem: Problem, scaled: Scaled, names: tuple[str, ...]) -> None:
    """Refuse more unknowns than the rows can determine, and more local models than scheduling values."""
    sizes = problem.sizes
    values = sizes.n_outputs * sum(int(used.sum()) for used in problem.used)
    if values < 2 * problem.n_unknowns:
        raise IdentifiabilityError(
            f"{values} measured values cannot determine {problem.n_unknowns} unknowns ({sizes.n_models} "
            f"local models of order {sizes.n_states}): at least {2 * problem.n_unknowns} are needed; take "
            "fewer local models or a lower order"
        )
    different = np.unique(scaled.visited(), axis=0).shape[0]
    if different < sizes.n_models:
        raise IdentifiabilityError(
            f"the scheduling signal {' '.join(names)} takes {different} different values and there are "
            f"{sizes.n_models} local models: take at most {different}"
        )


def given_start(problem: Problem, start: LocalLinearModel, scaled: Scaled) -> Floats:
    """Return the parameters of a model in the units of the search.

    Raises
    ------
    ModelError
        If its sizes are others, or its simulation diverges.
    """
    if start.sizes != problem.sizes:
        raise ModelError(
            f"the start has {start.sizes}, and {problem.sizes} is to be fitted: give a matching one"
        )
    eta = problem.sizes.pack(
        start.A,
        start.C / scaled.y_size[:, np.newaxis],
        start.widths * scaled.phi_size,
        (start.centres - scaled.phi_mean) / scaled.phi_size,
    )
    if not np.isfinite(problem(eta).cost):
        radius = np.abs(np.linalg.eigvals(start.A)).max(axis=1)
        worst = int(np.argmax(radius))
        raise ModelError(
            "the simulation of the start is not finite or a local model is never in charge; the largest "
            f"eigenvalue of A_{worst + 1} has the size {radius[worst]:.3g}: start from a stable model, or "
            "without one"
        )
    return eta


def linear_starts(problem: Problem) -> list[tuple[Floats, Floats]]:
    """Return A and C of one linear model by PO-MOESP and by PI-MOESP.

    Raises
    ------
    IdentifiabilityError
        If too few rows follow one another.
    """
    order = problem.sizes.n_states
    runs = [
        Run(experiment.inputs[:, :-1], y, used)
        for experiment, y, used in zip(problem.experiments, problem.y, problem.used, strict=True)
    ]
    channels = problem.sizes.n_inputs + problem.sizes.n_outputs
    longest = max(int(run.used.sum()) for run in runs)
    depth = int(np.clip(longest // (4 * channels), order + 1, min(max(2 * order, 10), DEEPEST)))
    factor = factorise(runs, depth)
    if factor is None:
        raise IdentifiabilityError(
            f"too few rows follow one another for a subspace estimate of order {order}: lower the order, or "
            "take a longer record"
        )
    return [factor.dynamics(kind, order) for kind in INSTRUMENTS]


def drawn_starts(problem: Problem, scaled: Scaled, restarts: int, rng: np.random.Generator) -> list[Floats]:
    """Return starts from both subspace estimates: centres spread over the visited values, then drawn."""
    sizes = problem.sizes
    s, q = sizes.n_models, sizes.n_scheduling
    visited = scaled.visited()
    levels = (np.arange(s) + 0.5) / s
    spread = np.quantile(visited, levels, axis=0)
    if q > 1:  # along the first direction the quantiles; the others drawn, so that centres are not on a line
        spread[:, 1:] = rng.permuted(spread[:, 1:], axis=0)
    placements = [(np.full((s, q), max(s - 1, 1) / 2.0), spread)]
    for _ in range(restarts):
        placements.append((rng.uniform(0.3, 2.0, (s, q)), visited[rng.choice(visited.shape[0], s)]))
    found = []
    for A, C in linear_starts(problem):
        found += [sizes.pack(np.repeat(A[np.newaxis], s, axis=0), C, w, c) for w, c in placements]
    return found


def search(problem: Problem, starts: list[Floats], *, every: bool = False) -> list[Minimum[At]]:
    """Search shortly from every start, and on from the best two; return the ends, the lowest cost first.

    With ``every`` the ends of the short searches follow those of the long ones.
    """
    feasible = [eta for eta in starts if np.isfinite(problem(eta).cost)]
    if not feasible:
        raise IdentifiabilityError(
            "no start gives a finite simulation with every local model in charge somewhere: take fewer "
            "local models, or another scheduling signal"
        )

    def lowest(eta: Floats, tolerance: float, evaluations: int) -> Minimum[At]:
        return descend(problem, eta, tolerance=tolerance, max_evaluations=evaluations)

    with np.errstate(all="ignore"):
        short = sorted((lowest(eta, 1e-6, TRIAL_EVALUATIONS) for eta in feasible), key=lambda end: end.cost)
        long = sorted((lowest(end.x, 1e-8, EVALUATIONS) for end in short[:2]), key=lambda end: end.cost)
    return [*long, *short] if every else long
