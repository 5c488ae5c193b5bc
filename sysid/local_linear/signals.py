"""Signals of a record as the search of local linear models takes them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data import Record
from sysid.data.record import Mask
from sysid.errors import DataError, UsageError
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.structure import Experiment

Floats = NDArray[np.float64]
STILL = 1e-9


def schedule(record: Record, chosen: str | Sequence[str] | ArrayLike) -> tuple[tuple[str, ...], Floats]:
    """Return names and values of the scheduling signals."""
    texts = [chosen] if isinstance(chosen, str) else chosen
    if isinstance(texts, list | tuple) and texts and all(isinstance(name, str) for name in texts):
        unknown = [name for name in texts if name not in record.inputs]
        if unknown:
            raise UsageError(
                f"scheduling signal {unknown[0]!r} is no input ({', '.join(record.inputs)}): choose inputs, "
                "or give a signal as an array"
            )
        columns = [record.inputs.index(str(name)) for name in texts]
        return tuple(str(name) for name in texts), record.u[:, columns]
    if isinstance(texts, list | tuple) and not texts:
        raise UsageError(
            "the model was fitted with a scheduling signal of its own: give it for this record too"
        )
    values = np.asarray(texts, dtype=float)
    values = values[:, np.newaxis] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[0] != record.n_samples:
        raise DataError(
            f"the scheduling signal has shape {values.shape}: give one row for each of {record.n_samples} "
            "samples"
        )
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if bad.size:
        raise DataError(f"the scheduling signal is not finite at row {bad[0] + 1}: fill it before the fit")
    return (), values


@dataclass(frozen=True)
class Scaled:
    """Experiments in units of their own: inputs and scheduling centred, all of size one."""

    experiments: tuple[Experiment, ...]
    y: tuple[Floats, ...]
    used: tuple[Mask, ...]
    u_mean: Floats
    u_size: Floats
    y_size: Floats
    phi_mean: Floats
    phi_size: Floats

    def visited(self) -> Floats:
        """Return the scheduling values on the rows of the fit."""
        return np.concatenate([e.scheduling[m] for e, m in zip(self.experiments, self.used, strict=True)])

    def physical(self, model: LocalLinearModel) -> LocalLinearModel:
        """Return a model of the scaled signals in the units of the record."""
        B = model.B / self.u_size
        return replace(
            model,
            B=B,
            O=model.O - B @ self.u_mean,
            C=model.C * self.y_size[:, np.newaxis],
            centres=self.phi_mean + self.phi_size * model.centres,
            widths=model.widths / self.phi_size,
        )


def scale(record: Record, phi: Floats, rows: Mask) -> Scaled:
    """Bring the signals of a fit to size one.

    Raises
    ------
    DataError
        If no row is chosen, an output is missing there, or the scheduling does not vary.
    """
    cuts, masks = [], []
    for part in record.slices:
        chosen = np.flatnonzero(rows[part])
        if chosen.size:
            begin = part.start or 0
            cuts.append(slice(begin, begin + int(chosen[-1]) + 1))
            masks.append(np.asarray(rows[cuts[-1]], dtype=bool))
    if not cuts:
        raise DataError("no row is chosen for the fit: mark rows as train, est or val")
    for cut, mask in zip(cuts, masks, strict=True):
        missing = np.flatnonzero(mask & ~np.isfinite(record.y[cut]).all(axis=1))
        if missing.size:
            raise DataError(
                f"row {cut.start + int(missing[0]) + 1}: an output is missing and cannot be fitted: leave "
                "the row out of the fit"
            )
    u = np.concatenate([record.u[cut] for cut in cuts])
    y = np.concatenate([record.y[cut][mask] for cut, mask in zip(cuts, masks, strict=True)])
    visited = np.concatenate([phi[cut] for cut in cuts])
    u_size, y_size = np.std(u, axis=0), np.sqrt(np.mean(y**2, axis=0))
    u_size[u_size == 0.0], y_size[y_size == 0.0] = 1.0, 1.0
    phi_mean, phi_size = visited.mean(axis=0), visited.std(axis=0)
    still = np.flatnonzero(phi_size <= STILL * np.maximum(np.abs(phi_mean), 1e-300))
    if still.size:
        raise DataError(
            f"scheduling signal {int(still[0]) + 1} is constant ({phi_mean[still[0]]:g}) on the rows of the "
            "fit: choose a signal that varies, or fit a linear model with sysid.fit_state_space"
        )
    # The mean of the input goes into the constants O, and comes out of them again in `physical`.
    u_mean = u.mean(axis=0)
    experiments = tuple(
        Experiment.of((record.u[cut] - u_mean) / u_size, (phi[cut] - phi_mean) / phi_size) for cut in cuts
    )
    outputs = tuple(
        np.where(mask[:, np.newaxis], record.y[cut] / y_size, 0.0)
        for cut, mask in zip(cuts, masks, strict=True)
    )
    return Scaled(experiments, outputs, tuple(masks), u_mean, u_size, y_size, phi_mean, phi_size)
