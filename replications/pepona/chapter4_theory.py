"""What Chapter 4 states, by numbers: its theorems, its lemma, its constraints, its iteration."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from replications.pepona import setting
from replications.pepona.chapter4_study import ExampleRun, structure, true_start
from replications.pepona.prediction import FIRST, Predictor
from replications.pepona.setting import Floats, delayed
from sysid.lft import (
    LftFit,
    LftStructure,
    basis_conditions,
    compare_problems,
    fit_lft,
    initial_estimate,
    printed_search,
)
from sysid.nonlinearities.spline import absolute_power_basis, equal_knots, spline_basis
from sysid.separable import project

STEPS = 60
"""Limit of the printed iteration, which has none of its own."""
STARTS = 20
WIDE = 3.0
"""The printed iteration is tried from g1 within this of zero."""
RANK_TOLERANCE = 1e-9
"""Columns of length one: a singular value below this is zero; the spline basis has a condition below 1e3."""


@dataclass(frozen=True)
class TheoryRun:
    """One record of an example: both theorems, both bases, and the iteration of Table 4.1.

    Attributes
    ----------
    case : str
    """

    case: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return gradients, condition numbers, differences and the course of the printed iteration."""
        example = setting.EXAMPLES[self.case]
        signals = setting.experiment(example, example.samples, rng)
        data = signals.u, signals.y
        fitted, form = ExampleRun(self.case).supported_fit(data)
        thesis = replace(form, basis="thesis")
        first = initial_estimate(data, form)
        ours, theirs = (compare_problems(data, one, start=first) for one in (form, thesis))
        conditions = basis_conditions(fitted.z, form.knots)
        difference = bases_differ(Predictor(example, signals), fitted)
        return {
            "gradient/separated": ours.separated_gradient,
            "gradient/joint": ours.joint_gradient,
            "joint_cost_off": abs(ours.joint_cost / ours.separated_cost - 1.0),
            "condition/separated": ours.condition_separated,
            "condition/kaufman": ours.condition_kaufman,
            "condition/joint": ours.condition_joint,
            "condition/joint-thesis-basis": theirs.condition_joint,
            "steps/separated": float(ours.separated_steps),
            "steps/joint": float(ours.joint_steps),
            "steps/joint-thesis-basis": float(theirs.joint_steps),
            "basis/thesis": conditions["thesis"],
            "basis/bspline": conditions["bspline"],
            "basis/thesis-scaled": conditions["thesis scaled"],
            "basis/bspline-scaled": conditions["bspline scaled"],
            "basis/difference": difference,
            "basis/rounding": difference / (np.finfo(float).eps * conditions["thesis"]),
            **self._printed(data, form, fitted.cost, rng),
        }

    def _printed(
        self, data: tuple[Floats, Floats], form: LftStructure, least: float, rng: np.random.Generator
    ) -> dict[str, float]:
        """Run Table 4.1 from 4.3.1, from the truth, and from g1 far out."""
        example = setting.EXAMPLES[self.case]
        usual = printed_search(data, form, start=initial_estimate(data, form), max_steps=STEPS)
        rows = data[0].size - form.largest_lag
        found = {
            "printed/steps": float(len(usual.steps)),
            "printed/stopped": float(usual.stopped),
            "printed/excess": 2.0 * rows * float(usual.costs[-1]) / least - 1.0,
        }
        near = printed_search(
            data, form, start=fit_lft(data, form, start=true_start(example)), max_steps=STEPS
        )
        found["printed/stopped-at-minimum"] = float(near.stopped)
        rises = []
        for _ in range(STARTS if "g1" in example.true else 0):
            start = true_start(example)[0], [1.0, rng.uniform(-WIDE, WIDE)]
            rises.append(float(np.max(printed_search(data, form, start=start, max_steps=STEPS).ratios)))
        found["printed/worst-rise"] = max(rises, default=1.0)
        found["printed/uphill-share"] = float(np.mean(np.array(rises) > 1.01)) if rises else 0.0
        return found


