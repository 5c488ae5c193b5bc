"""Piecewise affine LFT models as a comparison sees them, and `sysid fit --structure piecewise-affine`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.models.fitted_model import ParameterValue
from sysid.errors import DataError, ModelError, SysidError, UsageError
from sysid.lft.alternating import fit_alternating
from sysid.lft.identifiability import column_name, identifiability, require_identifiable
from sysid.lft.joint import JointFit, fit_joint
from sysid.lft.piecewise import PiecewiseLft, PiecewiseStructure
from sysid.lft.piecewise_files import to_json
from sysid.linear.simulation import Prediction
from sysid.nonlinearities.piecewise_affine import BoundedError, GlobalSearch, KPlane, Stage
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.selection import Candidate

Floats = NDArray[np.float64]
Segments = tuple[list[Floats], list[Floats]]

MODES = (2, 3, 4)
"""Numbers of modes that are tried where none is given."""
QUICK = 1e-2
"""Stopping threshold of the alternating scheme, which only starts the joint fit."""


@dataclass(frozen=True)
class PiecewiseJudged:
    """A piecewise affine LFT model, fitted on estimation rows and refitted with validation rows."""

    fit: JointFit
    accepted: JointFit
    period: float
    reason: str
    tried: tuple[tuple[int, float], ...]
    signals: Mapping[str, str]
    initial_state: str = "estimate"
    candidates: "tuple[Candidate, ...]" = ()
    name: str = "piecewise-affine"

    @property
    def model(self) -> PiecewiseLft:
        """The final model."""
        return self.fit.model

    @property
    def validation_error(self) -> float:
        """One-step error on validation rows of the chosen number of modes."""
        return min(error for _, error in self.tried)

    @property
    def title(self) -> str:
        """Heading."""
        return f"piecewise affine LFT model of {self.model.map.modes} modes"

    @property
    def subject(self) -> str:
        """Start of a sentence."""
        fed = ", ".join(column_name(lag) for lag in self.model.structure.z_lags)
        return f"A linear model around a piecewise affine map of {fed}"

    @property
    def order(self) -> int:
        """Samples that the model looks back."""
        return self.model.structure.first

    @property
    def equations(self) -> tuple[str, ...]:
        """The difference equation, the map, and its regions."""
        s, map_ = self.model.structure, self.model.map
        terms = ["w(k)", *(f"g{i} w(k-{i})" for i in range(1, s.n_g + 1))]
        past = [f"- a{i} y(k-{i})" for i in range(1, s.n_a + 1)]
        forced = [f"+ b{d} {column_name(('u', d))}" for d in s.b_lags]
        arguments = [*(column_name(lag) for lag in s.z_lags), "1"]
        found = [" ".join(["y(k) =", " + ".join(terms), *forced, *past, "+ e(k)"])]
        for region in range(map_.regions):
            mode = int(map_.owners[region]) + 1
            value = " + ".join(f"theta{mode}_{j} {name}" for j, name in enumerate(arguments, 1))
            found.append(
                f"w(k) = {value.removesuffix(' 1')} in {_where(map_.inequalities(region)[0], arguments)}"
            )
        return tuple(found)

    @property
    def parameters(self) -> Mapping[str, ParameterValue]:
        """Coefficients with standard errors, the boundaries taken as known."""
        errors = self.fit.std_errors
        return {
            name: ParameterValue(value, finite(errors[name]), "") for name, value in self.model.values.items()
        }

    @property
    def converged(self) -> bool:
        """Whether both fits converged."""
        return all(one.status.startswith("converged") for one in (self.fit, self.accepted))

    @property
    def restarts_agree(self) -> bool:
        """The start is one deterministic search; nothing to compare."""
        return True

    @property
    def status(self) -> str:
        """How the fit ended."""
        return self.fit.status

    @property
    def notes(self) -> tuple[str, ...]:
        """How many samples each mode rests on, how the number of modes came about."""
        counts = np.bincount(self.fit.labels, minlength=self.model.map.modes)
        shares = ", ".join(f"mode {i}: {count}" for i, count in enumerate(counts.tolist(), 1))
        check = str(identifiability(self.model.structure, self.model.g))
        return (f"Samples of each mode: {shares}.", self.reason, f"The structure is {check}.")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What makes the fit doubtful."""
        return () if self.converged else (f"The fit did not converge: {self.status}.",)

    @property
    def poles(self) -> tuple[complex, ...]:
        """Zeros of A."""
        return tuple(complex(pole) for pole in np.roots(np.append(1.0, self.model.a)))

    def predict(self, record: Record) -> Prediction:
        """Predict every row by the final model."""
        return self._prediction(self.fit.model, record)

    def predict_held_out(self, record: Record) -> Prediction:
        """Predict every row by the model of the estimation rows."""
        return self._prediction(self.accepted.model, record)

    def _prediction(self, model: PiecewiseLft, record: Record) -> Prediction:
        first = model.structure.first
        runs, ahead, starts = [], [], []
        for rows in record.slices:
            u, y = record.u[rows, 0], record.y[rows, 0]
            measured = self.initial_state != "rest" and bool(np.isfinite(y[:first]).all())
            run = model.simulate(u, initial=y[:first] if measured else ())
            filled = np.where(np.isfinite(y), y, run)
            usable = u.size > first and bool(np.isfinite(filled).all())
            step = model.one_step(u, filled) if usable else run
            runs.append(run)
            # Rows whose lags are not all measured have no other prediction than that of the free run.
            ahead.append(np.where(np.isfinite(step), step, run))
            starts.append(f"the first {first} rows as measured" if measured else "at rest")
        return Prediction(np.concatenate(runs), np.concatenate(ahead), tuple(starts))

    def saved(self) -> dict[str, Any]:
        """Return the final model as plain values, for `sysid.lft.load`."""
        return to_json(self.model)

    def details(self) -> dict[str, Any]:
        """Return structure, map and how the number of modes was chosen."""
        return {
            "equations": list(self.equations),
            "model": self.saved(),
            "reason": self.reason,
            "signals": dict(self.signals),
            "tried": [{"modes": modes, "validation_rmse": finite(error)} for modes, error in self.tried],
        }


