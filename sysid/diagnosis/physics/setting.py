"""What all problems of one record and physical model share: plant, known values, typical sizes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats, Grid
from sysid.physics.forced import NO_LAW, ForcedPlant
from sysid.physics.general import GeneralPlant
from sysid.physics.model import Model, Parameter

Plant = ForcedPlant | GeneralPlant
LARGEST_LOGARITHM = 60.0


@dataclass(frozen=True)
class Setting:
    """What all problems of one record and model share.

    Attributes
    ----------
    record : Record
    model : Model
    plant : ForcedPlant or GeneralPlant
    searched : tuple of Parameter
        The model's parameters that are not known.
    known : ndarray, shape (n_model_parameters,)
        Start or fixed value of each parameter of the model.
    free_start : bool
        Whether the initial state of each experiment is estimated.
    sizes : mapping of str to float
        Typical sizes of input ``u``, output ``y``, force ``F``, position ``x``, speed ``v``, time ``s``.
    state_sizes : ndarray, shape (n_states,)
    """

    record: Record
    model: Model
    plant: Plant
    searched: tuple[Parameter, ...]
    known: Floats
    free_start: bool
    sizes: dict[str, float]
    state_sizes: Floats

    @cached_property
    def places(self) -> list[int]:
        """Positions of the searched parameters among the model's."""
        return [self.plant.names.index(parameter.name) for parameter in self.searched]

    @cached_property
    def _tried(self) -> dict[tuple[Grid, bytes], Floats]:
        return {}

    def tried(self, grid: Grid, rows: Mask) -> Floats:
        """Return the values at which a shape is tried first by what some rows hold, found once."""
        key = grid, rows.tobytes()
        if key not in self._tried:
            record = self.record
            self._tried[key] = grid.values(record.u[rows, 0], record.y[rows, 0], record.period)
        return self._tried[key]

    @cached_property
    def positive(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which searched parameters are searched by their logarithm."""
        return np.array([parameter.positive for parameter in self.searched], dtype=bool)

    @property
    def units(self) -> dict[str, str]:
        """Units of input, output, force, position and speed."""
        model, port = self.model, self.plant.port
        units = {"u": model.inputs[0].unit, "y": model.outputs[0].unit}
        if port.velocity is not None and port.position is not None:
            units |= {
                "F": model.equations[port.velocity].unit,
                "x": model.states[port.position].unit,
                "v": model.states[port.velocity].unit,
            }
        elif port.levels:
            units["x"] = model.states[port.levels[0]].unit
        return units

    @property
    def rest(self) -> Floats:
        """State of the model at rest."""
        return np.array([state.rest for state in self.model.states])

    @property
    def nominal(self) -> Floats:
        """Search coordinates of the start values."""
        return self.to_coordinates(self.known[self.places])

    def values_of(self, point: Floats) -> Floats:
        """Return all parameters of the model at a point, which begins with the searched ones."""
        values = self.known.copy()
        values[self.places] = self.to_values(point[: len(self.searched)])
        return values

    def to_coordinates(self, values: Floats) -> Floats:
        """Return logarithms of positive parameters."""
        return np.where(self.positive, np.log(np.where(self.positive, values, 1.0)), values)

    def to_values(self, coordinates: Floats) -> Floats:
        """Return parameters from their coordinates; any leading shape."""
        bounded = np.clip(coordinates, -LARGEST_LOGARITHM, LARGEST_LOGARITHM)
        return np.where(self.positive, np.exp(np.where(self.positive, bounded, 0.0)), coordinates)


def setting_of(record: Record, model: Model, plant: Plant, free_start: bool) -> Setting:
    """Return the setting of a record and a model, sizes from a run at the start values."""
    known = np.array([parameter.start for parameter in model.parameters])
    searched = tuple(parameter for parameter in model.parameters if parameter.status != "fixed")
    rows = record.learning
    y, u = record.y[rows, 0], record.u[rows, 0]
    part = record.slices[int(np.argmax([rows[part].sum() for part in record.slices]))]
    driven = record.u[part]
    states = np.empty((1, driven.shape[0], plant.order))
    with np.errstate(all="ignore"):
        run = plant.run(known[np.newaxis], NO_LAW[np.newaxis], driven, states=states)[0]
        pushed = plant.respond(known, driven[:, 0] - driven[:, 0].mean())
        factor = _size(y) / _size(run)
        state_sizes = np.array([_size(states[0, :, i]) for i in range(plant.order)]) * factor
        force = _size(u) * _size(y) / _size(pushed)
    port = plant.port
    sizes = {"u": _size(u), "y": _size(y), "F": force, "s": record.period * rows.sum(), "rad": 1.0}
    sizes["x"] = state_sizes[port.position] if port.position is not None else sizes["y"]
    sizes["v"] = state_sizes[port.velocity] if port.velocity is not None else sizes["y"]
    return Setting(record, model, plant, searched, known, free_start, sizes, state_sizes)


def _size(signal: Floats) -> float:
    """Return the standard deviation, or 1 where that says nothing."""
    size = float(np.std(signal))
    return size if np.isfinite(size) and size > 0.0 else 1.0