def bases_differ(predictor: Predictor, fitted: LftFit) -> float:
    """Return the largest difference of the residuals in both bases at the same d and g, per RMS residual."""
    signals, example = predictor.signals, predictor.example
    z = predictor.internal(fitted.d if example.d else np.empty(0))
    z[: FIRST - 1] = z[FIRST - 1]
    places = equal_knots(z, fitted.structure.knots - 1)
    measured = [delayed(signals.y)] * ("a1" in example.true) + [delayed(signals.u)] * ("b1" in example.true)
    g = float(fitted.g[1]) if "g1" in example.true else 0.0
    residuals = []
    for basis in (absolute_power_basis(z, places), spline_basis(z, places)):
        columns = basis + g * np.vstack([np.zeros(basis.shape[1]), basis[:-1]])
        rows = np.column_stack([*measured, columns])[FIRST:]
        residuals.append(project(rows, predictor.measured).residual)
    return float(np.max(np.abs(residuals[0] - residuals[1])) / np.sqrt(np.mean(residuals[1] ** 2)))


def rank_deficit(columns: Floats) -> int:
    """Return how many columns depend on the others."""
    values = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
    return int(np.sum(values <= RANK_TOLERANCE * values[0]))


def _record(samples: int = 4000) -> tuple[Floats, Floats]:
    """Return a Hammerstein record with D(q) = 1: y = 0.4 y(k-1) + w + e."""
    rng = np.random.default_rng(41)
    example = setting.EXAMPLES["4.3"]
    u = rng.uniform(*example.inputs, samples)
    w = example.function(u) + example.noise * rng.standard_normal(samples)
    return u, setting.recursion(w, example.a)


def lemma_columns(n_g: int, n_b: int = 0, *, once: bool = False) -> Floats:
    """Return the rows F_k of Lemma 4.1 for D(q) = 1 and n_a = 1, by B-splines of the same space.

    Parameters
    ----------
    n_g, n_b : int
    once : bool
        Leave out what the lags of the map's basis repeat: the constant, and u where B has it.
    """
    u, y = _record()
    basis = spline_basis(u, equal_knots(u, 14))
    first = n_g + n_b + 1
    blocks = [delayed(y)[first:, np.newaxis]]
    blocks += [np.roll(u, i)[first:, np.newaxis] for i in range(1, n_b + 1)]
    for i in range(n_g + 1):
        lagged = np.roll(basis, i, axis=0)[first:]
        # Less one B-spline there is no constant in the span, less two there is no straight line either.
        gone = (i > 0) + (1 <= i <= n_b) if once else 0
        blocks.append(lagged[:, : lagged.shape[1] - gone])
    return np.column_stack(blocks)


def lemma_numbers() -> dict[str, float]:
    """Return how far the rows of Lemma 4.1 are from full rank, and how many rows that would take."""
    numbers = {}
    for n_g in (0, 1, 2):
        columns = lemma_columns(n_g)
        numbers[f"lemma/columns/n_g={n_g}"] = float(columns.shape[1])
        numbers[f"lemma/deficit/n_g={n_g}"] = float(rank_deficit(columns))
    numbers["lemma/deficit/n_g=1,n_b=1"] = float(rank_deficit(lemma_columns(1, 1)))
    p = 2  # n_a + n_b + n_g + 1 with n_a = 1
    window = lemma_columns(0)[: p + 2]  # the rows j = r, ..., r + M of (4.25) with M = p + 1
    numbers["lemma/window-deficit"] = float(window.shape[1] - np.linalg.matrix_rank(window))
    return numbers


def overlap_columns(n_b: int) -> Floats:
    """Return the joint Jacobian of b_0 u + ... + b_nb u(k-nb) + f(d_0 u + d_1 u(k-1)), nothing left out."""
    rng = np.random.default_rng(42)
    u = rng.uniform(-2.5, 2.5, 4000)
    d, turned = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    lagged = np.column_stack([u, np.roll(u, 1)])[2:]
    z = lagged @ d
    slope = setting.arctangent_slope(z)
    linear = [np.roll(u, i)[2:] for i in range(n_b + 1)]
    return np.column_stack([*linear, slope * (lagged @ turned), spline_basis(z, equal_knots(z, 14))])


