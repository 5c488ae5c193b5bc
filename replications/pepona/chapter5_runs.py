"""The Monte-Carlo experiments of Chapter 5."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replications.pepona.chapter5_pwarx import direct_errors, mode_counts, pwarx_points, relative_errors
from replications.pepona.chapter5_setting import EXAMPLES, THRESHOLD, Example, experiment, parameters
from sysid.lft import (
    AlternatingFit,
    GivenRegions,
    PiecewiseLft,
    fit_alternating,
    fit_continuous,
    fit_joint,
    rows_of,
)
from sysid.lft.alternating import initial_linear, recovered
from sysid.nonlinearities.piecewise_affine import (
    BoundedError,
    GlobalSearch,
    KPlane,
    Stage,
    bounded_error,
    label_error,
)

Floats = NDArray[np.float64]

STAGES = ("bounded-error", "k-plane", "global")
MISPLACED = 0.05
"""A run is a success with two modes and at most this share of samples in the wrong one."""
SMALLEST_MODE = 0.1
"""Share of the samples that a mode of the bounded-error stage holds at least; the text gives none."""
ENOUGH = 3 * 11
"""Samples of a mode of 11 parameters that allow to estimate it: three each."""
MOST_ITERATIONS = {"bounded-error": 15, "k-plane": 50, "global": 50}
"""The bounded-error stage is slow, and where it has not settled by then it does not."""
CREEPING = 150
"""Iterations allowed where a run shows how the scheme as printed creeps."""
THRESHOLDS = (1e-2, 1e-3, 1e-4)
"""Values of gamma that are compared."""


def stages(example: Example, name: str) -> tuple[Stage, ...]:
    """Return the map stage of iteration 1, 2, ... by its name."""
    if name == "bounded-error":
        return tuple(BoundedError(delta, discard=SMALLEST_MODE, convex=True) for delta in example.deltas)
    if name == "k-plane":
        return (KPlane(2, restarts=5),)
    return (GlobalSearch(2),)


def alternate(example: Example, u: Floats, y: Floats, stage: str, rng: np.random.Generator) -> AlternatingFit:
    """Run Table 5.1 with a map stage; example 5.1 with a constant in (5.23), without which it creeps."""
    return fit_alternating(
        u,
        y,
        example.structure,
        stages(example, stage),
        start=example.start,
        threshold=THRESHOLD,
        max_iterations=MOST_ITERATIONS[stage],
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
    """Return number of modes, share of misplaced samples and success of a model."""
    z = rows_of(example.structure, u, y).z
    wrong = label_error(model.map.mode(z), example.model.map.mode(z))
    success = model.map.modes == 2 and wrong <= MISPLACED
    return {"modes": float(model.map.modes), "misplaced": wrong, "success": float(success)}


def named(prefix: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return values with a prefix before each name."""
    return {f"{prefix}/{name}": value for name, value in values.items()}


@dataclass(frozen=True)
class StageRun:
    """One experiment, identified by the alternating scheme with one map stage."""

    case: str
    stage: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return estimates, iterations and success."""
        example = EXAMPLES[self.case]
        return self.columns(example, *experiment(example, rng), rng)

    def columns(self, example: Example, u: Floats, y: Floats, rng: np.random.Generator) -> dict[str, float]:
        """Return the columns of an experiment; iterations are undefined where it did not settle."""
        found = alternate(example, u, y, self.stage, rng)
        return {
            **named("final", parameters(example, found.model)),
            "iterations": float(found.iterations) if found.converged else np.nan,
            **judged(example, found.model, u, y),
        }


@dataclass(frozen=True)
class ExampleRun:
    """One experiment: alternating with the global map stage, the joint fit, and what the text compares."""

    case: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return every column."""
        example = EXAMPLES[self.case]
        u, y = experiment(example, rng)
        found = StageRun(self.case, "global").columns(example, u, y, rng)
        joint = jointly(example, u, y, rng)
        found |= named("joint", {**parameters(example, joint), **judged(example, joint, u, y)})
        if self.case == "5.1":
            found |= _creeping(example, u, y, found["final/a1"])
        if self.case == "5.2":
            rows = rows_of(example.structure, u, y)
            found |= named(
                "initial", dict(zip(("a1", "b1"), initial_linear(example.structure, rows), strict=False))
            )
            final = {name: found[f"final/{name}"] for name in example.true}
            found |= named("lft", relative_errors(final, example.true))
            found |= named("direct", direct_errors(u, y))
        if self.case == "5.3":
            counts = mode_counts(example, u, y)
            found |= {"visited": float(np.sum(counts > 0)), "enough": float(np.sum(counts >= ENOUGH))}
        return found