def _where(inequalities: Floats, arguments: list[str]) -> str:
    """Return a region in words."""
    if not len(inequalities):
        return "all of the space"
    lines = []
    for row in inequalities:
        size = float(np.abs(row[:-1]).max()) or 1.0
        terms = [f"{value / size:+.3g} {name}" for value, name in zip(row, arguments, strict=True)]
        lines.append(" ".join(terms).removesuffix(" 1") + " <= 0")
    return "{ " + "; ".join(lines) + " }"


def fit_piecewise_structure(
    record: Record,
    options: Mapping[str, Any],
    *,
    initial_state: str = "estimate",
    progress: Callable[[int, int], None] | None = None,
) -> PiecewiseJudged:
    """Fit a piecewise affine LFT model by the options of `sysid fit --structure piecewise-affine`.

    Parameters
    ----------
    record : Record
        With one input and one output.
    options : mapping
        ``z_lags`` (needed), ``n_a``, ``n_g``, ``b_lags``, ``modes``, ``stage``, ``delta``, ``seed``.
    initial_state : {"estimate", "rest"}
    progress : callable, optional

    Raises
    ------
    DataError, ModelError, UsageError, IdentifiabilityError
        If record and options do not make a model.
    """
    if len(record.inputs) != 1 or len(record.outputs) != 1:
        raise DataError(
            f"the record has {len(record.inputs)} inputs and {len(record.outputs)} outputs: a piecewise "
            "affine model takes one of each, choose them by --input and --output"
        )
    structure = _structure(record, options)
    require_identifiable(structure)
    seed = int(options.get("seed", 0))
    bounded = options.get("stage") == "bounded-error"
    candidates = (options["modes"],) if "modes" in options else ((0,) if bounded else MODES)
    fits: list[tuple[float, int, JointFit]] = []
    problem: SysidError | None = None
    for place, modes in enumerate(candidates):
        try:
            found = _fitted(
                structure, _segments(record, record.estimation, structure), _stage(options, modes), seed
            )
            fits.append((_validation_error(found.model, record), found.model.map.modes, found))
        except (ModelError, UsageError) as reason:
            problem = reason
        if progress is not None:
            progress(place + 1, len(candidates) + 1)
    if not fits:
        assert problem is not None
        raise problem
    _, modes, accepted = min(fits, key=lambda one: one[0])
    final = fit_joint(
        *_segments(record, record.learning, structure), accepted.model, rng=np.random.default_rng(seed)
    )
    how = "found by its bound on the error" if bounded else "given"
    if len(fits) > 1:
        tried = ", ".join(f"{count} modes {error:.4g}" for error, count, _ in fits)
        how = f"chosen by the one-step error on validation rows ({tried})"
    signals = {"u": record.inputs[0], "y": record.outputs[0]}
    return PiecewiseJudged(
        final,
        accepted,
        record.period,
        f"The number of modes was {how}.",
        tuple((count, error) for error, count, _ in fits),
        signals,
        initial_state,
    )


