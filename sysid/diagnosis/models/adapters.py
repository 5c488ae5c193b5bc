"""Linear and physical models as a comparison sees them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.models.doubts import doubts
from sysid.diagnosis.models.fitted_model import LINEAR, ParameterValue
from sysid.diagnosis.wording import ordinal, quantity
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate, Choice
    from sysid.linear.simulation import Prediction
    from sysid.physics import Model, PhysicsFit


@dataclass(frozen=True)
class LinearModel:
    """A linear output-error model and how it was chosen."""

    choice: "Choice"
    units: Mapping[str, str] = field(default_factory=dict)

    name = LINEAR

    @property
    def title(self) -> str:
        """Heading."""
        return f"linear model of order {self.order}"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        return f"A {ordinal(self.order)}-order linear model"

    @property
    def order(self) -> int:
        """Degree of A."""
        return self.choice.fit.order

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.choice.fit.period

    @property
    def equations(self) -> tuple[str, ...]:
        """The difference equation."""
        constant = " + constant" if self.choice.fit.structure.constant else ""
        return (
            f"A(q) y = B(q) u{constant}, with A = 1 + a1 q⁻¹ + … and each b numbered by its power of q⁻¹",
        )

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Coefficients a1, ..., b1, ..., constant."""
        return {
            name: ParameterValue(value, error, self._unit(name))
            for name, (value, error) in self.choice.fit.parameters().items()
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """When the input acts, and why this structure."""
        fit = self.choice.fit
        acts = (
            "the input acts at once"
            if fit.delay == 0
            else f"the input acts after {fit.delay} sample{'s' * (fit.delay > 1)} "
            f"({quantity(fit.delay * fit.period, 's')})"
        )
        constant = "with" if fit.structure.constant else "without"
        return f"In the model {acts}, {constant} a constant.", self.choice.reason

    @property
    def initial_state(self) -> str:
        """How experiments start."""
        return "estimate" if self.choice.fit.structure.free_start else "rest"

    @property
    def converged(self) -> bool:
        """Whether the search converged."""
        return self.choice.fit.converged

    @property
    def restarts_agree(self) -> bool:
        """Whether searches from different starts agreed."""
        return self.choice.restarts_agree

    @property
    def status(self) -> str:
        """How the search ended."""
        return self.choice.fit.status

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        return doubts(
            self,
            "Searches for the linear model from different starts ended at different errors or outputs: "
            "another model of the same order may do better; compare other orders with --order.",
            "the linear model",
        )

    @property
    def poles(self) -> tuple[complex, ...]:
        """Zeros of A."""
        return tuple(complex(pole) for pole in self.choice.fit.poles)

    @property
    def candidates(self) -> "tuple[Candidate, ...]":
        """Structures that were tried."""
        return self.choice.candidates

    def predict(self, record: Record) -> "Prediction":
        """Predict every row by the final model."""
        from sysid.linear.simulation import predict

        return predict(self.choice.fit, record)

    def predict_held_out(self, record: Record) -> "Prediction":
        """Predict every row by the model of the estimation rows."""
        from sysid.linear.simulation import predict

        return predict(self.choice.accepted, record, rows=record.estimation)

    def details(self) -> dict[str, Any]:
        """Return structure, poles and candidates."""
        fit = self.choice.fit
        return {
            "delay": fit.delay,
            "direct": fit.structure.direct,
            "constant": fit.structure.constant,
            "poles": [[pole.real, pole.imag] for pole in self.poles],
            "reason": self.choice.reason,
            "candidates": [
                {
                    "order": c.order,
                    "delay": c.delay,
                    "constant": c.constant,
                    "validation_rmse": finite(c.validation_rms),
                    "restarts_agree": c.restarts_agree,
                }
                for c in self.candidates
            ],
        }

    def _unit(self, name: str) -> str:
        """Return the unit of a coefficient: none for a, output per input for b, output for the constant."""
        fit = self.choice.fit
        output = self.units.get(fit.outputs[0], "")
        if name == "constant":
            return output
        if not name.startswith("b"):
            return ""
        channel = int(name.split("_")[1]) - 1 if "_" in name else 0
        unit = self.units.get(fit.inputs[channel], "")
        if unit == output:
            return ""
        return f"{output or '1'}/{unit}" if unit else output


class Refitted:
    """What a model tells of its two searches: on the estimation rows, and again with the validation rows."""

    fit: Any
    accepted: Any

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.fit.order)

    @property
    def converged(self) -> bool:
        """Whether both searches converged."""
        return bool(self.fit.converged and self.accepted.converged)

    @property
    def restarts_agree(self) -> bool:
        """Whether the search on the estimation rows, from many starts, was repeatable."""
        return bool(self.accepted.restarts_agree)

    @property
    def status(self) -> str:
        """How the search ended."""
        return str(self.fit.status if self.restarts_agree else self.accepted.status)


