"""What a comparison needs of a fitted model, and how linear and physical models provide it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from sysid.data import Record
from sysid.diagnosis.scores import finite
from sysid.diagnosis.wording import ordinal, quantity
from sysid.errors import UsageError

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate, Choice
    from sysid.linear.simulation import Prediction
    from sysid.physics import Model, PhysicsFit, Starts

LINEAR = "linear"


class ParameterValue(NamedTuple):
    """A parameter with its standard error (None if it was not estimated) and unit."""

    value: float
    std_error: float | None
    unit: str


class FittedModel(Protocol):
    """A fitted model, as a comparison sees it.

    Attributes
    ----------
    name : str
        ``"linear"``, or the name of a physical model.
    title : str
        For a heading: ``"linear model of order 2"``.
    subject : str
        For the start of a sentence: ``"A second-order linear model"``.
    order : int
        Number of states.
    period : float
        Sampling period [s].
    equations : tuple of str
    parameters : mapping of str to ParameterValue
    notes : tuple of str
        Sentences on the structure and how it was chosen.
    initial_state : {"estimate", "rest"}
    converged, restarts_agree : bool
    status : str
        How the search ended.
    warnings : tuple of str
    poles : tuple of complex
        Of a discrete-time model; empty otherwise.
    candidates : tuple of Candidate
        Structures that were tried; empty where the structure was given.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def title(self) -> str: ...  # noqa: D102
    @property
    def subject(self) -> str: ...  # noqa: D102
    @property
    def order(self) -> int: ...  # noqa: D102
    @property
    def period(self) -> float: ...  # noqa: D102
    @property
    def equations(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def parameters(self) -> Mapping[str, ParameterValue]: ...  # noqa: D102
    @property
    def notes(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def initial_state(self) -> str: ...  # noqa: D102
    @property
    def converged(self) -> bool: ...  # noqa: D102
    @property
    def restarts_agree(self) -> bool: ...  # noqa: D102
    @property
    def status(self) -> str: ...  # noqa: D102
    @property
    def warnings(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def poles(self) -> tuple[complex, ...]: ...  # noqa: D102
    @property
    def candidates(self) -> "tuple[Candidate, ...]": ...  # noqa: D102

    def predict(self, record: Record) -> "Prediction":
        """Predict every row by the final model, fitted on estimation and validation rows."""

    def predict_held_out(self, record: Record) -> "Prediction":
        """Predict every row by the same structure fitted on estimation rows only."""

    def details(self) -> dict[str, Any]:
        """Return further entries of the model's part of the JSON file."""


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
        found = []
        if not self.restarts_agree:
            found.append(
                "Searches for the linear model from different starts ended at different errors: another "
                "model of the same order may do better; compare other orders with --order."
            )
        if not self.converged:
            found.append(f"The fit of the linear model did not converge: {self.status}.")
        return tuple(found)

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


@dataclass(frozen=True)
class PhysicalModel:
    """A grey-box model fitted on the estimation rows and refitted with the validation rows."""

    fit: "PhysicsFit"
    accepted: "PhysicsFit"
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
    def order(self) -> int:
        """Number of states."""
        return self.fit.order

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
        return (f"Its parameters {', '.join(self.fit.names)} were fitted by the free-run error{known}.",)

    @property
    def initial_state(self) -> str:
        """How experiments start."""
        return self.fit.initial_state

    @property
    def converged(self) -> bool:
        """Whether both searches converged."""
        return self.fit.converged and self.accepted.converged

    @property
    def restarts_agree(self) -> bool:
        """Whether the search on the estimation rows, from many starts, was repeatable."""
        return self.accepted.restarts_agree

    @property
    def status(self) -> str:
        """How the search ended."""
        return self.fit.status if self.restarts_agree else self.accepted.status

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        found = []
        if not self.restarts_agree:
            found.append(
                f"Searches for the parameters of {self.name} from different starts disagree in error or "
                "output: give start values near the plant's with --param, or known values with --fix."
            )
        if not self.converged:
            found.append(f"The fit of {self.name} did not converge: {self.status}.")
        if loose := self.fit.uncertainty.undetermined:
            found.append(
                f"The record determines only combinations of {', '.join(loose)}: fix one of them with --fix."
            )
        return tuple(found)

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
        }


def resolve_model(
    model: "str | Path | Model",
    order: int | None = None,
    start: "Starts | None" = None,
    fixed: Mapping[str, float] | None = None,
) -> "Model | str | None":
    """Return a physical model with start and known values, None for the linear one, or another's name.

    Parameters
    ----------
    model : str, Path or Model
        ``"linear"``, ``"state-space"``, ``"hammerstein-..."`` with the name of a map, the name of a physical
        model, a TOML file, or a model.
    order : int, optional
    start, fixed : mapping of str to float, optional

    Raises
    ------
    UsageError, ModelError
        If there is no such model or parameter, or an option does not belong to the model.

    Examples
    --------
    >>> resolve_model("two-tanks", fixed={"b": 0.5}).parameter("b").status
    'fixed'
    """
    from sysid.physics import Model, all_model_names, is_known, is_model_class, load_model

    if isinstance(model, str) and (model == LINEAR or model in _black_boxes(model)):
        if given := [*(start or {}), *(fixed or {})]:
            raise UsageError(
                f"the {model} model has no parameter {given[0]!r} to start from or to fix: its coefficients "
                "are found without start values, so leave it out or choose a physical model"
            )
        return None if model == LINEAR else model
    if isinstance(model, Model):
        found = model
    else:
        if not isinstance(model, str | Path) and not is_model_class(model):
            raise UsageError(f"model is of type {type(model).__name__}: give a name, a TOML file or a Model")
        if isinstance(model, str | Path) and not is_known(model):
            known = ", ".join((LINEAR, *all_model_names(), *_black_boxes(model)))
            raise UsageError(
                f"model {str(model)!r} is not known: choose one of {known}, or give a .toml file or a class "
                "as module:Class"
            )
        found = load_model(model)
    if order is not None and order != found.order:
        raise UsageError(
            f"order is {order} and model {found.name!r} has {found.order} states: leave the order out"
        )
    return found.with_parameters(start, fixed)


def _black_boxes(model: str | Path) -> tuple[str, ...]:
    """Return the names of state-space and Hammerstein models, without loading them for others."""
    if not str(model).startswith(("state", "hammerstein")):
        return ("state-space", "hammerstein-<map>")
    from sysid.diagnosis.black_boxes import black_box_names

    return black_box_names()


def fit_model(
    record: Record,
    model: "Model | str | None",
    order: int | None = None,
    *,
    delay: int | None = None,
    constant: bool | None = None,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> FittedModel:
    """Fit a physical model, or choose and fit a linear one (None).

    A physical model is searched on the estimation rows from many starts; the refit with the
    validation rows goes on from there.
    """
    if model is None:
        from sysid.linear.selection import choose_output_error

        choice = choose_output_error(
            record,
            order=order,
            delay=delay,
            constant=constant,
            initial_state=initial_state,
            progress=progress,
        )
        return LinearModel(choice, dict(record.units))
    if isinstance(model, str):
        from sysid.diagnosis.black_boxes import fit_black_box

        return fit_black_box(
            record,
            model,
            order,
            delay=delay,
            constant=constant,
            initial_state=initial_state,
            progress=progress,
        )
    from sysid.physics import fit_physics

    if delay is not None or constant is not None:
        raise UsageError(
            f"delay and constant belong to the linear model: {model.name!r} has parameters instead"
        )
    accepted = fit_physics(record, model, initial_state=initial_state, rows=record.estimation)
    if progress is not None:
        progress(2, 3)
    near = {name: accepted.values[name] for name in accepted.names}
    fit = fit_physics(record, model, start=near, initial_state=initial_state)
    if progress is not None:
        progress(3, 3)
    return PhysicalModel(fit, accepted)