def _structure(record: Record, options: Mapping[str, Any]) -> PiecewiseStructure:
    if not options.get("z_lags"):
        raise UsageError("the map's arguments are not given: name them by --z, as --z y:2,u:2")
    names = {record.inputs[0]: "u", record.outputs[0]: "y", "u": "u", "y": "y"}

    def lag(signal: str, delay: int) -> tuple[str, int]:
        if signal not in names:
            raise ModelError(f"{signal!r} is no signal of the record: it has {', '.join(sorted(names))}")
        return names[signal], delay

    b_lags = [lag(*one) for one in options.get("b_lags", ())]
    if any(signal != "u" for signal, _ in b_lags):
        raise ModelError("b_lags names the output: lags of y in the linear part are given by --a-order")
    return PiecewiseStructure(
        options.get("n_a", 1),
        tuple(delay for _, delay in b_lags),
        options.get("n_g", 0),
        tuple(lag(*one) for one in options["z_lags"]),
    )


def _stage(options: Mapping[str, Any], modes: int) -> Stage:
    stage = options.get("stage", "k-plane")
    if stage == "bounded-error":
        if "delta" not in options:
            raise UsageError(
                "the stage bounded-error needs its bound: give --delta, in the unit of the output"
            )
        return BoundedError(options["delta"])
    return GlobalSearch(modes) if stage == "global" else KPlane(modes)


def _fitted(structure: PiecewiseStructure, data: Segments, stage: Stage, seed: int) -> JointFit:
    rng = np.random.default_rng(seed)
    start = fit_alternating(*data, structure, stage, threshold=QUICK, constant=True, rng=rng)
    return fit_joint(*data, start.model, rng=rng)


def _segments(record: Record, chosen: Mask, structure: PiecewiseStructure) -> Segments:
    """Return the stretches of chosen rows without a gap that are long enough for a prediction."""
    inputs, outputs = [], []
    for rows in record.slices:
        marks = np.flatnonzero(np.diff(np.concatenate([[0], chosen[rows].astype(np.int8), [0]])))
        for begin, end in zip(marks[::2], marks[1::2], strict=True):
            if end - begin > structure.first:
                inputs.append(record.u[rows, 0][begin:end])
                outputs.append(record.y[rows, 0][begin:end])
    if not inputs:
        raise DataError(
            f"no stretch of estimation rows is longer than the {structure.first} samples the model looks "
            "back: give a longer record or shorter lags"
        )
    return inputs, outputs


def _validation_error(model: PiecewiseLft, record: Record) -> float:
    """Return the RMS of the one-step error on validation rows."""
    squares, count = 0.0, 0
    for rows in record.slices:
        u, y, chosen = record.u[rows, 0], record.y[rows, 0], record.validation[rows]
        known = np.isfinite(y)
        end = int(np.argmin(known)) if not known.all() else y.size  # up to the first row not measured
        if end > model.structure.first:
            off = (y[:end] - model.one_step(u[:end], y[:end]))[chosen[:end]]
            off = off[np.isfinite(off)]
            squares, count = squares + float(off @ off), count + off.size
    return float(np.sqrt(squares / count)) if count else np.inf
