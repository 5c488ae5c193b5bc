"""The four ways to minimise J_y over a preimage: one point, finite sets, boxes, unions of both."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sysid.errors import IdentifiabilityError
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import Indices, Preimage
from sysid.wiener import kernels
from sysid.wiener.criterion import Criterion
from sysid.wiener.likelihood import simulate

ZERO = 1e-18
"""A criterion relative to ||Qy||^2 below this is an exact fit."""
DRIVEN = 0.01
"""Least share of the energy of y that the response to the input, from rest, must have."""
_TOLERANCE = 1e-6
_MAX_ITERATIONS = 200
_FIRST_BOUND, _BOUND_FACTOR = 1e-3, 10.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A minimiser of the criterion in one region of the preimage.

    Attributes
    ----------
    y : ndarray, shape (n_samples,)
        Estimated intermediate signal.
    theta : ndarray, shape (2 order + 1,)
        [a1 ... an b0 ... bn].
    cost : float
        J_y^2.
    criterion : float
        What was minimised: J_y^2 or J_y^2 / ||Q y||^2.
    driven : bool
        Whether the input drives y. The infimum of the relative criterion over unbounded boxes may be a free
        transient so large that the input no longer counts; such a point explains nothing.
    """

    y: Floats
    theta: Floats
    cost: float
    criterion: float
    driven: bool

    @property
    def rank(self) -> tuple[bool, float]:
        """Smaller is better: driven by the input first, then by the criterion."""
        return not self.driven, self.criterion


@dataclass(frozen=True)
class Outcome:
    """Candidates of a solver, best first, and how they were found."""

    candidates: tuple[Candidate, ...]
    solver: str
    status: str
    exact: bool
    effort: int


def candidate(problem: Criterion, y: Floats, relative: bool) -> Candidate:
    """Evaluate a sequence; an identifiability error says when it determines no parameters."""
    cost, theta = problem.value(y), problem.parameters(y)
    forced = simulate(problem.u, theta, np.zeros(problem.order), problem.order)[0]
    share = np.sum(np.clip(forced, -1e9, 1e9) ** 2) / max(float(np.sum(y**2)), 1e-300)
    return Candidate(y, theta, cost, problem.relative(y) if relative else cost, bool(share > DRIVEN))


def direct(problem: Criterion, preimage: Preimage, relative: bool) -> Outcome:
    """One region of one point: a single evaluation (first special case of Section 5)."""
    found = candidate(problem, preimage.lower.copy(), relative)
    return Outcome((found,), "direct", "one evaluation: the nonlinearity is invertible on the data", True, 1)


def finite_sets(problem: Criterion, preimage: Preimage, keep: int, node_limit: int) -> Outcome:
    """Points only: exact branch and bound with a bound that is widened until something lies below it."""
    energy = float(np.sum(np.maximum.reduceat(preimage.lower**2, preimage.first[:-1])))
    bound, nodes = _FIRST_BOUND * energy / preimage.n_samples, 0
    while True:
        costs, sequences, found, visited = kernels.branch_and_bound(
            problem.u, preimage.first, preimage.lower, problem.order, problem.mode, bound, keep,
            node_limit - nodes,
        )  # fmt: skip
        nodes += visited
        stopped = nodes > node_limit
        # The bound may hide sequences until as many lie below it as are to be kept.
        if stopped or found >= min(keep, math.floor(10 ** min(preimage.log10_regions, 18.0) + 0.5)):
            break
        if bound > energy * 1e3:
            break
        bound *= _BOUND_FACTOR
    if not found:
        raise IdentifiabilityError(
            f"branch and bound stopped at the limit of {node_limit} nodes before it reached a complete "
            "sequence: raise node_limit, use fewer samples or a narrower domain"
        )
    kept = [
        candidate(problem, sequence, False)
        for sequence, cost in zip(sequences, costs, strict=True)
        if np.isfinite(cost)
    ]
    status = (
        f"stopped at the limit of {node_limit} nodes: a better sequence may exist; raise node_limit"
        if stopped
        else f"global minimum over all {preimage.regions} regions: {nodes} nodes were needed"
    )
    return Outcome(tuple(kept), "branch and bound", status, not stopped, nodes)


def boxes(
    problem: Criterion, preimage: Preimage, relative: bool, starts: int, rng: np.random.Generator
) -> Outcome:
    """One part a sample: bounded descent from several starts inside the box."""
    found, iterations, converged = _best_in_box(
        problem, preimage.lower, preimage.upper, relative, starts, rng
    )
    exact_fit = found[0].cost <= 10 * ZERO * float(np.sum(found[0].y ** 2))
    status = f"best of {len(found)} starts, a local minimum for certain"
    if exact_fit:
        status = (
            "exact fit: this sequence satisfies a linear system without error; it need not be the only one"
        )
    elif not converged:
        status += "; stopped at the limit of iterations"
    return Outcome(tuple(found), "boxes", status, exact_fit, iterations)


