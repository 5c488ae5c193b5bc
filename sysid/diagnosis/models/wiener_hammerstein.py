"""Wiener-Hammerstein models as a comparison sees them: equations, parameters, map, frequency responses."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.models.adapters import Refitted
from sysid.diagnosis.models.doubts import doubts
from sysid.diagnosis.models.fitted_map import GRID, INNER, FittedMap, density_on, inner_range
from sysid.diagnosis.models.fitted_model import WIENER_HAMMERSTEIN, BlockResponse, ParameterValue
from sysid.diagnosis.wording import NORMAL_95, percent, significant
from sysid.lft.wiener_hammerstein.choice import WienerHammersteinChoice, choose_wiener_hammerstein
from sysid.lft.wiener_hammerstein.files import to_json
from sysid.lft.wiener_hammerstein.result import WienerHammersteinFit
from sysid.linear.forms import Floats
from sysid.linear.simulation import Prediction
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate

FREQUENCIES = 120
# The lowest frequency drawn is that of so many periods in the record.
FEWEST_PERIODS = 10


@dataclass(frozen=True)
class WienerHammersteinJudged(Refitted):
    """A Wiener-Hammerstein model, fitted on estimation rows and refitted with validation rows."""

    choice: WienerHammersteinChoice
    units: Mapping[str, str]
    z: Floats
    initial_state: str = "estimate"
    candidates: "tuple[Candidate, ...]" = ()
    name: str = WIENER_HAMMERSTEIN

    @property
    def fit(self) -> WienerHammersteinFit:
        """Fitted to estimation and validation rows."""
        return self.choice.fit

    @property
    def accepted(self) -> WienerHammersteinFit:
        """Fitted to estimation rows."""
        return self.choice.accepted

    @property
    def title(self) -> str:
        """Heading."""
        n1, n2 = self.fit.orders
        if self.name != WIENER_HAMMERSTEIN:
            return f"{self.name.capitalize()} model of order {n1 + n2}"
        return f"Wiener-Hammerstein model of orders {n1} and {n2}"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        return f"A {self.title}"

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.fit.period

    @property
    def equations(self) -> tuple[str, ...]:
        """Blocks and map."""
        model, late = self.fit.model, self.fit.model.delay
        fed = f"{self.fit.inputs[0]}(k{f'-{late}' if late else ''})"
        acts = "" if model.oversampling == 1 else ", between samples, too: its input is band-limited"
        return (
            f"z(k) = B1(q)/A1(q) {fed}, the front block",
            f"w = f(z), f a spline of degree {model.map.degree} with {model.map.knots.size} knots, "
            f"{model.map.extrapolation} beyond them{acts}",
            f"{self.fit.outputs[0]}(k) = B2(q)/A2(q) w(k) + e(k), the back block",
        )

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Coefficients of both blocks, which have the gain one."""
        return {
            name: ParameterValue(value, error, "") for name, (value, error) in self.fit.parameters().items()
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """What the map looks like, how the structure was chosen, what is a convention."""
        found = [
            self.maps()[0].sentence,
            self.choice.reason,
            "The data do not tell how gain is shared: both blocks have the gain 1 at zero frequency, or the "
            "largest gain 1 where hardly anything passes there.",
        ]
        if delay := self.fit.exchangeable_delay:
            found.append(
                f"{delay} sample{'s' * (delay > 1)} of delay may as well be in the other block: leading "
                "coefficients of B that the data do not tell from zero."
            )
        return tuple(found)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        return doubts(
            self,
            "Only one of the searches from different starts reached the best error: another model of the "
            "same orders may do better; compare other orders.",
        )

    @property
    def poles(self) -> tuple[complex, ...]:
        """Poles of the front block, then those of the back block."""
        return tuple(complex(pole) for block in self.fit.poles for pole in block)

    def predict(self, record: Record) -> Prediction:
        """Predict every row by the final model."""
        return self.fit.predict(record)

    def predict_held_out(self, record: Record) -> Prediction:
        """Predict every row by the model of the estimation rows."""
        return self.accepted.predict(record, rows=record.estimation)

    def saved(self) -> dict[str, Any]:
        """Return the final model as plain values, for `sysid.lft.load`."""
        return to_json(self.fit.model)

    def maps(self) -> tuple[FittedMap, ...]:
        """Return the map with its band."""
        return (self._map,)

    def responses(self) -> tuple[BlockResponse, ...]:
        """Return the frequency responses of both blocks with their bands."""
        slowest = 2.0 * np.pi * FEWEST_PERIODS / (self.fit.n_rows * self.period)
        frequencies = np.geomspace(slowest, np.pi / self.period, FREQUENCIES + 1)[:-1]
        gains = self.fit.gains(frequencies)
        return tuple(
            BlockResponse(
                name,
                frequencies / (2.0 * np.pi),
                gain,
                np.maximum(gain - NORMAL_95 * error, 0.0),
                gain + NORMAL_95 * error,
            )
            for name, (gain, error) in zip(("front block", "back block"), gains, strict=True)
        )

    @cached_property
    def _map(self) -> FittedMap:
        fit = self.fit
        grid = np.linspace(*fit.range, GRID)
        centre, error = fit.map_band(grid)
        density = density_on(grid, self.z)
        beyond = _beyond_line(grid, density)
        bend, deviation = beyond @ centre, fit.standard_errors(lambda model: beyond @ model.map(grid))
        inside = fit.map.knots[(fit.map.knots >= grid[0]) & (fit.map.knots <= grid[-1])]
        return FittedMap(
            sentence=self._looks(grid, error),
            quantity="z",
            unit=self.units.get(fit.inputs[0], ""),
            result_unit=self.units.get(fit.outputs[0], ""),
            value=grid,
            centre=centre,
            lower=centre - NORMAL_95 * error,
            upper=centre + NORMAL_95 * error,
            density=density,
            knots=inside,
            bend=bend,
            bend_deviation=deviation,
        )

    def _looks(self, grid: Floats, error: Floats) -> str:
        """Say in one sentence what the map looks like where the data are."""
        low, high = inner_range(self.z)
        inner = (grid >= low) & (grid <= high)
        slope = self.fit.map.slope(grid[inner])
        shape = "rises throughout" if np.all(slope >= 0.0) else "falls throughout"
        if np.any(slope > 0.0) and np.any(slope < 0.0):
            shape = "turns from rising to falling or back"
        unit = self.units.get(self.fit.outputs[0], "")
        band = significant(NORMAL_95 * float(error[inner].max()), 2)
        steepest, flattest = np.abs(slope).max(), np.abs(slope).min()
        return (
            f"The map {shape} where {percent(INNER)} of its data lie, its slope between "
            f"{significant(flattest, 2)} and {significant(steepest, 2)}; its 95 % band there reaches "
            f"± {band}{' ' + unit if unit else ''} at most."
        )

    def details(self) -> dict[str, Any]:
        """Return orders, blocks, map and candidates."""
        return {
            "kind": "Wiener-Hammerstein",
            "delay": self.fit.model.delay,
            "equations": list(self.equations),
            "model": self.saved(),
            "poles": [[pole.real, pole.imag] for pole in self.poles],
            "reason": self.choice.reason,
            "map": self._map.to_json(),
            "tried": [
                {
                    "orders": list(c.orders),
                    "intervals": c.intervals,
                    "oversampling": c.oversampling,
                    "validation_rmse": finite(c.validation_rms),
                }
                for c in self.choice.candidates
            ],
        }


def _beyond_line(grid: Floats, density: Floats) -> Floats:
    """Return the matrix that takes from a curve its straight line, nearest where the data are."""
    line = np.column_stack([np.ones_like(grid), grid])
    weights = np.sqrt(density)
    return np.asarray(np.eye(grid.size) - line @ np.linalg.pinv(line * weights[:, np.newaxis]) * weights)


def fit_wiener_hammerstein_structure(
    record: Record,
    options: Mapping[str, Any],
    *,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> WienerHammersteinJudged:
    """Choose and fit a model by the options of `sysid fit --structure wiener-hammerstein`.

    Parameters
    ----------
    record : Record
        With one input and one output.
    options : mapping
        Keywords of `choose_wiener_hammerstein`.
    initial_state : {"estimate", "rest"}
    progress : callable, optional
    """
    choice = choose_wiener_hammerstein(record, initial_state=initial_state, progress=progress, **options)
    runs = [choice.fit.model.map_input(record.u[part, 0])[record.learning[part]] for part in record.slices]
    return WienerHammersteinJudged(
        choice,
        dict(record.units),
        np.concatenate(runs),
        initial_state,
        name=str(options.get("shape", WIENER_HAMMERSTEIN)),
    )
