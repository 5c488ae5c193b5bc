"""Columns in another unit than the model's: mm for m, degrees for radians, rpm for rad/s.

A physical model whose parameters are free can follow such a record as well as any other; only its parameters
come out wrong, by powers of one factor.  With start values, known within some 20 %, a search may end far from
any minimum, and whatever turns the size of the output round is then named as missing.  Those start values
give the unit away: they are missed by a factor as the record stands, and met when the column is converted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.data import Record
from sysid.data.conversions import conversion, other_units, unit_at_end
from sysid.data.record import Mask
from sysid.diagnosis.wording import all_of
from sysid.errors import SysidError
from sysid.linear.forms import Floats
from sysid.linear.output_error import make_segments
from sysid.physics.expressions import Number, Symbol, operation, substitute
from sysid.physics.model import Model, Term
from sysid.physics.problem import Problem
from sysid.physics.restarts import SCREENING_EVALUATIONS, descend

# Start values are known within some 20 %, and what the model lacks moves a fit away from them: one that is
# off by this factor misses them, and a conversion must bring it as much nearer, and over half of the way on a
# scale of factors: what is missing besides, such as friction, is in both.
MISSED = 3.0
# Nothing is looked for if the run at the start values has the size of the output within the first factor;
# a conversion is thought of if it has that of the converted output within the second.
RIGHT, NEAR = 2.5, 4.0
# The error with the column converted must not be larger by the first factor, and where the fit without has
# missed no start value, smaller by the second.
AS_GOOD, BETTER = 1.1, 0.5
# What a model lacks changes its gain, and values that are known, by less than this factor.
LARGE = 20.0
# An error of this share of the output's deviation follows nothing.
FOLLOWS = 0.9
# A factor that no name tells must be met by so many start values.
FEWEST = 2
MOST_ROWS = 1_000


@dataclass(frozen=True)
class Column:
    """A column that is in another unit than the model's, or may be.

    Attributes
    ----------
    name, given, wanted : str
        Of the column, its unit, and the model's.
    size : float
        How many of its unit make one of the model's.
    drives : bool
        Whether it is the input.
    """

    name: str
    given: str
    wanted: str
    size: float
    drives: bool

    @property
    def factor(self) -> float:
        """By how much the output is too large for the model."""
        return float(f"{1.0 / self.size if self.drives else self.size:.6g}")


@dataclass(frozen=True)
class Found:
    """Where a search ended: values of the parameters, root mean square of the error."""

    values: Mapping[str, float]
    rms: float


def in_units_of(record: Record, model: Model) -> tuple[Model, str]:
    """Return the model in the units of a record, and a sentence where these are others than its own.

    Parameters
    ----------
    record : Record
    model : Model
        With start values that are known within some 20 % (uncertain) or for good (fixed); without these
        only the columns' names tell something, and the model is left as it is.

    Returns
    -------
    model : Model
    note : str
        Empty where nothing is amiss.
    """
    if len(model.inputs) != 1 or len(model.outputs) != 1 or len(record.inputs) * len(record.outputs) != 1:
        return model, ""
    told = _told(record, model)
    trial = Trial(record, model)
    if not trial.known and not trial.fixed:
        return model, _left(told)
    try:
        size = trial.size()
        if told:
            right = _nearer(size, _told_factor(told))
            return (_converted(model, told), _as_told(told)) if right else (model, "")
        if 1.0 / RIGHT < size < RIGHT:
            return model, ""
        found, sure = _guessed(trial, size, _possible(record, model, trial))
    except SysidError:  # the model cannot be simulated at its start values
        return model, _left(told)
    if not found:
        return model, ""
    return _converted(model, found[:1]) if sure else model, _as_guessed(found, sure, trial)


def in_units_of_model(record: Record, fitted: object) -> Record:
    """Return the record with columns that have no unit in the model's, as its parameters are.

    Parameters
    ----------
    record : Record
    fitted : object
        What has the physical model as it was fitted, that of `in_units_of`; other models leave all as it is.

    Returns
    -------
    Record
    """
    model = getattr(fitted, "model", None)
    if not isinstance(model, Model):
        return record
    sides = ((record.inputs, model.inputs), (record.outputs, model.outputs))
    return record.with_units(
        {columns[0]: ports[0].unit for columns, ports in sides if len(columns) == len(ports) == 1}
    )


@dataclass(frozen=True)
class Trial:
    """A record and a model with start values, the output to be divided by a factor."""

    record: Record
    model: Model

    @property
    def known(self) -> list[str]:
        """Parameters whose values are known within some 20 %."""
        return [p.name for p in self.model.parameters if p.status == "uncertain" and p.start != 0.0]

    @property
    def fixed(self) -> list[str]:
        """Parameters whose values are known for good, other than those that are left out."""
        return [p.name for p in self.model.parameters if p.status == "fixed" and p.start not in (0.0, 1.0)]

    @property
    def start(self) -> dict[str, float]:
        """Start value of each parameter."""
        return {p.name: p.start for p in self.model.parameters}

    def distance(self, values: Mapping[str, float]) -> float:
        """Return the largest factor between known and fitted values."""
        ratios = [values[name] / self.start[name] for name in self.known]
        return max((max(r, 1.0 / r) if r > 0.0 else np.inf for r in ratios), default=1.0)

    def size(self) -> float:
        """Return how much larger the output is than that of the run at the start values.

        Beside what initial states, parameters of either sign (offsets) and a zero of the sensor do.
        """
        problem = self._problem(1.0)
        free = np.concatenate(
            [np.flatnonzero(~problem.positive), len(problem.names) + np.arange(problem.n_starts)]
        )
        point = np.concatenate([problem.coordinates(self.start), np.zeros(problem.n_starts)])
        y = _measured(problem)
        with np.errstate(all="ignore"):
            run, moves = y + problem.residual(point), problem.jacobian(point)[:, free]
        both = np.column_stack([y, run])
        if not (np.isfinite(both).all() and np.isfinite(moves).all()):
            return np.inf
        basis = np.linalg.qr(np.column_stack([np.ones(y.size), moves]))[0]
        size, of_run = np.linalg.norm(both - basis @ (basis.T @ both), axis=0).tolist()
        return float(size / of_run) if of_run > 0.0 else np.inf

    def search(self, factor: float) -> Found | None:
        """Search from the start values; the error is given in the unit of the column."""
        problem = self._problem(factor)
        point = problem.point(problem.coordinates(self.start))
        if point is None:
            return None
        end = descend(problem, point, SCREENING_EVALUATIONS)
        rms = float(np.sqrt(np.mean(end.point.residual**2)))
        follows = rms < FOLLOWS * float(np.std(_measured(problem)))
        return Found(problem.values(end.x[: len(problem.names)]), rms * factor) if follows else None

    def _problem(self, factor: float) -> Problem:
        cut = make_segments(self.record, self._rows())
        segments = tuple(replace(segment, y=segment.y / factor) for segment in cut)
        return Problem(self.model, segments, self.record.period, True)

    def _rows(self) -> Mask:
        rows = self.record.estimation
        return np.asarray(rows & (np.cumsum(rows) <= MOST_ROWS))


def _measured(problem: Problem) -> Floats:
    return np.concatenate([segment.y[segment.used].ravel() for segment in problem.segments])


def _nearer(size: float, factor: float) -> bool:
    """Tell whether the output is nearer to the run at the start values when it is converted, and near."""
    return bool(abs(np.log(size / factor)) < min(abs(np.log(size)), np.log(NEAR)))


def _guessed(trial: Trial, size: float, ways: Mapping[float, list[Column]]) -> tuple[list[Column], bool]:
    """Return the columns whose conversion meets the start values best, and whether nothing else would do it.

    Parameters
    ----------
    trial : Trial
    size : float
        Of the output relative to the run at the start values.
    ways : mapping of float to list of Column
        Factors of the output, and the columns each of which would explain it.
    """
    best: list[Column] = []
    sure = False
    ways = {factor: columns for factor, columns in ways.items() if _nearer(size, factor)}
    if not ways:
        return best, sure
    plain = trial.search(1.0)
    missed = plain is None or trial.distance(plain.values) > MISSED
    most = np.inf if plain is None else (AS_GOOD if missed else BETTER) * plain.rms
    off = MISSED**2 if plain is None or not missed else trial.distance(plain.values)
    nearest = min(off / MISSED, off**0.5)
    for factor, columns in ways.items():
        other = trial.search(factor)
        if other is not None and other.rms < most and trial.distance(other.values) < nearest:
            best, nearest = columns, trial.distance(other.values)
            large = abs(np.log(factor)) > np.log(LARGE) or off > LARGE
            sure = plain is None or large or other.rms < BETTER * plain.rms
    return best, sure


def _told(record: Record, model: Model) -> list[Column]:
    """Return columns whose names tell another unit than the model's."""
    found = []
    for name, wanted, drives in _both(record, model):
        given = record.unit(name) or unit_at_end(name)
        size = conversion(given, wanted) if given else None
        if size is not None and not np.isclose(size, 1.0):
            found.append(Column(name, given, wanted, size, drives))
    return found


