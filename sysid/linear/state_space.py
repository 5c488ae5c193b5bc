"""State-space models of several inputs and outputs: what a fit gives, and its free run."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.linear.forms import Complexes, Floats
from sysid.linear.sections import Sections

if TYPE_CHECKING:
    from sysid.linear.simulation import Prediction


@dataclass(frozen=True)
class StateSpaceFit:
    """A fitted model x(k+1) = A x + B u + drift, y = C x + D u + offset.

    Attributes
    ----------
    A, B, C, D : ndarray
        Shapes (order, order), (order, n_inputs), (n_outputs, order), (n_outputs, n_inputs).  A is
        block-diagonal; other coordinates of the state give the same outputs.
    offset : ndarray, shape (n_outputs,)
    drift : ndarray, shape (order,)
        What an integrator needs; where no pole is at 1 an offset does the same.
    poles : ndarray of complex, shape (order,)
        None outside the unit circle.
    initial_state : {"estimate", "rest"}
    period : float
        Sampling period [s].
    inputs, outputs : tuple of str
    rms, output_std : ndarray, shape (n_outputs,)
        Root mean square of the free-run residual, and standard deviation, on the rows of the fit.
    n_rows : int
    noise : tuple of ndarray
        For each output D(q), leading 1: its residual is white noise through 1/D.
    noise_std : ndarray, shape (n_outputs,)
    validation : mapping of int to float
        Error on validation rows of each order that was tried, relative to the outputs' size; empty if the
        order was given.
    converged, restarts_agree : bool
    status : str
    sections : Sections
        The form in which it was fitted and is simulated.
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    offset: Floats
    drift: Floats
    poles: Complexes
    initial_state: str
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: Floats
    output_std: Floats
    n_rows: int
    noise: tuple[Floats, ...]
    noise_std: Floats
    validation: dict[int, float]
    converged: bool
    restarts_agree: bool
    status: str
    sections: Sections

    @property
    def order(self) -> int:
        """Number of states."""
        return self.sections.order

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return nothing: entries of A, B and C depend on the choice of the state."""
        return {}

    def predict(self, record: Record, rows: Mask | None = None) -> "Prediction":
        """Predict every row of a record.

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
        from sysid.linear.simulation import check_fits, predict_outputs

        check_fits(check_record(record), self.inputs, self.outputs, self.period)

        def run(part: slice, used: Mask, fitted: bool) -> Floats:
            return run_free(self, record.u[part], record.y[part], used)

        free_start = self.initial_state == "estimate"
        return predict_outputs(record, rows, self.order, self.noise, free_start, run)

    def __repr__(self) -> str:
        lines = [f"StateSpaceFit: order {self.order}, {len(self.inputs)} inputs, {self.n_rows} rows"]
        lines += [
            f"  {name}: rms {rms:.4g} of {size:.4g}"
            for name, rms, size in zip(self.outputs, self.rms, self.output_std, strict=True)
        ]
        return "\n".join([*lines, "  poles " + ", ".join(f"{p:.5g}" for p in self.poles), f"  {self.status}"])


def run_free(fit: StateSpaceFit, u: Floats, y: Floats, used: Mask) -> Floats:
    """Simulate one experiment, its initial state estimated on the rows ``used`` if the model has one.

    Before anything is measured the free response over the whole experiment is held to be no larger than the
    outputs, as in `sysid.linear.simulation.run_free`.
    """
    model = fit.sections
    rest = np.zeros(model.A.shape[:2])
    forced = model.response(u, rest)
    known = used & np.isfinite(y).all(axis=1)
    if fit.initial_state != "estimate" or not known.any():
        return forced
    free = replace(
        model, B=np.zeros_like(model.B), D=np.zeros_like(model.D), offset=np.zeros_like(model.offset)
    )
    silence = np.zeros_like(u)
    columns = []
    for i in range(model.order):
        start = np.zeros(rest.size)
        start[i] = 1.0
        columns.append(free.response(silence, start.reshape(rest.shape)))
    stacked = np.stack(columns, axis=-1)
    scale = np.maximum(np.linalg.norm(stacked.reshape(-1, model.order), axis=0), 1e-300)
    weights = 1.0 / np.maximum(fit.rms, 1e-12 * fit.output_std)
    size = np.maximum(np.std(y[known], axis=0), fit.output_std)
    ridge = np.eye(model.order) / np.sqrt(y.size * np.mean((size * weights) ** 2))
    matrix = np.vstack([(stacked[known] / scale * weights[:, np.newaxis]).reshape(-1, model.order), ridge])
    target = np.concatenate([((y[known] - forced[known]) * weights).ravel(), np.zeros(model.order)])
    found = np.linalg.lstsq(matrix, target, rcond=None)[0] / scale
    return np.asarray(forced + stacked @ found)
