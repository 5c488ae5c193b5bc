"""Composite local linear models as a comparison sees them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sysid.data import Record
from sysid.diagnosis.models.adapters import Refitted
from sysid.diagnosis.models.doubts import doubts
from sysid.diagnosis.models.fitted_model import ParameterValue
from sysid.diagnosis.wording import ordinal, percent
from sysid.errors import UsageError
from sysid.local_linear import LocalLinearFit, choose_local_linear
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate
    from sysid.linear.simulation import Prediction

LOCAL_LINEAR = "local-linear"


@dataclass(frozen=True)
class LocalLinearModels(Refitted):
    """A few linear models that take turns by the input, on estimation rows and on all learning rows.

    Attributes
    ----------
    name : str
    fit, accepted : LocalLinearFit
        Fitted on estimation and validation rows, and on estimation rows only.
    validation : mapping
        Validation error of every (order, number of local models) that was tried.
    units : mapping of str to str
    """

    name: str
    fit: LocalLinearFit
    accepted: LocalLinearFit
    validation: Mapping[tuple[int, int], float]
    units: Mapping[str, str] = field(default_factory=dict)

    equations = (
        "x(k+1) = Σ pᵢ(φ(k)) (Aᵢ x(k) + Bᵢ u(k) + Oᵢ), y(k) = C x(k)",
        "pᵢ proportional to exp(−‖wᵢ (φ − cᵢ)‖²), Σ pᵢ = 1",
    )
    poles: tuple[complex, ...] = ()
    candidates: "tuple[Candidate, ...]" = ()

    @property
    def count(self) -> int:
        """Number of local models."""
        return self.fit.model.sizes.n_models

    @property
    def title(self) -> str:
        """Heading."""
        return f"{self.count} local linear model{'s' * (self.count > 1)} of order {self.order}"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        if self.count == 1:
            return f"A single {ordinal(self.order)}-order local linear model"
        return f"A mixture of {self.count} {ordinal(self.order)}-order local linear models"

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.fit.period

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Centres of the local models over the scheduling signals; a fit gives them no standard error."""
        found = {}
        for d, name in enumerate(self.fit.scheduling):
            several = f"_{name}" if len(self.fit.scheduling) > 1 else ""
            for i, centre in enumerate(self.fit.model.centres[:, d]):
                found[f"c{i + 1}{several}"] = ParameterValue(float(centre), None, self.units.get(name, ""))
        return found if self.count > 1 else {}

    @property
    def notes(self) -> tuple[str, ...]:
        """What schedules, how the structure was chosen, and how the search ended."""
        tried = f"{len(self.validation)} structure{'s' * (len(self.validation) > 1)}"
        error = percent(float(min(self.validation.values())))
        return (
            f"The local models are scheduled by {', '.join(self.fit.scheduling)}; of {tried} the least "
            f"free-run error on the validation rows is {error} of the signal.",
            f"Its fit: {self.fit.status}.",
        )

    @property
    def converged(self) -> bool:
        """Whether the refit converged; the search before it ends where the validation error is smallest."""
        return self.fit.converged

    @property
    def status(self) -> str:
        """How the search ended."""
        return self.fit.status

    @property
    def initial_state(self) -> str:
        """How experiments start."""
        return self.fit.initial_state

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        return doubts(
            self,
            "Searches for the local linear models from different starts ended at different errors: the "
            "one that does best on the validation rows was taken.",
            "the local linear models",
        )

    def predict(self, record: Record) -> "Prediction":
        """Predict every row by the final model."""
        return self.fit.predict(record)

    def predict_held_out(self, record: Record) -> "Prediction":
        """Predict every row by the model of the estimation rows."""
        return self.accepted.predict(record, rows=record.estimation)

    def details(self) -> dict[str, Any]:
        """Return equations, matrices, centres and widths, and the structures that were tried."""
        model = self.fit.model
        matrices = {name: getattr(model, name).tolist() for name in ("A", "B", "O", "C", "centres", "widths")}
        return {
            "equations": list(self.equations),
            "scheduling": list(self.fit.scheduling),
            "local_models": self.count,
            **matrices,
            "validation": [
                {"order": order, "local_models": count, "nrmse": finite(error)}
                for (order, count), error in self.validation.items()
            ],
        }


def is_local_linear(name: str) -> bool:
    """Tell whether a name is that of these models: ``local-linear``, or with their number behind it."""
    head, sign, number = name.partition(f"{LOCAL_LINEAR}-")
    return name == LOCAL_LINEAR or (not head and bool(sign) and number.isdecimal() and int(number) > 0)


def fit_local_models(
    record: Record,
    name: str,
    order: int | None,
    *,
    delay: int | None = None,
    constant: bool | None = None,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> LocalLinearModels:
    """Fit local linear models scheduled by all inputs; what is not given is chosen on validation rows."""
    if delay is not None or constant is not None:
        raise UsageError("delay and constant belong to the linear model: local linear models have their own")
    number = name.removeprefix(LOCAL_LINEAR).removeprefix("-")
    choice = choose_local_linear(
        record, order, int(number) if number else None, initial_state=initial_state, progress=progress
    )
    return LocalLinearModels(name, choice.fit, choice.accepted, choice.validation, dict(record.units))