def _told_factor(told: Sequence[Column]) -> float:
    """Return by how much the output is too large for the model, by all columns together."""
    return float(np.prod([column.factor for column in told]))


def _possible(record: Record, model: Model, trial: Trial) -> dict[float, list[Column]]:
    """Return factors by which the output may be too large, and the columns each of which would explain it."""
    found: dict[float, list[Column]] = {}
    if len(trial.known) < FEWEST and not trial.fixed:
        return found
    moves = any(state.unit in ("m/s", "rad/s") for state in model.states)
    for name, wanted, drives in _both(record, model):
        others = {} if record.unit(name) else other_units(wanted, may_turn=moves)
        for given, size in others.items():
            column = Column(name, given, wanted, size, drives)
            found.setdefault(column.factor, []).append(column)
    return found


def _both(record: Record, model: Model) -> tuple[tuple[str, str, bool], ...]:
    """Return name, unit in the model and whether it drives of output and input."""
    return (
        (record.outputs[0], model.outputs[0].unit, False),
        (record.inputs[0], model.inputs[0].unit, True),
    )


def _converted(model: Model, columns: Sequence[Column]) -> Model:
    """Return the model with an input or an output in the unit of a column."""
    for column in columns:
        model = _driven(model, column) if column.drives else _read(model, column)
    return model


