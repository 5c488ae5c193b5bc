"""The Monte-Carlo experiments of Chapter 5."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from replications.pepona.chapter5_pwarx import direct_errors, mode_counts, pwarx_points, relative_errors
from replications.pepona.chapter5_setting import (
    BOUNDARY,
    EXAMPLES,
    THRESHOLD,
    Example,
    experiment,
    noise_free_error,
    parameters,
)
from sysid.bounds import least_squares_bound
from sysid.lft import (
    AlternatingFit,
    GivenRegions,
    PiecewiseLft,
    fit_alternating,
    fit_continuous,
    fit_given_partition,
    fit_joint,
    rows_of,
)
from sysid.lft.continuous import Hinges
from sysid.lft.joint import jacobian
from sysid.nonlinearities.piecewise_affine import (
    BoundedError,
    GlobalSearch,
    KPlane,
    PiecewiseAffineMap,
    Stage,
    bounded_error,
    label_error,
)

Floats = NDArray[np.float64]

MISPLACED = 0.05
"""A run is a success with two modes and at most this share of samples in the wrong one."""
ENOUGH = 3 * 11
"""Samples of a mode of 11 parameters that allow to estimate it: three each."""
MOST_ITERATIONS = 60
CREEPING = 150
"""Iterations allowed where a run shows how the scheme as printed creeps."""


def stages(example: Example, name: str) -> tuple[Stage, ...]:
    """Return the map stage of iteration 1, 2, ... by its name."""
    if name == "bounded-error":
        return tuple(BoundedError(delta) for delta in example.deltas)
    return {"k-plane": (KPlane(2),), "global": (GlobalSearch(2, exact_up_to=0),)}[name]


def alternate(example: Example, u: Floats, y: Floats, stage: str, rng: np.random.Generator) -> AlternatingFit:
    """Run Table 5.1 as the example does, with a map stage."""
    return fit_alternating(
        u,
        y,
        example.structure,
        stages(example, stage),
        start=example.start,
        threshold=THRESHOLD,
        max_iterations=MOST_ITERATIONS,
        constant=example.case == "5.1",
        rng=rng,
    )


def jointly(example: Example, u: Floats, y: Floats, rng: np.random.Generator) -> PiecewiseLft:
    """Fit all parameters at once, from a few quick iterations; example 5.1 as continuous."""
    quick = KPlane(2, restarts=5)
    near = fit_alternating(u, y, example.structure, quick, threshold=1e-2, constant=True, rng=rng)
    if example.case == "5.1":
        return fit_continuous(u, y, near.model).model
    return fit_joint(u, y, near.model, rng=rng).model


def judged(example: Example, model: PiecewiseLft, u: Floats, y: Floats) -> dict[str, float]:
    """Return number of modes, share of misplaced samples, error against the true predictions, success."""
    z = rows_of(example.structure, u, y).z
    wrong = label_error(model.map.mode(z), example.model.map.mode(z))
    return {
        "modes": float(model.map.modes),
        "misplaced": wrong,
        "noise_free_error": noise_free_error(example, model, u, y),
        "success": float(model.map.modes == 2 and wrong <= MISPLACED),
    }


def _named(prefix: str, values: Mapping[str, float]) -> dict[str, float]:
    return {f"{prefix}/{name}": value for name, value in values.items()}


@dataclass(frozen=True)
class StageRun:
    """One experiment, identified by the alternating scheme with one map stage."""

    case: str
    stage: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return estimates, iterations and success."""
        example = EXAMPLES[self.case]
        u, y = experiment(example, rng)
        return self.columns(example, u, y, rng)

    def columns(self, example: Example, u: Floats, y: Floats, rng: np.random.Generator) -> dict[str, float]:
        """Return the columns of an experiment."""
        found = alternate(example, u, y, self.stage, rng)
        return {
            **_named("final", parameters(example, found.model)),
            "iterations": float(found.iterations) if found.converged else np.nan,
            **judged(example, found.model, u, y),
        }


@dataclass(frozen=True)
class ThesisRun:
    """One experiment by the protocol of the text, with the joint fit and Table 5.3 beside it."""

    case: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return every column."""
        example = EXAMPLES[self.case]
        u, y = experiment(example, rng)
        found = StageRun(self.case, "bounded-error").columns(example, u, y, rng)
        joint = jointly(example, u, y, rng)
        found |= _named("joint", parameters(example, joint))
        found |= _named("joint", judged(example, joint, u, y))
        if self.case == "5.1":
            found |= self._shifts(example, u, y, rng)
        else:
            found |= _named("known", known_partition(example, u, y))
        if self.case == "5.2":
            found |= self._starts(example, u, y)
            final = {name: found[f"final/{name}"] for name in example.true}
            found |= _named("lft", relative_errors(final, example.true))
            found |= _named("direct", direct_errors(u, y))
        if self.case == "5.3":
            counts = mode_counts(example, u, y)
            found |= {"visited": float(np.sum(counts > 0)), "enough": float(np.sum(counts >= ENOUGH))}
        return found

    @staticmethod
    def _starts(example: Example, u: Floats, y: Floats) -> dict[str, float]:
        """Return the start (5.27)."""
        regressors = np.column_stack([-y[:-1], u[:-1], np.ones(y.size - 1)])
        a1, b1, _ = np.linalg.lstsq(regressors, y[1:], rcond=None)[0]
        return {"initial/a1": float(a1), "initial/b1": float(b1)}

    @staticmethod
    def _shifts(example: Example, u: Floats, y: Floats, rng: np.random.Generator) -> dict[str, float]:
        """Return the vertical shift of the map after the first and the last iteration, and what (5.23) does."""
        settings = {"start": example.start, "threshold": THRESHOLD, "rng": rng}
        best = GlobalSearch(2)
        centred = fit_alternating(u, y, example.structure, best, constant=True, **settings)  # type: ignore[arg-type]
        creeping = fit_alternating(
            u, y, example.structure, best, max_iterations=CREEPING, **settings  # type: ignore[arg-type]
        )

        def shift(map_: PiecewiseAffineMap) -> float:
            return float(np.mean(map_(u[:, np.newaxis]) - example.model.map(u[:, np.newaxis])))

        # Before the constant of (5.23) is moved into the map, it lies between data and v.
        rows = rows_of(example.structure, u, y)
        first = best(rows.z, rows.y + rows.known @ np.array([0.5]) * -1.0 * -1.0, rng).map
        return {
            "shift/first": shift(first),
            "shift/last": shift(centred.model.map),
            "printed_regression/iterations": float(creeping.iterations),
            "printed_regression/shift": shift(creeping.model.map),
            **_named("printed_regression", parameters(example, creeping.model)),
        }
