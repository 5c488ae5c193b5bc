"""The result of a Wiener-Hammerstein fit."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein.initial_state import run_from
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.linear.forms import Complexes, Floats
from sysid.linear.simulation import Prediction, check_fits, predict_experiments
from sysid.nonlinearities.spline import Spline

# Relative step of the differences by which errors are propagated: truncation and rounding are both near
# 1e-10.
STEP = 1e-5
# A leading coefficient within so many standard errors of zero may be a delay.
DELAY_ERRORS = 3.0


@dataclass(frozen=True, eq=False)
class WienerHammersteinFit:
    """A fitted Wiener-Hammerstein model y = G2 f(G1 u).

    The data do not tell how gain is shared between the three parts; the model is given with blocks of gain 1
    at zero frequency (with largest gain 1 where hardly anything passes there).

    Attributes
    ----------
    model : WienerHammerstein
        Blocks and map, normalised.
    searched : WienerHammerstein
        The same model as it was searched.
    covariance : ndarray, shape (n_parameters, n_parameters)
        Of ``searched.vector``; the two weights that were held have none.
    noise : ndarray
        D(q): the residual is white noise through 1/D.
    noise_std : float
        Standard deviation of that white noise.
    period : float
        Sampling period [s].
    inputs, outputs : tuple of str
    rms : float
        Root mean square of the simulation error on the rows of the fit.
    output_std : float
        Standard deviation of the output on these rows.
    n_rows : int
        Rows of the fit.
    intervals : int
        Intervals of the map before those with too few points were merged.
    range : (float, float)
        Range of the map's input in the fit.
    converged : bool
    restarts_agree : bool
        Whether two searches from different starts ended at the same error.
    status : str
        One sentence: how the search ended.
    """

    model: WienerHammerstein
    searched: WienerHammerstein
    covariance: Floats
    noise: Floats
    noise_std: float
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: float
    output_std: float
    n_rows: int
    intervals: int
    range: tuple[float, float]
    converged: bool
    restarts_agree: bool
    status: str

    @property
    def front(self) -> LinearBlock:
        """Block before the map."""
        return self.model.front

    @property
    def map(self) -> Spline:
        """Static map."""
        return self.model.map

    @property
    def back(self) -> LinearBlock:
        """Block behind the map."""
        return self.model.back

    @property
    def orders(self) -> tuple[int, int]:
        """Orders of the front and the back block."""
        return self.model.orders

    @property
    def order(self) -> int:
        """Number of states."""
        return sum(self.orders)

    @property
    def n_parameters(self) -> int:
        """Parameters that the data can tell: two gains are a matter of convention."""
        return int(self.searched.vector.size) - 2

    def simulate(self, u: ArrayLike) -> Floats:
        """Return the output for an input of shape (n_samples,); see `WienerHammerstein.simulate`."""
        return self.model.simulate(u)

    def predict(self, record: Record, rows: Mask | None = None) -> Prediction:
        """Predict every row of a record: one free run in each experiment.

        Parameters
        ----------
        record : Record
        rows : ndarray of bool, shape (n_samples,), optional
            Rows that may be used for initial states; estimation and validation rows by default.  An
            experiment without any has its own estimated on its first rows.

        Raises
        ------
        UsageError
            If the record has other channels or another period than that of the fit.
        """
        check_fits(check_record(record), self.inputs, self.outputs, self.period)

        def run(part: slice, used: Mask, fitted: bool) -> Floats:
            u, y = record.u[part, 0], record.y[part, 0]
            return self.simulate(u) if self.model.resting else run_from(self.model, u, y, used, self.rms)

        return predict_experiments(record, rows, self.order, self.noise, not self.model.resting, run)

    def standard_errors(self, function: Callable[[WienerHammerstein], Floats]) -> Floats:
        """Return standard errors of anything that is computed from a normalised model.

        Parameters
        ----------
        function : callable
            Gives an array of shape (n,) from a model.
        """
        vector = self.searched.vector
        columns = []
        spread = np.flatnonzero(np.diag(self.covariance) > 0.0)
        for place in spread:
            step = STEP * max(abs(vector[place]), float(np.sqrt(self.covariance[place, place])), STEP)
            values = []
            for sign in (1.0, -1.0):
                moved = vector.copy()
                moved[place] += sign * step
                values.append(function(self.searched.with_vector(moved).normalised()))
            columns.append((values[0] - values[1]) / (2.0 * step))
        jacobian = np.column_stack(columns)
        covariance = self.covariance[np.ix_(spread, spread)]
        squares = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    def map_band(self, z: ArrayLike) -> tuple[Floats, Floats]:
        """Return the map and its standard error at points, shape (n_points,)."""
        points = np.asarray(z, dtype=np.float64)
        return self.map(points), self.standard_errors(lambda model: model.map(points))

    def gains(self, frequencies: ArrayLike) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return gain and standard error of the front, then of the back block.

        Parameters
        ----------
        frequencies : array_like, shape (n_frequencies,)
            [rad/s]
        """
        angle = np.asarray(frequencies, dtype=np.float64) * self.period
        front = self.standard_errors(lambda model: np.abs(model.front.response(angle)))
        back = self.standard_errors(lambda model: np.abs(model.back.response(angle)))
        return (np.abs(self.front.response(angle)), front), (np.abs(self.back.response(angle)), back)

    @property
    def poles(self) -> tuple[Complexes, Complexes]:
        """Poles of the front and of the back block."""
        return self.front.poles, self.back.poles

    @cached_property
    def _parameters(self) -> dict[str, tuple[float, float]]:
        names, values = [], _coefficients(self.model)
        for block, order in zip(("front", "back"), self.orders, strict=True):
            names += [f"{block}_a{i}" for i in range(1, order + 1)]
            names += [f"{block}_b{i}" for i in range(order + 1)]
        errors = self.standard_errors(_coefficients)
        return {n: (float(v), float(e)) for n, v, e in zip(names, values, errors, strict=True)}

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard error of each coefficient of the blocks: front_a1, ..., back_b0, ... ."""
        return dict(self._parameters)

    @property
    def exchangeable_delay(self) -> int:
        """Samples of delay that could as well be in the other block: leading b that may be zero."""
        count = 0
        for block, order in zip(("front", "back"), self.orders, strict=True):
            for i in range(order + 1):
                value, error = self._parameters[f"{block}_b{i}"]
                if abs(value) > DELAY_ERRORS * error:
                    break
                count += 1
        return count

    def __repr__(self) -> str:
        n1, n2 = self.orders
        between = (
            ""
            if self.model.oversampling == 1
            else f", map at {self.model.oversampling} points a sampling period"
        )
        lines = [
            f"WienerHammersteinFit: orders {n1} and {n2}, {self.map.knots.size} knots{between}, "
            f"rms {self.rms:.4g} on {self.n_rows} rows"
        ]
        lines += [
            f"  {name:9s} {value: .6g} ± {error:.2g}" for name, (value, error) in self._parameters.items()
        ]
        for name, block in (("front", self.front), ("back", self.back)):
            lines.append(f"  {name:9s} poles " + (", ".join(f"{pole:.5g}" for pole in block.poles) or "none"))
        low, high = self.range
        ends, errors = self.map_band([low, 0.5 * (low + high), high])
        told = ", ".join(
            f"f({z:.4g}) = {w:.5g} ± {e:.2g}"
            for z, w, e in zip((low, 0.5 * (low + high), high), ends, errors, strict=True)
        )
        lines.append(f"  map       {told}")
        if self.exchangeable_delay:
            lines.append(
                f"  {self.exchangeable_delay} leading b may be zero: the data do not tell in which "
                "block that delay is"
            )
        return "\n".join([*lines, f"  {self.status}"])


def _coefficients(model: WienerHammerstein) -> Floats:
    return np.concatenate([part for block in (model.front, model.back) for part in (block.a[1:], block.b)])