def _read(model: Model, column: Column) -> Model:
    """Return the model with its output in the unit of a column."""
    (output,) = model.outputs
    terms = tuple(
        replace(term, expression=operation("*", Number(column.size), term.expression))
        for term in output.terms
    )
    return replace(model, outputs=(replace(output, unit=column.given, terms=terms),))


def _driven(model: Model, column: Column) -> Model:
    """Return the model with its input in the unit of a column."""
    (variable,) = model.inputs
    inside = {variable.name: operation("*", Number(1.0 / column.size), Symbol(variable.name))}

    def of_terms(terms: tuple[Term, ...]) -> tuple[Term, ...]:
        return tuple(replace(term, expression=substitute(term.expression, inside)) for term in terms)

    return replace(
        model,
        inputs=(replace(variable, unit=column.given),),
        equations=tuple(replace(e, terms=of_terms(e.terms)) for e in model.equations),
        outputs=tuple(replace(o, terms=of_terms(o.terms)) for o in model.outputs),
    )


def _left(told: Sequence[Column]) -> str:
    """Say which columns are in another unit by their names, where nothing was converted."""
    if not told:
        return ""
    are = " and ".join(f"{c.name!r} is in {c.given} where the model has {c.wanted}" for c in told)
    by = " and ".join(f"{c.name!r} by {c.size:.4g}" for c in told)
    return f"Units: {are}, so that the parameters do not come out in the units shown; divide {by} first."


def _as_told(columns: Sequence[Column]) -> str:
    """Say which columns were converted, by their names."""
    are = " and ".join(f"{c.name!r} is in {c.given} where the model has {c.wanted}" for c in columns)
    return f"Units: {are}; it was converted for the model, as its start values ask."


def _as_guessed(columns: Sequence[Column], sure: bool, trial: Trial) -> str:
    """Say which column seems to be in another unit, by the start values, and whether it was converted."""
    first, *more = (f"{c.name!r} in {c.given} and not in {c.wanted}" for c in columns)
    either = f" (or {' or '.join(more)})" if more else ""
    names = all_of([*trial.known, *([] if trial.known else trial.fixed)])
    if not sure:
        return (
            f"Units: the fit is far from the values given for {names}, and would come near them with {first}"
            f"{either}: check the units."
        )
    return (
        f"Units: the record seems to have {first}{either}: only so does the model come near the values given "
        f"for {names}. It was converted for the model; check it, and give the column in that unit."
    )
