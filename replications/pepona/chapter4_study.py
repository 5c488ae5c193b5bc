"""The Monte-Carlo runs of Chapter 4: examples 4.2 to 4.4 in every respect, and the case of Lemma 4.1."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from replications.pepona import setting
from replications.pepona.prediction import FIRST
from replications.pepona.setting import Example, Floats, Signals, vaf
from sysid.errors import IdentifiabilityError, ModelError
from sysid.lft import InitialEstimate, LftFit, LftStructure, fit_lft, initial_estimate, lags

SAME = 1e-6
"""Searches that end at costs within this share of each other ended at the same minimum."""
FAR = 1e3
"""A system whose output goes beyond this has diverged."""
FEWER = 150
"""Samples with which all of Table 4.2 would be ordinary."""
SIZES = (250, 500, 1000, 2000, 4000, 8000)
"""Samples at which the error of the Hammerstein systems is measured."""
INTERIOR = 2.25
"""The error of a Hammerstein map is taken over |u| up to this, away from the last knots."""


def structure(example: Example) -> LftStructure:
    """Return the model structure of an example."""
    measured = lags("u", *range(1, len(example.d) + 1)) if example.d else lags("y", 2)
    return LftStructure(
        n_a=int("a1" in example.true),
        b_lags=lags("u", 1) if "b1" in example.true else (),
        n_g=int("g1" in example.true),
        z_lags=measured,
        knots=example.knots,
    )


def estimates(example: Example, found: LftFit | InitialEstimate) -> dict[str, float]:
    """Return the parameters of the table, in its signs; d of an initial estimate keeps its own sign."""
    values: dict[str, float] = {}
    if "a1" in example.true:
        # Ours and that of Table 4.3 stand in A(q) = 1 + a1/q, that of Table 4.4 in (4.41a).
        values["a1"] = float(found.a[1]) * example.a_sign
    if "b1" in example.true:
        values["b1"] = float(found.b[0])
    if "g1" in example.true:
        values["g1"] = float(found.g[1])
    values |= {f"d{i + 1}": float(value) for i, value in enumerate(found.d)}
    return {name: values[name] for name in example.parameters}


def in_signs_of_433(example: Example, found: InitialEstimate) -> dict[str, float]:
    """Return first estimates with a1 as (4.33) has it: what stands before +y(k-1)."""
    values = estimates(example, found)
    return values | ({"a1": -float(found.a[1])} if "a1" in values else {})


@dataclass(frozen=True)
class ExampleRun:
    """One run of an example: identify the first half of an experiment, validate on the second.

    Attributes
    ----------
    case : str
        Number of the example.
    samples : int or None
        Other than the example says.
    """

    case: str
    samples: int | None = None

    @property
    def example(self) -> Example:
        """The example."""
        example = setting.EXAMPLES[self.case]
        return replace(example, samples=self.samples or example.samples)

    def experiment(self, rng: np.random.Generator) -> Signals:
        """Draw both halves."""
        return setting.experiment(self.example, 2 * self.example.samples, rng)

    def identify(self, data: tuple[Floats, Floats], form: LftStructure) -> LftFit:
        """Fit as the thesis does: start from 4.3.1, Jacobian (4.31)."""
        return fit_lft(data, form, start=initial_estimate(data, form), jacobian="kaufman")

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return estimates, VAF in both senses and their ceilings, and how the searches ended."""
        example, n = self.example, self.example.samples
        signals = self.experiment(rng)
        data = signals.u[:n], signals.y[:n]
        fitted, form = self.supported_fit(data)
        first = initial_estimate(data, form)
        exact = fit_lft(data, form, start=first, jacobian="exact")
        from_truth = fit_lft(data, form, start=true_start(example))
        best = min(fitted.cost, exact.cost, from_truth.cost)
        fitted = fitted.oriented(example.d or [1.0])
        found = estimates(example, fitted)
        spread = {name: error for name, (_, error) in fitted.parameters().items()}
        return {
            **found,
            **{f"initial/{name}": value for name, value in in_signs_of_433(example, first).items()},
            **{f"covered/{name}": abs(value - example.true[name]) <= 1.959964 * spread[name]
               for name, value in found.items()},
            **self.validated(fitted, signals),
            "map_rmse": float(np.sqrt(np.mean((fitted.map(fitted.z) - example.function(fitted.z)) ** 2))),
            "knots": float(form.knots),
            "converged": float(fitted.converged),
            "reached": float(fitted.cost <= best * (1.0 + SAME)),
            "iterations/kaufman": float(len(fitted.costs) - 1),
            "iterations/exact": float(len(exact.costs) - 1),
        }  # fmt: skip

    def supported_fit(self, data: tuple[Floats, Floats]) -> tuple[LftFit, LftStructure]:
        """Fit with the knots of the example; with fewer where they leave a gap without data."""
        form = structure(self.example)
        while True:
            try:
                return self.identify(data, form), form
            except IdentifiabilityError:
                if form.knots <= 4:
                    raise
                form = replace(form, knots=form.knots - 1)

    def validated(self, fitted: LftFit, signals: Signals) -> dict[str, float]:
        """Return VAF of the second half, one-step and free-run, of the fit and of the true system."""
        n = self.example.samples
        u, y = signals.u[n:], signals.y[n:]
        truth = setting.respond_after(self.example, signals, n)
        seen = slice(FIRST, None)
        try:
            free = vaf(y[seen], fitted.simulate((u, y))[seen])
        except ModelError:
            free = np.nan
        return {
            "vaf_one_step": vaf(y[seen], fitted.one_step((u, y))[seen]),
            "vaf_free_run": free,
            "ceiling_one_step": vaf(y[seen], (y - signals.e[n:])[seen]),
            "ceiling_free_run": vaf(y[seen], truth[seen]),
            "range": float(np.ptp(signals.y[:n])),
        }


