"""What a comparison needs of a fitted model, and what it may show of one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

from sysid.data import Record

if TYPE_CHECKING:
    from sysid.linear.forms import Floats
    from sysid.linear.selection import Candidate
    from sysid.linear.simulation import Prediction

LINEAR = "linear"
WIENER_HAMMERSTEIN = "wiener-hammerstein"


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


class CurveView(Protocol):
    """A static map with its band and the data it rests on, as a figure shows it.

    Attributes
    ----------
    quantity, unit, result, result_unit : str
        What the map is fed and what it returns.
    value, centre, lower, upper, density : ndarray, shape (n_points,)
        Grid, map, limits of its 95 % interval, share of the data around each point.
    knots : ndarray
    """

    @property
    def quantity(self) -> str: ...  # noqa: D102
    @property
    def unit(self) -> str: ...  # noqa: D102
    @property
    def result(self) -> str: ...  # noqa: D102
    @property
    def result_unit(self) -> str: ...  # noqa: D102
    @property
    def value(self) -> "Floats": ...  # noqa: D102
    @property
    def centre(self) -> "Floats": ...  # noqa: D102
    @property
    def lower(self) -> "Floats": ...  # noqa: D102
    @property
    def upper(self) -> "Floats": ...  # noqa: D102
    @property
    def density(self) -> "Floats": ...  # noqa: D102
    @property
    def knots(self) -> "Floats": ...  # noqa: D102


class MapView(CurveView, Protocol):
    """A map that is part of the fitted model.

    Attributes
    ----------
    heading, sentence : str
        What is drawn, and what it looks like.
    bend, bend_lower, bend_upper : ndarray, shape (n_points,)
        What the map has beyond its nearest straight line, with the 95 % interval.
    """

    @property
    def heading(self) -> str: ...  # noqa: D102
    @property
    def sentence(self) -> str: ...  # noqa: D102
    @property
    def bend(self) -> "Floats": ...  # noqa: D102
    @property
    def bend_lower(self) -> "Floats": ...  # noqa: D102
    @property
    def bend_upper(self) -> "Floats": ...  # noqa: D102


@runtime_checkable
class Known(Protocol):
    """A model whose parameters are not fitted to the record: all of its rows are held out."""

    @property
    def fitted_on(self) -> str:
        """What it was fitted on, as a table of scores says it."""


@runtime_checkable
class Mapped(Protocol):
    """A fitted model that shows maps of its own."""

    def maps(self) -> "tuple[MapView, ...]":
        """Return the maps of the final model."""


@dataclass(frozen=True)
class BlockResponse:
    """Gain of a linear block over frequency [Hz], with its 95 % band."""

    name: str
    frequency: "Floats"
    gain: "Floats"
    lower: "Floats"
    upper: "Floats"


@runtime_checkable
class Responding(Protocol):
    """A fitted model that shows the frequency responses of its linear blocks."""

    def responses(self) -> tuple[BlockResponse, ...]:
        """Return the responses of the final model, with their bands."""


class PortView(Protocol):
    """A free-form curve at a port of the model, as a comparison shows it; the best one comes first."""

    @property
    def explains_at_most(self) -> float:
        """Share of the error that a static map at this port removes."""

    @property
    def sentence(self) -> str:
        """How much of the error a static map at this port explains at most."""

    def to_json(self) -> dict[str, Any]:
        """Return its entry of the JSON file: port, explains_at_most, curve."""
