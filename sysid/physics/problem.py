"""The least-squares problem of a physical model: free-run error over parameters and initial states."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sysid.errors import ModelError
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment
from sysid.physics.model import Model
from sysid.physics.simulation import Simulator, linearised_poles

# Logarithms of positive parameters stay within this of zero, short of overflow.
LARGEST_LOGARITHM = 60.0
LINEAR_PART_STEPS = 6
SMALL_STEP = 1e-9


class Problem:
    """Residual and Jacobian of the free run over the used rows of all experiments.

    A point is [search coordinates of the parameters, initial state of each experiment]; a positive
    parameter is searched by its logarithm.

    Parameters
    ----------
    model : Model
        Start values and statuses say what is searched, and from where.
    segments : tuple of Segment
    period : float
        Sampling period [s].
    free_start : bool
        Whether the initial state of each experiment is estimated; at rest otherwise.
    noise : ndarray, shape (n_searched,), optional
        Size of the noise by which priors are weighed, for each searched parameter; priors count for
        nothing without it.
    hold : {"zero", "smooth"}
        What the input does between samples, see `Simulator`.
    weights : ndarray, shape (n_outputs,), optional
        By which the error of each output counts, one over the size of its noise; all alike by default.

    Rows of the residual are those of the first experiment, output after output, then of the next.  A Gaussian
    prior of mean m and deviation s adds the row ``noise * (parameter - m) / s``: in units of the noise it is
    one more measurement.
    """

    def __init__(
        self,
        model: Model,
        segments: tuple[Segment, ...],
        period: float,
        free_start: bool,
        noise: Floats | None = None,
        hold: str = "zero",
        weights: Floats | None = None,
    ) -> None:
        self.model, self.segments, self.period = model, segments, period
        self.free_start, self.hold = free_start, hold
        self.simulator = Simulator(model, period, hold=hold)
        self.names = self.simulator.searched
        self.parameters = tuple(model.parameter(name) for name in self.names)
        self.positive = np.array([parameter.positive for parameter in self.parameters], dtype=bool)
        either_sign = [p.name for p in self.parameters if not p.positive]
        self.partial = Simulator(model, period, searched=either_sign, hold=hold)
        self.weights = np.ones(len(model.outputs)) if weights is None else weights
        self.n_rows = self.weights.size * sum(int(segment.used.sum()) for segment in segments)
        self.before = 1.0 if free_start else 0.0
        self.noise = noise
        self.priors = (
            []
            if noise is None
            else [(j, p.prior) for j, p in enumerate(self.parameters) if p.prior is not None]
        )

    @property
    def n_starts(self) -> int:
        """Unknowns that are initial states."""
        return self.model.order * len(self.segments) if self.free_start else 0

    def with_segments(self, segments: tuple[Segment, ...]) -> "Problem":
        """Return the same problem on other rows."""
        return Problem(
            self.model, segments, self.period, self.free_start, self.noise, self.hold, self.weights
        )

    def with_weights(self, weights: Floats) -> "Problem":
        """Return the same problem with other weights of the outputs."""
        problem = Problem(
            self.model, self.segments, self.period, self.free_start, self.noise, self.hold, weights
        )
        problem.use_steps(self.simulator.substeps)
        return problem

    def at_rest(self) -> "Problem":
        """Return the same problem with all experiments started at rest."""
        return Problem(self.model, self.segments, self.period, False, hold=self.hold, weights=self.weights)

    def of_output(self, place: int) -> "Problem":
        """Return the problem of one output alone."""
        if self.weights.size == 1:
            return self
        model = replace(self.model, outputs=(self.model.outputs[place],))
        segments = tuple(replace(s, y=np.ascontiguousarray(s.y[:, place])) for s in self.segments)
        return Problem(model, segments, self.period, self.free_start, self.noise, self.hold)

    def runs(self) -> list[tuple[slice, Segment, int]]:
        """Return rows of the residual, experiment and output of each unbroken part."""
        found, row = [], 0
        for segment in self.segments:
            count = int(segment.used.sum())
            for output in range(self.weights.size):
                found.append((slice(row, row + count), segment, output))
                row += count
        return found

    def with_noise(self, noise: Floats) -> "Problem":
        """Return the same problem with priors weighed by another size of the noise."""
        problem = Problem(
            self.model, self.segments, self.period, self.free_start, noise, self.hold, self.weights
        )
        problem.use_steps(self.simulator.substeps)
        return problem

    def coordinates(self, values: Mapping[str, float]) -> Floats:
        """Return the search coordinates of the parameters."""
        plain = np.array([values[name] for name in self.names])
        return np.where(self.positive, np.log(np.where(self.positive, plain, 1.0)), plain)

    def values(self, coordinates: Floats) -> dict[str, float]:
        """Return the value of every parameter."""
        plain = coordinates.copy()
        plain[self.positive] = np.exp(coordinates[self.positive])
        return self.simulator.values(dict(zip(self.names, plain.tolist(), strict=True)))

    def folded(self, coordinates: Floats) -> bool:
        """Tell whether the model rings faster than half the sampling rate, linearised where it rests.

        Between samples nothing is measured: a mode above half the sampling rate looks like one below, and
        that one is meant where the signals were filtered before they were sampled.
        """
        values, rest = self.values(coordinates[: len(self.names)]), self.simulator.rest()
        poles = linearised_poles(self.model, values, rest, np.zeros(len(self.model.inputs)))
        return bool(np.any(np.abs(poles.imag) * self.period > np.pi))

    def bounds(self) -> tuple[Floats, Floats]:
        """Return the bounds of a point."""
        lower = np.array([parameter.minimum for parameter in self.parameters])
        upper = np.array([parameter.maximum for parameter in self.parameters])
        with np.errstate(divide="ignore", invalid="ignore"):
            lower = np.where(self.positive, np.maximum(np.log(lower), -LARGEST_LOGARITHM), lower)
            upper = np.where(self.positive, np.minimum(np.log(upper), LARGEST_LOGARITHM), upper)
        unbounded = np.full(self.n_starts, np.inf)
        return np.concatenate([lower, -unbounded]), np.concatenate([upper, unbounded])

    def use_steps(self, substeps: int | None) -> None:
        """Set the Runge-Kutta steps in a sample; None has them chosen at the next run."""
        self.simulator.substeps = self.partial.substeps = substeps

    def residual(self, point: Floats) -> Floats:
        """Return the free-run error on the used rows."""
        values, starts = self._split(point)
        parts = [
            self._stacked(
                self.simulator.run(values, segment.u, start, before=self.before)[segment.used]
                - segment.y[segment.used].reshape(-1, self.weights.size)
            )
            for segment, start in zip(self.segments, starts, strict=True)
        ]
        return np.concatenate([*parts, self._prior_residual(values)])

    def _stacked(self, rows: Floats) -> Floats:
        """Return what belongs to rows and outputs output after output, each by its weight."""
        if self.weights.size == 1:
            return rows[:, 0]
        weighed = rows * self.weights.reshape(-1, *[1] * (rows.ndim - 2))
        return np.moveaxis(weighed, 1, 0).reshape(-1, *rows.shape[2:])

    def _prior_residual(self, values: Mapping[str, float]) -> Floats:
        return np.array(
            [self.prior_weight(j) * (values[self.names[j]] - prior.mean) for j, prior in self.priors]
        )

    def prior_weight(self, place: int) -> float:
        """Return noise over prior standard deviation of a searched parameter with a prior."""
        prior = self.parameters[place].prior
        assert prior is not None
        assert self.noise is not None
        return float(self.noise[place]) / prior.std

    def jacobian(self, point: Floats) -> Floats:
        """Return the derivative of the residual by the point."""
        J = self.plain_jacobian(point)
        J[:, : len(self.names)] *= self.slopes(point)
        return J

    def slopes(self, point: Floats) -> Floats:
        """Return the derivatives of the parameters by their coordinates."""
        coordinates = point[: len(self.names)]
        return np.where(self.positive, np.exp(np.where(self.positive, coordinates, 0.0)), 1.0)

    def plain_jacobian(self, point: Floats) -> Floats:
        """Return the derivative of the residual by the parameters themselves and the initial states."""
        return self._columns(self.simulator, point)

    def _columns(self, simulator: Simulator, point: Floats) -> Floats:
        """Return the derivatives by the parameters a simulator searches, and by the initial states."""
        values, starts = self._split(point)
        count, order = len(simulator.searched), self.model.order
        J = np.zeros((self.n_rows + len(self.priors), count + self.n_starts))
        row = 0
        for number, (segment, start) in enumerate(zip(self.segments, starts, strict=True)):
            _, slopes = simulator.sensitivities(values, segment.u, start, before=self.before)
            rows = slice(row, row + self.weights.size * int(segment.used.sum()))
            stacked = self._stacked(slopes[segment.used])
            J[rows, :count] = stacked[:, :count]
            if self.free_start:
                column = count + number * order
                J[rows, column : column + order] = stacked[:, count:]
            row = rows.stop
        for row, (place, _) in enumerate(self.priors, start=self.n_rows):
            if self.names[place] in simulator.searched:
                J[row, simulator.searched.index(self.names[place])] = self.prior_weight(place)
        return J

    def point(self, coordinates: Floats, near: Floats | None = None) -> Floats | None:
        """Return the point with the best initial states for these parameters; None if it diverges.

        Parameters that may have either sign mostly enter the output linearly (a gain, an offset):
        they are fitted with the initial states.

        Parameters
        ----------
        coordinates : ndarray, shape (n_searched,)
        near : ndarray, shape (n_experiments, n_states), optional
            Initial states from which to search, for a model that is not linear.
        """
        point = coordinates.copy()
        if self.free_start:
            rest = np.tile(self.simulator.rest(), (len(self.segments), 1))
            point = np.concatenate([point, (rest if near is None else near).ravel()])
        with np.errstate(all="ignore"):
            try:
                return self._with_linear_part(point)
            except ModelError:  # too stiff to be simulated
                return None

    def _with_linear_part(self, point: Floats) -> Floats | None:
        """Fit initial states and parameters of either sign by Gauss-Newton steps; one is exact if linear."""
        count = len(self.names)
        free = np.concatenate([np.flatnonzero(~self.positive), np.arange(count, point.size)])
        lower, upper = self.bounds()
        best, best_cost = None, np.inf
        for _ in range(LINEAR_PART_STEPS):
            error = self.residual(point)
            cost = float(error @ error)
            if not np.isfinite(cost) or cost > best_cost * (1.0 - SMALL_STEP):
                return point if cost < best_cost else best
            best, best_cost = point, cost
            J = self._columns(self.partial, point)
            scale = np.linalg.norm(J, axis=0)
            if not free.size or not np.isfinite(scale).all():
                break
            scale[scale == 0.0] = 1.0
            point = point.copy()
            point[free] -= np.linalg.lstsq(J / scale, error, rcond=1e-10)[0] / scale
            point = np.clip(point, lower, upper)
        return best

    def _split(self, point: Floats) -> tuple[dict[str, float], Floats]:
        count = len(self.names)
        values = self.values(point[:count])
        if self.free_start:
            return values, point[count:].reshape(len(self.segments), self.model.order)
        return values, np.tile(self.simulator.rest(), (len(self.segments), 1))

    def states_of(self, point: Floats) -> Floats:
        """Return the initial state of each experiment."""
        return self._split(point)[1]