def overlap_numbers() -> dict[str, float]:
    """Return how many parameters are not determined when no b_i c_i is zero."""
    return {f"overlap/deficit/n_b={n_b}": float(rank_deficit(overlap_columns(n_b))) for n_b in (0, 1, 2)}


def power_deficit(degree: int, knots: int = 12) -> int:
    """Return how many of |z - kappa|^m, z, 1 depend on the others, for even m, too."""
    z = np.linspace(-1.0, 1.0, 400)
    places = equal_knots(z, knots - 1)
    if degree % 2:
        return rank_deficit(absolute_power_basis(z, places, degree=degree))
    powers = np.abs(z[:, np.newaxis] - places) ** degree
    return rank_deficit(np.column_stack([powers, z, np.ones_like(z)]))


def equivalence_numbers() -> dict[str, float]:
    """Return how far (4.15) is from (4.14), as printed and with z one sample later."""
    rng = np.random.default_rng(43)
    u, e = rng.uniform(-2.5, 2.5, 1000), 0.1 * rng.standard_normal(1000)
    a, b, g, d = 0.4, 0.7, -0.5, (0.53, -0.848)
    z = np.convolve(u, [0.0, *d])[: u.size]
    late = np.convolve(u, [0.0, 0.0, *d])[: u.size]
    given, printed, shifted = (
        setting.recursion(b * delayed(u) + g * part + e, a)
        for part in (delayed(np.sin(z)), np.sin(z), np.sin(late))
    )
    return {
        "example-4.1/printed": float(np.max(np.abs(printed - given))),
        "example-4.1/shifted": float(np.max(np.abs(shifted - given))),
    }


def sign_numbers() -> dict[str, float]:
    """Return how much the output changes when d is turned round and the map mirrored: not at all."""
    example = setting.EXAMPLES["4.3"]
    signals = setting.experiment(example, example.samples, np.random.default_rng(44))
    data = signals.u, signals.y
    fitted = fit_lft(data, structure(example), start=true_start(example))
    turned = fitted.oriented(-fitted.d)
    off = fitted.one_step(data) - turned.one_step(data)
    # A constant beside the map says what the map's offset says.
    columns = np.column_stack([spline_basis(fitted.z, fitted.map.knots), np.ones(fitted.z.size)])
    return {
        "undetermined/sign-of-d": float(np.nanmax(np.abs(off))),
        "undetermined/sign-turned": float(turned.d @ fitted.d),
        "undetermined/offset-deficit": float(rank_deficit(columns)),
    }


def shared_lag_numbers() -> dict[str, float]:
    """Return the length of the first d when B has the lags of z, relative to that without B.

    Step 3 of 4.3.1 then regresses on what step 1 has already taken out.
    """
    example = setting.EXAMPLES["4.3"]
    signals = setting.experiment(example, example.samples, np.random.default_rng(45))
    u, y = signals.u, signals.y
    inputs = np.column_stack([delayed(u), delayed(delayed(u))])[3:]
    lengths = []
    for beside in ([delayed(y)[3:]], [delayed(y)[3:], *inputs.T]):
        rows = np.column_stack([*beside, np.ones(u.size - 3)])
        v = y[3:] - rows[:, :-1] @ np.linalg.lstsq(rows, y[3:], rcond=None)[0][:-1]
        centred = inputs - inputs.mean(axis=0)
        lengths.append(float(np.linalg.norm(np.linalg.lstsq(centred, v - v.mean(), rcond=None)[0])))
    return {"initialisation/shared-lags": lengths[1] / lengths[0]}


def theory_numbers() -> dict[str, float]:
    """Return everything here that needs no study."""
    return {
        **lemma_numbers(),
        **overlap_numbers(),
        **{f"powers/deficit/m={m}": float(power_deficit(m)) for m in (1, 2, 3, 4)},
        **equivalence_numbers(),
        **sign_numbers(),
        **shared_lag_numbers(),
    }