def true_start(example: Example) -> tuple[Floats, Floats]:
    """Return the true d and g."""
    g = [1.0, example.g] if "g1" in example.true else [1.0]
    return np.array(example.d or [1.0]), np.array(g)


@dataclass(frozen=True)
class ReadingRun:
    """One experiment of example 4.3 or 4.4 under every reading of the signs of a1 and g1.

    Attributes
    ----------
    case : str
    """

    case: str

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return for each reading whether it diverges, the VAF of its model, and what 4.3.1 finds first."""
        values: dict[str, float] = {}
        state = rng.bit_generator.state
        for name, example in readings(self.case).items():
            rng.bit_generator.state = state  # the same input and noise for all
            signals = setting.experiment(example, 2 * example.samples, rng)
            scores = self._scores(example, signals)
            values |= {f"{name}/{key}": value for key, value in scores.items()}
        return values

    def _scores(self, example: Example, signals: Signals) -> dict[str, float]:
        diverged = not np.max(np.abs(signals.y)) <= FAR
        undefined = dict.fromkeys(("initial/a1", "initial/d1", "vaf_one_step", "vaf_free_run", "g1"), np.nan)
        if diverged:
            return {"diverged": 1.0, **undefined}
        n = example.samples
        data = signals.u[:n], signals.y[:n]
        try:
            fitted, form = ExampleRun(self.case).supported_fit(data)
        except IdentifiabilityError:
            return {"diverged": 0.0, **undefined}
        first = initial_estimate(data, form)
        scores = ExampleRun(self.case).validated(fitted, signals)
        return {
            "diverged": 0.0,
            "initial/a1": -float(first.a[1]),
            "initial/d1": float(first.d[0]),
            "vaf_one_step": scores["vaf_one_step"],
            "vaf_free_run": scores["vaf_free_run"],
            "g1": float(fitted.g[1]),
        }


def readings(case: str) -> dict[str, Example]:
    """Return an example with every sign of the coefficients of y(k-1) and w(k-1), by name."""
    example = setting.EXAMPLES[case]
    a, g = abs(example.a), abs(example.g)
    return {
        f"{'+' if s > 0 else '-'}a{'+' if t > 0 else '-'}g": replace(example, a=s * a, g=t * g)
        for s in (1, -1)
        for t in (1, -1)
    }


@dataclass(frozen=True)
class HammersteinRun:
    """One run of a Hammerstein system, D(q) = 1 as Lemma 4.1 has it, with the numbers of Example 4.3.

    Attributes
    ----------
    n_g : int
        0 or 1.
    samples : int
    """

    n_g: int
    samples: int

    def experiment(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Draw input and output."""
        example = setting.EXAMPLES["4.3"]
        u = rng.uniform(*example.inputs, self.samples)
        w = example.function(u)
        g = example.g if self.n_g else 0.0
        driven = w + g * setting.delayed(w) + example.noise * rng.standard_normal(self.samples)
        return u, setting.recursion(driven, example.a)

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return a1 of A(q), g1, and the error of the map."""
        example = setting.EXAMPLES["4.3"]
        form = LftStructure(n_a=1, n_g=self.n_g, z_lags=lags("u", 0), knots=example.knots)
        fitted = fit_lft(self.experiment(rng), form, start=([1.0], [1.0, 0.0][: self.n_g + 1]))
        grid = np.linspace(-INTERIOR, INTERIOR, 91)
        off = fitted.map(grid) - example.function(grid)
        found = {"a1": float(fitted.a[1]), "map_square": float(np.mean(off**2))}
        return found | ({"g1": float(fitted.g[1])} if self.n_g else {})
