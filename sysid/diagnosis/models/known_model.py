"""A saved model as a comparison sees it: none of its parameters is fitted to the record."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.export.saved import Saved
from sysid.diagnosis.export.saved_linear import SavedModel
from sysid.diagnosis.models.fitted_model import ParameterValue
from sysid.errors import ModelError, UsageError
from sysid.linear.forms import Floats
from sysid.linear.simulation import PERIOD_TOLERANCE, Prediction, foreseen, predict_experiments
from sysid.linear.uncertainty import autoregression
from sysid.separable.descent import levenberg_marquardt

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate

# A state from which an experiment may begin: so many that the model passes are tried, the best are followed.
VISITED, FOLLOWED, EVALUATIONS = 64, 3, 40
# Step of the difference quotients by an initial state, relative to its size.
DIFFERENCE = 1e-6


@dataclass(frozen=True)
class KnownModel:
    """A model with effects as it was saved; of a record it learns initial states alone.

    Attributes
    ----------
    saved : SavedModel or SavedPhysicalModel
    name : str
        Of its file.
    initial_state : {"estimate", "rest"}
    """

    saved: Saved
    name: str
    initial_state: str = "estimate"

    fitted_on = "no row of this record"
    converged, restarts_agree = True, True
    status = "nothing was searched for, the parameters are those of the file"
    warnings: tuple[str, ...] = ()
    poles: tuple[complex, ...] = ()
    candidates: "tuple[Candidate, ...]" = ()

    @property
    def title(self) -> str:
        """Heading."""
        return f"saved model {self.name}"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        return f"The saved model {self.name}"

    @property
    def order(self) -> int:
        """Number of states."""
        return self.saved.order

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.saved.period

    @property
    def equations(self) -> tuple[str, ...]:
        """Of the model and of its effects."""
        return tuple(self.saved.equation().splitlines())

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Values of the file; those of an effect behind its name."""
        own = {name: ParameterValue(value, None, unit) for name, value, unit in self.saved.parameters()}
        return own | {
            f"{effect.name}.{p.name}": ParameterValue(effect.parameters[p.name], None, "")
            for effect in self.saved.effects
            for p in effect.choice.form.parameters
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """What of the model was taken from the record."""
        starts = "; of this record only initial states were estimated" * (self.initial_state == "estimate")
        return (f"The parameters are those of {self.name}{starts}.",)

    def predict(self, record: Record) -> Prediction:
        """Predict every row; one-step by the colour of the residual."""
        saved = at_period(self.saved, record)
        free_start = self.initial_state == "estimate"

        def run(part: slice, used: Mask, fitted: bool) -> Floats:
            start = _start(saved, record, part, used) if free_start and used.any() else None
            return saved.simulate(_input(record, part), start)

        found = predict_experiments(record, None, self.order, np.ones(1), free_start, run)
        residual = record.y[:, 0] - found.free_run
        known = [_longest_known(residual[part]) for part in record.slices]
        noise, _ = autoregression([stretch for stretch in known if stretch.size])
        one_step = found.free_run.copy()
        for part in record.slices:
            one_step[part] += foreseen(residual[part], noise)
        return replace(found, one_step=one_step)

    def predict_held_out(self, record: Record) -> Prediction:
        """Predict every row: the model has not seen any."""
        return self.predict(record)

    def details(self) -> dict[str, Any]:
        """Return equations and effects."""
        return {
            "equations": list(self.equations),
            "effects": [effect.to_json() for effect in self.saved.effects],
        }


def at_period(saved: Saved, record: Record) -> Saved:
    """Return a saved model for the inputs and the sampling period of a record, or say why it has none.

    Raises
    ------
    UsageError
        If the record has other channels, or a difference equation another period.
    """
    inputs = 1 if isinstance(saved, SavedModel) else len(saved.model.inputs)
    if record.u.shape[1] != inputs:
        raise UsageError(
            f"the record has {record.u.shape[1]} inputs ({', '.join(record.inputs)}) and the saved model "
            f"{inputs}: choose as many by --input"
        )
    if abs(record.period - saved.period) <= PERIOD_TOLERANCE * saved.period:
        return saved
    if isinstance(saved, SavedModel):
        raise UsageError(
            f"the record is sampled at {record.period:g} s and the saved difference equation at "
            f"{saved.period:g} s: bring the record to that period, by --resample {saved.period:g}"
        )
    substeps = max(int(np.ceil(saved.substeps * record.period / saved.period)), 1)
    return replace(saved, period=record.period, substeps=substeps)


def _input(record: Record, part: slice) -> Floats:
    u = record.u[part]
    return u[:, 0] if u.shape[1] == 1 else u


def _longest_known(residual: Floats) -> Floats:
    """Return the longest stretch without a gap."""
    gaps = np.flatnonzero(~np.isfinite(residual))
    edges = np.concatenate([[-1], gaps, [residual.size]])
    longest = int(np.argmax(np.diff(edges)))
    return residual[edges[longest] + 1 : edges[longest + 1]]


def _start(saved: Saved, record: Record, part: slice, used: Mask) -> Floats:
    """Return the initial state of an experiment that follows its rows ``used`` best."""
    last = int(np.flatnonzero(used)[-1]) + 1
    u, used = _input(record, part)[:last], used[:last]
    y = record.y[part, 0][:last][used]
    visited = saved.visited(_input(record, part))
    finite = np.flatnonzero(np.isfinite(visited).all(axis=1))
    chosen = finite[np.linspace(0, finite.size - 1, min(VISITED, finite.size)).astype(int)]
    starts = np.vstack([saved.rest, visited[chosen]])
    sizes = np.maximum(np.std(starts, axis=0), DIFFERENCE * float(np.std(y)) + np.finfo(float).tiny)
    if starts.shape[0] == 1:
        sizes = np.full(saved.order, max(float(np.std(y)), np.finfo(float).tiny))

    def residual(start: Floats) -> Floats:
        try:
            return saved.simulate(u, start)[used] - y
        except ModelError:
            return np.full(y.size, np.inf)

    def jacobian(start: Floats) -> Floats:
        centre, moves = residual(start), np.diag(DIFFERENCE * np.maximum(np.abs(start), sizes))
        columns = [(residual(start + move) - centre) / move.max() for move in moves]
        J = np.column_stack(columns)
        return J if np.isfinite(J).all() else np.nan_to_num(J, nan=0.0, posinf=0.0, neginf=0.0)

    costs = np.array([float(r @ r) for r in map(residual, starts)])
    if not np.isfinite(costs).any():
        return saved.rest
    best = starts[np.argsort(costs, kind="stable")[:FOLLOWED]]
    ends = [
        levenberg_marquardt(residual, jacobian, start, tolerance=1e-8, max_evaluations=EVALUATIONS)
        for start in best
        if np.isfinite(residual(start)).all()
    ]
    return min(ends, key=lambda end: end.cost).x
