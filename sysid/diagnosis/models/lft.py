"""LFT models as a comparison sees them: equations, parameters, predictions, the map."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.diagnosis.models.adapters import Refitted
from sysid.diagnosis.models.doubts import doubts
from sysid.diagnosis.models.fitted_map import GRID, INNER, FittedMap, density_on, inner_range
from sysid.diagnosis.models.fitted_model import ParameterValue
from sysid.diagnosis.residuals import CorrelationTest, whiteness
from sysid.diagnosis.wording import percent, quantity
from sysid.lft.choice import LftChoice, choose_lft
from sysid.lft.model import LftFit
from sysid.lft.signals import signals_of
from sysid.lft.structure import LftStructure, at, lag_name
from sysid.linear.simulation import Prediction
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate

Floats = NDArray[np.float64]

# A map is called straight unless chance would bend it as much less often than this.
SIGNIFICANT = 0.01


@dataclass(frozen=True)
class LftJudged(Refitted):
    """An LFT model with its chosen structure, fitted on estimation rows and refitted with validation rows."""

    choice: LftChoice
    period: float
    units: Mapping[str, str]
    initial_state: str = "estimate"
    candidates: "tuple[Candidate, ...]" = ()
    name: str = "lft"

    @property
    def fit(self) -> LftFit:
        """Fitted to estimation and validation rows."""
        return self.choice.fit

    @property
    def accepted(self) -> LftFit:
        """Fitted to estimation rows."""
        return self.choice.accepted

    @property
    def title(self) -> str:
        """Heading."""
        return f"{self.fit.structure.kind} model with a spline of {self.fit.structure.knots} knots"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        kind = self.fit.structure.kind
        article = "An" if kind == "LFT" else "A"
        fed = ", ".join(at(*lag) for lag in self.fit.structure.z_lags)
        return f"{article} {kind} model with a static map of {fed}"

    @property
    def order(self) -> int:
        """Samples that the model looks back."""
        return self.fit.structure.largest_lag

    @property
    def equations(self) -> tuple[str, ...]:
        """The difference equation, the map and its input."""
        structure = self.fit.structure
        gone = structure.left_out()
        terms = ["w(k)", *(f"g{i} w(k-{i})" for i in range(1, structure.n_g + 1))]
        left = [f"{_name(lag, structure)} {at(*lag)}" for lag in structure.linear_lags if lag not in gone]
        past = [f"- {term}" for term in left if term.startswith("a")]
        forced = [f"+ {term}" for term in left if not term.startswith("a")]
        inner = " + ".join(f"{lag_name('d', lag, structure)} {at(*lag)}" for lag in structure.z_lags)
        single = len(structure.z_lags) == 1
        # Noise in the equation is what a one-step fit assumes; in a free run it comes behind all this.
        noise = ["+ e(k)"] if self.fit.criterion == "one-step" else [", measured with noise"]
        return (
            " ".join([f"{self.fit.output}(k) =", " + ".join(terms), *forced, *past, *noise]).replace(
                " ,", ","
            ),
            f"w(k) = f(z(k)), f a spline of degree {structure.degree} with {structure.knots} knots, "
            f"{structure.extrapolation} beyond them",
            f"z(k) = {at(*structure.z_lags[0])}" if single else f"z(k) = {inner}, with |d| = 1",
        )

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Coefficients of A, B, G and D."""
        return {
            name: ParameterValue(value, error, self._unit(name))
            for name, (value, error) in self.fit.parameters().items()
        }

    @property
    def restarts_agree(self) -> bool:
        """Whether at least two of several searches ended at the best cost."""
        return self.accepted.searches == 1 or self.accepted.agreeing > 1

    @property
    def notes(self) -> tuple[str, ...]:
        """What the map looks like, how the structure was chosen, what is a convention."""
        conventions = tuple(note[0].upper() + note[1:] + "." for note in self.fit.notes)
        if any(signal in ("y", self.fit.output) for signal, _ in self.fit.structure.z_lags):
            conventions += ("The poles are those of the model linearised where the median of z lies.",)
        return (self.maps()[0].sentence, self.choice.reason, *conventions)

    @cached_property
    def residual_whiteness(self) -> CorrelationTest:
        """Test of the residual of the fit; intervals of a one-step fit rest on its being white."""
        return whiteness(self.fit.residual)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        found = [
            *doubts(
                self,
                f"Only one of {self.accepted.searches} searches ended at the best cost: another may do "
                "better; raise --starts.",
            )
        ]
        centre, band = self._inner
        if not 2.0 * band <= float(np.ptp(centre)):
            found.append(
                "The data do not determine the map: its 95 % band is wider than the map rises or falls; "
                "leave lags out that act in A or B and through the map, too (--overlap drop), or take fewer "
                "knots."
            )
        if self.fit.criterion == "one-step" and not self.residual_whiteness.passed:
            lag, value = _worst(self.residual_whiteness)
            found.append(
                f"The one-step residual is not white (its correlation at lag {lag} is {value:.2f}): "
                "parameters may be biased, their intervals and the map's band too narrow; try a higher "
                "order of A."
            )
        return tuple(found)

    @property
    def poles(self) -> tuple[complex, ...]:
        """Poles; where the map is fed the output, those of the model linearised at the median of z."""
        return tuple(complex(pole) for pole in np.roots(self.fit.linearised(float(np.median(self.fit.z)))))

    def predict(self, record: Record) -> Prediction:
        """Predict every row by the final model."""
        return self._prediction(self.fit, record)

    def predict_held_out(self, record: Record) -> Prediction:
        """Predict every row by the model of the estimation rows."""
        return self._prediction(self.accepted, record)

    def _prediction(self, fit: LftFit, record: Record) -> Prediction:
        first = fit.structure.largest_lag
        measured = [self.initial_state != "rest" and given for given in fit.measured_starts(record)]
        free_run = fit.simulate(record, initial_state="rest" if self.initial_state == "rest" else "available")
        one_step = fit.one_step(record)
        # Rows whose lags are not all measured have no other prediction than that of the free run.
        one_step = np.where(np.isfinite(one_step), one_step, free_run)
        words = {True: f"the first {first} rows as measured", False: "at rest"}
        return Prediction(free_run, one_step, tuple(words[given] for given in measured))

    def saved(self) -> dict[str, Any]:
        """Return the final model as plain values, for `sysid.lft.load`."""
        from sysid.lft.files import to_json

        return to_json(self.fit)

    def maps(self) -> tuple[FittedMap, ...]:
        """Return the map with its band."""
        return (self._map,)

    @cached_property
    def _map(self) -> FittedMap:
        fit = self.fit
        knots = fit.map.knots
        grid = np.linspace(knots[0], knots[-1], GRID)
        lower, upper = fit.map_band(grid)
        bend, deviation = fit.bend(grid)
        lags = fit.structure.z_lags
        single = f"z = {at(*lags[0])}" if len(lags) == 1 else f"z = {_weighted(fit)}"
        signals = {signal for signal, _ in lags}
        return FittedMap(
            sentence=self._looks(),
            quantity=single,
            unit=self._signal_unit(signals.pop()) if len(signals) == 1 else "",
            result_unit=self.units.get(fit.output, ""),
            value=grid,
            centre=fit.map(grid),
            lower=lower,
            upper=upper,
            density=density_on(grid, fit.z),
            knots=knots,
            bend=bend,
            bend_deviation=deviation,
        )

    @cached_property
    def _inner(self) -> tuple[Floats, float]:
        """Return the map where most of its data lie, and the largest half width of its band there."""
        low, high = inner_range(self.fit.z)
        grid = np.linspace(low, high, GRID)
        lower, upper = self.fit.map_band(grid)
        return self.fit.map(grid), float(np.max(upper - lower)) / 2.0

    def _looks(self) -> str:
        """Say in one sentence what the map looks like where the data are."""
        centre, band = self._inner
        steps = np.diff(centre)
        rise, fall = float(steps[steps > 0.0].sum()), float(-steps[steps < 0.0].sum())
        # What turns by less than the band is wide is as well flat.
        shape = "rises and falls" if min(rise, fall) > 2.0 * band else "rises" if rise > fall else "falls"
        reach = quantity(band, self.units.get(self.fit.output, ""), 2)
        return (
            f"The map {shape} where {percent(INNER)} of its data lie; its 95 % band there reaches ± {reach} "
            f"at most; {self._straightness(self.fit)}."
        )

    def _straightness(self, fit: LftFit) -> str:
        chance = fit.straight_line_test()
        level = f"F test, p {'= ' + format(chance, '.2g') if chance >= 1e-4 else '< 0.0001'}"
        if chance >= SIGNIFICANT:
            return f"a straight line would do as well ({level})"
        if fit.criterion == "one-step" and fit.rms > 0.0:
            more = percent(fit.straight_rms / fit.rms - 1.0)
            return f"a straight line in its place would raise the one-step error by {more} ({level})"
        return f"it is bent beyond chance ({level})"

    def details(self) -> dict[str, Any]:
        """Return the structure, how it was chosen, the map, and the test of the one-step residual."""
        return {
            "kind": self.fit.structure.kind,
            "delay": min((delay for signal, delay in self.fit.structure.z_lags if signal != "y"), default=1),
            "equations": list(self.equations),
            "criterion": self.fit.criterion,
            "structure": self.saved()["structure"],
            "poles": [[pole.real, pole.imag] for pole in self.poles],
            "reason": self.choice.reason,
            "map": self._map.to_json(),
            "fit_residual": self.residual_whiteness.to_json(),
            "tried": [
                {
                    "structure": trial.structure.words,
                    "criterion": trial.criterion,
                    "validation_rmse": finite(trial.validation_rms),
                    "problem": trial.problem,
                }
                for trial in self.choice.trials
            ],
        }

    def _signal_unit(self, signal: str) -> str:
        fit = self.fit
        name = {"y": fit.output, "u": fit.inputs[0]}.get(signal, signal)
        return self.units.get(name, "")

    def _unit(self, name: str) -> str:
        if not name.startswith("b"):
            return ""
        signal = next(s for s, d in self.fit.structure.b_lags if _name((s, d), self.fit.structure) == name)
        output, unit = self.units.get(self.fit.output, ""), self._signal_unit(signal)
        if unit == output:
            return ""
        return f"{output or '1'}/{unit}" if unit else output