def _creeping(example: Example, u: Floats, y: Floats, last: float) -> dict[str, float]:
    """Return the vertical shift of v at the start and the end, and what (5.23) without a constant does."""
    rows = rows_of(example.structure, u, y)
    level = float(np.mean(example.model.map(rows.z)))

    def shift(a1: float) -> float:
        return float(np.mean(recovered(example.structure, rows, np.array([a1])))) - level

    assert example.start is not None
    best, most = GlobalSearch(2), CREEPING
    printed = fit_alternating(u, y, example.structure, best, start=example.start, max_iterations=most)
    return {
        "shift/first": shift(example.start[0]),
        "shift/last": shift(last),
        "as_printed/iterations": float(printed.iterations),
        "as_printed/a1_after_5": float(printed.history[min(5, printed.iterations), 0]),
        "as_printed/a1": float(printed.model.a[0]),
    }


@dataclass(frozen=True)
class LongRun:
    """A long experiment, the partition known at the start: fixed point of the scheme, and joint fit."""

    case: str
    samples: int

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return both estimates."""
        example = EXAMPLES[self.case]
        u, y = experiment(example, rng, self.samples)
        known = GivenRegions(example.model.map)
        fixed = fit_alternating(
            u, y, example.structure, known, threshold=1e-5, constant=True, max_iterations=150
        )
        joint = fit_joint(u, y, fixed.model, rng=rng)
        return {
            **named("alternating", parameters(example, fixed.model)),
            **named("joint", parameters(example, joint.model)),
        }


@dataclass(frozen=True)
class ThresholdRun:
    """How far from its fixed point the scheme stops, for several thresholds, the partition known."""

    case: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return iterations and relative distance by threshold, and the rate."""
        example = EXAMPLES[self.case]
        u, y = experiment(example, rng)
        found: dict[str, float] = {}
        for constant in (False, True):
            fit = fit_alternating(
                u,
                y,
                example.structure,
                GivenRegions(example.model.map),
                start=example.start,
                threshold=1e-7,
                constant=constant,
                max_iterations=400,
            )
            name = "constant" if constant else "as_printed"
            steps = np.linalg.norm(np.diff(fit.history, axis=0), axis=1)
            size = np.linalg.norm(fit.history[1:], axis=1)
            for threshold in THRESHOLDS:
                stop = int(np.argmax(steps <= threshold * size)) + 1
                away = np.linalg.norm(fit.history[stop] - fit.history[-1]) / size[-1]
                found[f"{name}/{threshold:g}/iterations"] = float(stop)
                found[f"{name}/{threshold:g}/distance"] = float(away)
            found[f"{name}/rate"] = fit.rate
        return found


@dataclass(frozen=True)
class PwarxRun:
    """The bounded-error procedure on the whole system, its structure ignored."""

    case: str
    delta: float

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return number of modes, share of samples in a wrong mode of (5.28), and outliers."""
        example = EXAMPLES[self.case]
        u, y = experiment(example, rng)
        fit = bounded_error(*pwarx_points(example, u, y), self.delta, rng=rng, convex=True)
        rows = rows_of(example.structure, u, y)
        labels = example.model.map.mode(rows.z)
        truth = sum(labels[rows.now - lag] * 2**lag for lag in range(example.structure.n_g + 1))
        return {
            "modes": float(fit.modes),
            "misplaced": label_error(fit.labels, np.asarray(truth)),
            "outliers": fit.outlier_share,
        }
