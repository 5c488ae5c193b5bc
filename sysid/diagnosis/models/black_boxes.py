"""State-space and Hammerstein models as a comparison sees them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sysid.data import Record
from sysid.diagnosis.models.adapters import Refitted
from sysid.diagnosis.models.doubts import doubts
from sysid.diagnosis.models.fitted_model import ParameterValue
from sysid.diagnosis.wording import ordinal
from sysid.errors import UsageError
from sysid.linear import HammersteinFit, StateSpaceFit, choose_output_error, fit_hammerstein, fit_state_space
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate
    from sysid.linear.simulation import Prediction

STATE_SPACE, HAMMERSTEIN = "state-space", "hammerstein-"


@dataclass(frozen=True)
class BlackBox(Refitted):
    """A state-space or Hammerstein model, fitted on the estimation rows and on all learning rows.

    Attributes
    ----------
    name, title, subject : str
    equations, notes : tuple of str
    fit, accepted : StateSpaceFit or HammersteinFit
        Fitted on estimation and validation rows, and on estimation rows only.
    parameters : mapping of str to ParameterValue
    """

    name: str
    title: str
    subject: str
    equations: tuple[str, ...]
    notes: tuple[str, ...]
    fit: StateSpaceFit | HammersteinFit
    accepted: StateSpaceFit | HammersteinFit
    parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    candidates: "tuple[Candidate, ...]" = ()

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.fit.period

    @property
    def initial_state(self) -> str:
        """How experiments start."""
        if isinstance(self.fit, StateSpaceFit):
            return self.fit.initial_state
        return "estimate" if self.fit.structure.free_start else "rest"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        return doubts(
            self,
            f"Searches for the {self.title} from different starts ended at different errors or outputs: "
            "another one of the same order may do better; compare other orders with --order.",
            f"the {self.title}",
        )

    @property
    def poles(self) -> tuple[complex, ...]:
        """Poles of the linear part."""
        return tuple(complex(pole) for pole in self.fit.poles)

    def predict(self, record: Record) -> "Prediction":
        """Predict every row by the final model."""
        return self.fit.predict(record)

    def predict_held_out(self, record: Record) -> "Prediction":
        """Predict every row by the model of the estimation rows."""
        return self.accepted.predict(record, rows=record.estimation)

    def details(self) -> dict[str, Any]:
        """Return equations and poles, and the matrices of a state-space model."""
        found: dict[str, Any] = {
            "equations": list(self.equations),
            "poles": [[pole.real, pole.imag] for pole in self.poles],
        }
        if isinstance(self.fit, StateSpaceFit):
            matrices = {"A": self.fit.A, "B": self.fit.B, "C": self.fit.C, "D": self.fit.D}
            found |= {name: matrix.tolist() for name, matrix in matrices.items()}
            found |= {"offset": self.fit.offset.tolist(), "drift": self.fit.drift.tolist()}
            found["validation"] = {str(order): finite(error) for order, error in self.fit.validation.items()}
        return found


def black_box_names() -> tuple[str, ...]:
    """Return the names of these models."""
    from sysid.nonlinearities import NONLINEARITIES

    return (STATE_SPACE, *(f"{HAMMERSTEIN}{name}" for name in NONLINEARITIES))


def fit_black_box(
    record: Record,
    name: str,
    order: int | None = None,
    *,
    delay: int | None = None,
    constant: bool | None = None,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> BlackBox:
    """Fit a state-space or Hammerstein model; its order is chosen on validation rows if not given."""
    if name == STATE_SPACE:
        if delay is not None or constant is not None:
            raise UsageError(
                "delay and constant belong to the linear model: a state-space model finds its own"
            )
        return _state_space(record, order, initial_state, progress)
    return _hammerstein(record, name, order, delay, constant, initial_state, progress)


def _state_space(
    record: Record, order: int | None, initial_state: str, progress: Callable[[int, int], None] | None
) -> BlackBox:
    if record.y.shape[1] != 1:
        raise UsageError(f"the record has {record.y.shape[1]} outputs: compare one at a time")
    chosen = fit_state_space(record, order, initial_state=initial_state)
    if progress is not None:
        progress(1, 2)
    accepted = fit_state_space(record, chosen.order, initial_state=initial_state, rows=record.estimation)
    if progress is not None:
        progress(2, 2)
    return BlackBox(
        name=STATE_SPACE,
        title=f"state-space model of order {chosen.order}",
        subject=f"A {ordinal(chosen.order)}-order state-space model",
        equations=("x(k+1) = A x(k) + B u(k) + drift", "y(k) = C x(k) + D u(k) + offset"),
        notes=(f"Its fit: {chosen.status}.",),
        fit=chosen,
        accepted=accepted,
    )


def _hammerstein(
    record: Record,
    name: str,
    order: int | None,
    delay: int | None,
    constant: bool | None,
    initial_state: str,
    progress: Callable[[int, int], None] | None,
) -> BlackBox:
    """Fit a Hammerstein model; what is not given of its linear part is that of the best linear model."""
    linear = choose_output_error(
        record, order=order, delay=delay, constant=constant, initial_state=initial_state, progress=progress
    )
    structure = linear.fit.structure
    kind = name.removeprefix(HAMMERSTEIN)
    fits = [
        fit_hammerstein(
            record,
            kind,
            structure.order,
            delay=structure.delay,
            constant=structure.constant,
            initial_state=initial_state,
            rows=rows,
        )
        for rows in (record.learning, record.estimation)
    ]
    fit, accepted = fits
    unit = record.unit(record.inputs[0])
    words = fit.nonlinearity.title.lower()
    return BlackBox(
        name=name,
        title=f"Hammerstein model with {words} of order {fit.order}",
        subject=f"A {ordinal(fit.order)}-order model behind {words} of the input",
        equations=("A(q) y = B(q) N(u) + constant, N the map of the input",),
        notes=(f"Order, delay and constant are those of the linear model: {linear.reason}",),
        fit=fit,
        accepted=accepted,
        parameters={
            key: ParameterValue(value, None if error != error else error, _unit(fit, key, unit))
            for key, (value, error) in fit.parameters().items()
        },
    )


def _unit(fit: HammersteinFit, name: str, unit: str) -> str:
    return unit if name in fit.threshold_names else ""