@dataclass(frozen=True)
class PhysicalModel(Refitted):
    """A grey-box model fitted on the estimation rows and refitted with the validation rows."""

    fit: "PhysicsFit"
    accepted: "PhysicsFit"
    remarks: tuple[str, ...] = ()
    poles: tuple[complex, ...] = ()
    candidates: "tuple[Candidate, ...]" = ()

    @property
    def name(self) -> str:
        """Name of the model."""
        return self.fit.model.name

    @property
    def title(self) -> str:
        """Heading."""
        return f"model {self.name}"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        return f"The model {self.name}"

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.fit.period

    @property
    def equations(self) -> tuple[str, ...]:
        """Equations of motion."""
        return tuple(str(self.fit.model).splitlines())

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Fitted and fixed parameters; a fixed one has no standard error."""
        return {
            name: ParameterValue(value, error if name in self.fit.names else None, self.fit.unit(name))
            for name, (value, error) in self.fit.parameters().items()
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """Which parameters were searched."""
        fixed = [name for name in self.fit.values if name not in self.fit.names]
        known = f"; {', '.join(fixed)} {'is' if len(fixed) == 1 else 'are'} fixed" if fixed else ""
        names = ", ".join(self.fit.names)
        fitted = f"The parameters {names} were fitted by the free-run error of the model{known}."
        return (fitted, *self.remarks)

    @property
    def initial_state(self) -> str:
        """How experiments start."""
        return self.fit.initial_state

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        found = doubts(
            self,
            f"Searches for the parameters of {self.name} from different starts disagree in error or "
            "output: give start values near the plant's with --param, or known values with --fix.",
            self.name,
        )
        loose = self.fit.uncertainty.undetermined
        if not loose:
            return found
        return (
            *found,
            f"The record determines only combinations of {', '.join(loose)}: fix one of them with --fix.",
        )

    def predict(self, record: Record) -> "Prediction":
        """Predict every row by the final model."""
        return self.fit.predict(record)

    def predict_held_out(self, record: Record) -> "Prediction":
        """Predict every row by the model of the estimation rows."""
        return self.accepted.predict(record, rows=record.estimation)

    def details(self) -> dict[str, Any]:
        """Return equations and which parameters were fixed."""
        return {
            "title": self.fit.model.title,
            "equations": list(self.equations),
            "fixed": [name for name in self.fit.values if name not in self.fit.names],
            "hold": self.fit.hold,
        }

    @property
    def plant(self) -> "PhysicsFit":
        """The fit as the plant of the output that is judged."""
        return self.fit

    @property
    def model(self) -> "Model":
        """The physical model of the output that is judged."""
        return self.plant.model


@dataclass(frozen=True)
class JointModel(PhysicalModel):
    """One output of a grey-box model that was fitted to several outputs together.

    Attributes
    ----------
    whole : Record or None
        With all outputs: initial states are estimated from all of them.
    place : int
        Which output.
    """

    whole: Record | None = None
    place: int = 0

    @property
    def plant(self) -> "PhysicsFit":
        """The fit as the plant of the output that is judged."""
        return self.fit.of_output(self.place)

    def predict(self, record: Record) -> "Prediction":
        """Predict every row of the output by the final model."""
        return self._column(self.fit.predict(self.whole or record))

    def predict_held_out(self, record: Record) -> "Prediction":
        """Predict every row of the output by the model of the estimation rows."""
        return self._column(self.accepted.predict(self.whole or record, rows=record.estimation))

    def _column(self, prediction: "Prediction") -> "Prediction":
        free_run, one_step = (
            np.ascontiguousarray(both[:, self.place]) for both in (prediction.free_run, prediction.one_step)
        )
        return replace(prediction, free_run=free_run, one_step=one_step)

    def details(self) -> dict[str, Any]:
        """Return further which outputs the model was fitted to."""
        return {**super().details(), "fitted_outputs": list(self.fit.outputs)}
