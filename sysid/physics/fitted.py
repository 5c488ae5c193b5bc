"""A fitted physical model, and what it predicts."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.linear.simulation import Prediction, check_fits, predict_outputs
from sysid.physics.joint import EXACT_SHARE
from sysid.physics.model import Model
from sysid.physics.problem import Problem
from sysid.physics.uncertainty import Uncertainty


@dataclass(frozen=True)
class PhysicsFit:
    """A fitted physical model.

    Attributes
    ----------
    model : Model
        With the fitted values as its start values.
    names : tuple of str
        Parameters that were searched.
    values : mapping of str to float
        Value of every parameter, the fixed ones too.
    uncertainty : Uncertainty
        Standard errors, covariance, and the colour of the residual.
    states : ndarray, shape (n_experiments, n_states)
        Initial state of each experiment with rows in the fit.
    initial_state : {"estimate", "rest"}
    period : float
        Sampling period [s].
    inputs, outputs : tuple of str
    rms : float
        Root mean square of the free-run residual on the rows of the fit; of several outputs the root of the
        mean of the squares relative to each one's standard deviation.
    rms_of : tuple of float
        Root mean square of the free-run residual of each output.
    output_std : tuple of float
        Standard deviation of each output on these rows.
    n_rows : int
        Measured values.
    substeps : int or None
        Runge-Kutta steps in a sample; None if the simulation is exact.
    converged, restarts_agree : bool
        Restarts agree when at least two searches end at the same error with the same output; equal
        parameters are not asked for.
    status : str
        One sentence: how the search ended.
    hold : {"zero", "smooth"}
        What the input does between samples.
    nominal : mapping of str to float
        Value of every parameter at which the search began.
    """

    model: Model
    names: tuple[str, ...]
    values: Mapping[str, float]
    uncertainty: Uncertainty
    states: Floats
    initial_state: str
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: float
    rms_of: tuple[float, ...]
    output_std: tuple[float, ...]
    n_rows: int
    substeps: int | None
    converged: bool
    restarts_agree: bool
    status: str
    hold: str = "zero"
    nominal: Mapping[str, float] = field(default_factory=dict)

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard error of each parameter; a fixed one has the error 0."""
        errors = dict(zip(self.names, self.uncertainty.standard_errors.tolist(), strict=True))
        return {name: (value, errors.get(name, 0.0)) for name, value in self.values.items()}

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return self.model.parameter(name).unit

    def of_output(self, place: int) -> "PhysicsFit":
        """Return what the fit says of one of its outputs, the parameters those of all."""
        if len(self.outputs) == 1:
            return self
        known = self.uncertainty
        return replace(
            self,
            model=replace(self.model, outputs=(self.model.outputs[place],)),
            uncertainty=replace(known, noises=(known.noises[place],), noise_stds=(known.noise_stds[place],)),
            outputs=(self.outputs[place],),
            rms=self.rms_of[place],
            rms_of=(self.rms_of[place],),
            output_std=(self.output_std[place],),
        )

    def predict(self, record: Record, rows: Mask | None = None) -> Prediction:
        """Predict every row of a record.

        The initial state of an experiment is estimated on its rows of the fit; in an experiment
        without any, on its first rows: the skipped ones or, where these are too few, ten for each state.

        Parameters
        ----------
        record : Record
        rows : ndarray of bool, shape (n_samples,), optional
            Rows that may be used for initial states; estimation and validation rows by default.

        Returns
        -------
        Prediction
            With arrays of shape (n_samples, n_outputs) if there are several outputs.
        """
        check_fits(check_record(record), self.inputs, self.outputs, self.period)
        estimated = iter(self.states)

        def run(part: slice, used: Mask, fitted: bool) -> Floats:
            return _run(self, record, part, used, next(estimated, None) if fitted else None)

        free_start = self.initial_state == "estimate"
        return predict_outputs(record, rows, self.order, self.uncertainty.noises, free_start, run)

    def __repr__(self) -> str:
        size = f"rms {self.rms:.4g} on {self.n_rows} rows"
        if len(self.outputs) > 1:
            size = ", ".join(f"{n} rms {r:.4g}" for n, r in zip(self.outputs, self.rms_of, strict=True))
        lines = [f"PhysicsFit of {self.model.name!r}: {size}"]
        for name, (value, error) in self.parameters().items():
            spread = "fixed" if name not in self.names else f"± {error:.2g}"
            if (prior := self.model.parameter(name).prior) is not None:
                spread += f" (prior {prior.mean:.4g} ± {prior.std:.2g})"
            lines.append(f"  {name:8s} {value: .6g} {self.unit(name)} {spread}")
        return "\n".join([*lines, f"  {self.status}"])


def _run(fit: PhysicsFit, record: Record, part: slice, used: Mask, near: Floats | None) -> Floats:
    """Simulate one experiment, its initial state estimated on the rows ``used`` if the fit had one."""
    u, y = record.u[part], record.y[part]
    used = used & np.isfinite(y).all(axis=1)
    last = int(np.flatnonzero(used)[-1]) + 1 if used.any() else 0
    measured = np.where(used[:, np.newaxis], y, 0.0)[:last]
    segment = Segment(u[:last], measured[:, 0] if len(fit.outputs) == 1 else measured, used[:last])
    known = fit.model.with_parameters(fixed=fit.values)
    free_start = fit.initial_state == "estimate"
    problem = Problem(known, (segment,), fit.period, free_start, hold=fit.hold, weights=output_weights(fit))
    problem.use_steps(fit.substeps)
    point = problem.point(np.empty(0), None if near is None else near[np.newaxis]) if last else None
    start = problem.simulator.rest() if point is None else problem.states_of(point)[0]
    return problem.simulator.run(fit.values, u, start, before=problem.before)


def output_weights(fit: PhysicsFit) -> Floats:
    """Return by how much the error of each output counts."""
    if len(fit.outputs) == 1:
        return np.ones(1)
    return 1.0 / np.maximum(fit.rms_of, EXACT_SHARE * np.maximum(fit.output_std, 1e-300))