def _name(lag: tuple[str, int], structure: LftStructure) -> str:
    return lag_name("ab", lag, structure)


def _weighted(fit: LftFit) -> str:
    """Return D with its numbers, when it is short enough for an axis."""
    if fit.d.size > 3:
        return "D(q) x"
    terms = [f"{value:+.2g} {at(*lag)}" for value, lag in zip(fit.d, fit.structure.z_lags, strict=True)]
    return " ".join(terms).removeprefix("+").replace("+", "+ ").replace("-0", "- 0")


def _worst(test: CorrelationTest) -> tuple[int, float]:
    place = int(np.argmax(np.abs(test.correlation)))
    return int(test.lags[place]), float(test.correlation[place])


def fit_lft_structure(
    record: Record,
    options: Mapping[str, Any],
    *,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> LftJudged:
    """Choose and fit an LFT model by the options of `sysid fit --structure lft`.

    Parameters
    ----------
    record : Record
        With one output.
    options : mapping
        Fields of `LftStructure` that are fixed, and criterion, jacobian, starts, seed of
        `choose_lft`.
    initial_state : {"estimate", "rest"}
    progress : callable, optional
    """
    search = {name: options[name] for name in ("criterion", "jacobian", "starts", "seed") if name in options}
    given = {name: value for name, value in options.items() if name not in search}
    signals = signals_of(record)
    for field in ("b_lags", "z_lags"):
        signals.channels(given.get(field, ()))  # a wrong name is told before anything is tried
    choice = choose_lft(record, given, initial_state=initial_state, progress=progress, **search)
    return LftJudged(choice, record.period, dict(record.units), initial_state)