def mixed(
    problem: Criterion,
    preimage: Preimage,
    relative: bool,
    starts: int,
    region_limit: int,
    rng: np.random.Generator,
) -> Outcome:
    """Unions of points and intervals: every region in turn, or a search among regions when too many."""
    found: list[Candidate] = []
    effort = 0
    if preimage.log10_regions <= math.log10(region_limit):
        for choice in itertools.product(*(range(count) for count in preimage.counts)):
            part = preimage.first[:-1] + np.array(choice)
            inside, iterations, _ = _best_in_box(
                problem, preimage.lower[part], preimage.upper[part], relative, 1, rng
            )
            found += inside
            effort += iterations
        status = f"all {len(found)} regions were minimised, each from one start"
    else:
        for _ in range(starts):
            part = preimage.first[:-1] + rng.integers(preimage.counts)
            best, iterations = _search_regions(problem, preimage, part, relative, rng)
            found.append(best)
            effort += iterations
        status = (
            f"best of {starts} searches among {preimage.regions} regions: a better one may exist; raise "
            "region_limit to examine all, or starts"
        )
    found.sort(key=lambda one: one.rank)
    return Outcome(tuple(found[:starts]), "mixed", status, False, effort)


def _search_regions(
    problem: Criterion, preimage: Preimage, part: Indices, relative: bool, rng: np.random.Generator
) -> tuple[Candidate, int]:
    """Descend in y, and switch single samples to another part as long as that lowers the criterion."""
    part = part.copy()
    (best, *_), effort, _ = _best_in_box(
        problem, preimage.lower[part], preimage.upper[part], relative, 1, rng
    )
    improved = True
    while improved:
        improved = False
        for k in np.flatnonzero(preimage.counts > 1):
            for other in range(int(preimage.first[k]), int(preimage.first[k + 1])):
                if other == part[k]:
                    continue
                trial = part.copy()
                trial[k] = other
                y, _, value, iterations, _ = kernels.minimise_in_box(
                    problem.u, best.y, preimage.lower[trial], preimage.upper[trial], problem.order,
                    problem.mode, relative, ZERO, _MAX_ITERATIONS, _TOLERANCE,
                )  # fmt: skip
                effort += iterations
                if value < best.criterion * (1 - 1e-9):
                    best, part, improved = candidate(problem, y, relative), trial, True
    return best, effort


def _best_in_box(
    problem: Criterion, lower: Floats, upper: Floats, relative: bool, starts: int, rng: np.random.Generator
) -> tuple[list[Candidate], int, bool]:
    """Minimise from several starts; an exact fit ends the search, as nothing is better."""
    found: list[Candidate] = []
    effort, converged = 0, True
    refused: IdentifiabilityError | None = None
    for start in itertools.islice(_starts(lower, upper, rng), starts):
        y, _, value, iterations, done = kernels.minimise_in_box(
            problem.u, start, lower, upper, problem.order, problem.mode, relative, ZERO, _MAX_ITERATIONS,
            _TOLERANCE,
        )  # fmt: skip
        effort += iterations
        converged &= done
        try:
            found.append(candidate(problem, y, relative))
        except IdentifiabilityError as error:  # a degenerate corner of the box, such as one sample not zero
            refused = error
            continue
        if value <= ZERO and found[-1].driven:
            break
    if not found and refused is not None:
        raise refused
    return sorted(found, key=lambda one: one.rank), effort, converged


def _starts(lower: Floats, upper: Floats, rng: np.random.Generator) -> Iterator[Floats]:
    """Draw points of a box, uniform where it is bounded, some way from the finite end where it is not.

    Starts of nearly equal size keep the descent out of the valley of free transients (see `Candidate`).
    """
    ends = np.abs(np.concatenate([lower, upper]))
    ends = ends[np.isfinite(ends) & (ends > 0)]
    size = float(np.median(ends)) if ends.size else 1.0
    bounded = np.isfinite(lower) & np.isfinite(upper)
    base = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0))
    direction = np.where(np.isfinite(lower), 1.0, np.where(np.isfinite(upper), -1.0, 0.0))
    width = np.where(bounded, np.where(bounded, upper, 0.0) - np.where(bounded, lower, 0.0), 0.0)
    while True:
        within = base + width * rng.random(base.size)
        outwards = base + direction * size * rng.uniform(0.5, 1.5, base.size)
        anywhere = size * rng.standard_normal(base.size)
        yield np.where(bounded, within, np.where(direction == 0.0, anywhere, outwards))
