"""The least-squares problem of a linear plant with one map in its loop."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.ports.kernels import differentiate_loop, run_loop
from sysid.diagnosis.ports.plants import Matrices, Plant, Port
from sysid.linear.forms import Floats
from sysid.separable.descent import Minimum, Residual, descend

DEGREE = 3
# A search is over when no step could lower the cost by more than this share.
NEGLIGIBLE = 1e-5
# A run is given up when it exceeds the largest measured value so many times.
DIVERGENCE = 1e3
OPENING_EVALUATIONS = 40
# Combinations of the plant's parameters count as dependent below this relative effect.
DEPENDENT = 1e-6
# Below this one a combination has no effect but rounding, of which no step may be made.
ROUNDING = 1e-11


@dataclass(frozen=True)
class Stretch:
    """Consecutive rows of one experiment.

    Attributes
    ----------
    first : int
        Its first row in the record.
    u, y : ndarray, shapes (n_rows, n_inputs) and (n_rows,)
        Missing outputs are interpolated and never used.
    v : ndarray, shape (n_rows, n_channels)
        What drives the plant.
    fitted, judged, opening : ndarray of bool, shape (n_rows,)
        Rows of the fit, rows on which the fit is judged, and rows that may give the initial state
        where none is fitted.
    free : bool
        Whether the initial state is unknown.
    """

    first: int
    u: Floats
    y: Floats
    v: Floats
    fitted: Mask
    judged: Mask
    opening: Mask
    free: bool


@dataclass(frozen=True, eq=False)
class Loop:
    """The least-squares problem of a plant with a map, its coefficients in chosen directions.

    A point holds the plant's parameters, the weights of the directions, and the initial state of
    each stretch with fitted rows that has a free one.

    Attributes
    ----------
    plant : Plant
    port : Port
    stretches : tuple of Stretch
    knots : ndarray
    directions : ndarray, shape (n_coefficients, n_weights)
    prior : ndarray, shape (n_rows, n_weights)
        Rows that hold weights to which the data say nothing.
    fed : tuple of ndarray
        The known signal that feeds the map in each stretch; empty where the loop does.
    """

    plant: Plant
    port: Port
    stretches: tuple[Stretch, ...]
    knots: Floats
    directions: Floats
    prior: Floats
    fed: tuple[Floats, ...]
    kept: dict[bytes, Matrices | None] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def limit(self) -> float:
        """Value beyond which a run counts as diverged."""
        return DIVERGENCE * max(float(np.abs(s.y).max(initial=0.0)) for s in self.stretches) + 1e-300

    @property
    def n_plant(self) -> int:
        """Number of the plant's parameters."""
        return self.plant.start.size

    @property
    def n_weights(self) -> int:
        """Number of directions."""
        return int(self.directions.shape[1])

    def coefficients(self, point: Floats) -> Floats:
        """Return the coefficients of the map."""
        return np.asarray(self.directions @ point[self.n_plant : self.n_plant + self.n_weights])

    def starts(self, point: Floats) -> list[Floats]:
        """Return the initial state of each stretch; zero where none is fitted."""
        place, found = self.n_plant + self.n_weights, []
        for stretch in self.stretches:
            if stretch.free and stretch.fitted.any():
                found.append(point[place : place + self.plant.order])
                place += self.plant.order
            else:
                found.append(np.zeros(self.plant.order))
        return found

    def run(self, point: Floats, starts: Sequence[Floats] | None = None) -> list[tuple[Floats, Floats]]:
        """Return the output and the map's input in each stretch; not finite where the run diverges.

        Stretches without fitted rows are run only with initial states of their own.
        """
        matrices = self._matrices(point)
        coefficients = self.coefficients(point)
        found = []
        for number, start in enumerate(self.starts(point) if starts is None else starts):
            stretch, v = self.stretches[number], self.stretches[number].v
            y, z = np.full(v.shape[0], np.nan), np.full(v.shape[0], np.nan)
            if matrices is not None and (starts is not None or stretch.fitted.any()):
                run_loop(
                    *matrices.values, v, self._known(number), *self._feed, self.limit, self.knots, DEGREE,
                    coefficients, start, y, z,
                )  # fmt: skip
            found.append((y, z))
        return found

    def derivative(self, point: Floats, number: int, start: Floats) -> Floats:
        """Return d(output)/d(plant, coefficients, initial state) in one stretch."""
        matrices = self._matrices(point)
        assert matrices is not None
        v = self.stretches[number].v
        J = np.empty((v.shape[0], self.n_plant + self.directions.shape[0] + self.plant.order))
        differentiate_loop(
            *matrices.values, *matrices.slopes, v, self._known(number), *self._feed, self.knots, DEGREE,
            self.coefficients(point), start, J,
        )  # fmt: skip
        return J

    def runs(self, point: Floats) -> bool:
        """Tell whether neither the run nor its slopes diverge from a point, nor the squares of these."""
        with np.errstate(over="ignore", invalid="ignore"):
            if not np.isfinite(self.residual(point)).all():
                return False
            J = self.jacobian(point)
            return bool(np.isfinite(np.einsum("ij,ij->j", J, J)).all())

    def residual(self, point: Floats) -> Floats:
        """Return the free-run error on the fitted rows, and what the prior adds."""
        with np.errstate(all="ignore"):
            parts = [
                y[s.fitted] - s.y[s.fitted] for s, (y, _) in zip(self.stretches, self.run(point), strict=True)
            ]
        weights = point[self.n_plant : self.n_plant + self.n_weights]
        return np.concatenate([*parts, self.prior @ weights])

    def jacobian(self, point: Floats) -> Floats:
        """Return the derivative of the residual by the point."""
        parts = self.jacobian_parts(point)
        blocks = [part[s.fitted] for s, part in zip(self.stretches, parts, strict=True)]
        prior = np.zeros((self.prior.shape[0], point.size))
        prior[:, self.n_plant : self.n_plant + self.n_weights] = self.prior
        return np.vstack([*blocks, prior])

    def jacobian_parts(self, point: Floats) -> list[Floats]:
        """Return d(output)/d(point) over all rows of each stretch; empty where none is fitted."""
        n, n_map = self.plant.order, self.directions.shape[0]
        shared = self.n_plant + self.n_weights
        place, parts = shared, []
        for number, (stretch, start) in enumerate(zip(self.stretches, self.starts(point), strict=True)):
            if not stretch.fitted.any():
                parts.append(np.zeros((stretch.y.size, point.size)))
                continue
            J = self.derivative(point, number, start)
            full = np.zeros((stretch.y.size, point.size))
            full[:, : self.n_plant] = J[:, : self.n_plant]
            full[:, self.n_plant : shared] = J[:, self.n_plant : self.n_plant + n_map] @ self.directions
            if stretch.free:
                full[:, place : place + n] = J[:, self.n_plant + n_map :]
                place += n
            parts.append(full)
        return parts

    def descend(self, start: Floats, evaluations: int) -> Minimum[Residual] | None:
        """Search from a point; None if the run or its slopes diverge there, or at the end.

        Near an integrator the parameters of a black box and initial states are all but dependent, and
        damping would hold back just the combinations that matter: orthogonal ones are searched, and
        one without any effect, as that of a constant with the state of an integrator, is left out.
        """
        if not self.runs(start):
            return None
        shape = self._orthogonal_combinations(start) if self.plant.black_box else np.eye(start.size)
        minimum = descend(
            lambda x: Residual(
                self.residual(start + shape @ x), lambda: self.jacobian(start + shape @ x) @ shape
            ),
            np.zeros(shape.shape[1]),
            negligible=NEGLIGIBLE,
            max_evaluations=evaluations,
        )
        end = start + shape @ minimum.x
        return replace(minimum, x=end) if self.runs(end) else None

    def with_best_starts(self, point: Floats) -> Floats:
        """Return the point with the initial states that fit best while the plant stands alone."""
        if self.n_plant + self.n_weights == point.size:
            return point
        better, place, n = point.copy(), self.n_plant + self.n_weights, self.plant.order
        parts = zip(self.residual_parts(point), self.jacobian_parts(point), strict=True)
        for stretch, (r, J) in zip(self.stretches, parts, strict=True):
            if not (stretch.free and stretch.fitted.any()):
                continue
            own = J[stretch.fitted, place : place + n]  # of no other stretch
            scale = np.linalg.norm(own, axis=0)
            scale[scale == 0.0] = 1.0
            better[place : place + n] -= np.linalg.lstsq(own / scale, r, rcond=DEPENDENT)[0] / scale
            place += n
        return better

    def _orthogonal_combinations(self, point: Floats) -> Floats:
        """Return the combinations, one a column, in which the plant's effect has orthogonal parts."""
        own = np.ones(point.size, dtype=bool)
        own[self.n_plant : self.n_plant + self.n_weights] = False
        J = self.jacobian(point)[:, own]
        scale = np.linalg.norm(J, axis=0)
        scale[scale == 0.0] = 1.0
        _, values, right = np.linalg.svd(np.linalg.qr(J / scale, mode="r"))
        shape = np.eye(point.size)
        size = np.maximum(values, DEPENDENT * values[0])
        shape[np.ix_(own, own)] = right.T / size / scale[:, np.newaxis]
        kept = np.ones(point.size, dtype=bool)
        kept[own] = values > ROUNDING * values[0]
        return shape[:, kept]

    def error(self, point: Floats) -> float:
        """Return the sum of squared errors on the fitted rows, the prior left out."""
        return float(sum(np.sum(part**2) for part in self.residual_parts(point)))

    def residual_parts(self, point: Floats) -> list[Floats]:
        """Return the free-run error on the fitted rows of each stretch."""
        return [
            y[s.fitted] - s.y[s.fitted] for s, (y, _) in zip(self.stretches, self.run(point), strict=True)
        ]

    def map_inputs(self, point: Floats) -> Floats:
        """Return what the map is fed with on the fitted rows."""
        runs = self.run(point)
        return np.concatenate([z[s.fitted] for s, (_, z) in zip(self.stretches, runs, strict=True)])

    def _matrices(self, point: Floats) -> Matrices | None:
        """Return the plant's matrices; those of the last point are kept."""
        key = point[: self.n_plant].tobytes()
        if key not in self.kept:
            self.kept.clear()
            self.kept[key] = self.plant.matrices(point[: self.n_plant], self.port)
        return self.kept[key]

    @property
    def _feed(self) -> tuple[int, int, float, float]:
        """What the map is fed with, and how what it gives comes back: mode, lag, sign, sampling rate."""
        return self.port.mode, self.plant.lag, self.port.sign, 1.0 / self.plant.period

    def _known(self, number: int) -> Floats:
        return self.fed[number] if self.fed else np.zeros(1)


def opening_state(loop: Loop, point: Floats, number: int, near: Floats) -> Floats:
    """Estimate the initial state of a stretch without fitted rows from its first rows."""
    stretch = loop.stretches[number]
    rows = stretch.opening
    columns = loop.n_plant + loop.directions.shape[0]
    single = replace(loop, stretches=(stretch,), fed=(loop.fed[number],) if loop.fed else ())

    def residual(state: Floats) -> Floats:
        y = single.run(point, [state])[0][0]
        return np.asarray(y[rows] - stretch.y[rows])

    def evaluate(state: Floats) -> Residual:
        return Residual(residual(state), lambda: single.derivative(point, 0, state)[rows, columns:])

    if not np.isfinite(residual(near)).all():
        return near
    return descend(evaluate, near, negligible=NEGLIGIBLE, max_evaluations=OPENING_EVALUATIONS).x
