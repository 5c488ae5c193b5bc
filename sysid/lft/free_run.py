r"""LFT models fitted by their free run instead of their one-step prediction.

The prediction error of eq. (4.18) of Pepona (2009) is the right criterion where the noise passes
through 1/A.  Measurement noise does not: A is biased then, and a free run far off.  `refine_free_run`
goes on from a prediction-error fit and minimises the error of the free run itself, with the exact
derivatives of the recursion.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Mask
from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.lft.model import LftFit
from sysid.lft.sensitivities import run_with_sensitivities
from sysid.lft.signals import Data, Indices, Signals, signals_of
from sysid.lft.threads import one_thread
from sysid.nonlinearities.spline import EXTRAPOLATIONS, Spline
from sysid.separable import Residual, descend

Floats = NDArray[np.float64]

# Directions of the scaled Jacobian below this share of the largest count as not determined.
RANK_TOLERANCE = 1e-9


def refine_free_run(
    data: Data,
    start: LftFit,
    *,
    rows: Mask | None = None,
    initial_state: str = "measured",
    tolerance: float = 1e-8,
    max_evaluations: int = 200,
) -> LftFit:
    """Refine an LFT model by its free-run error.

    Parameters
    ----------
    data : Record, or pair of array_like (u, y)
    start : LftFit
        Where the search begins; its knots are kept.
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    initial_state : {"measured", "rest", "available"}
        See `LftModel.simulate`.
    tolerance, max_evaluations : float, int
        See `sysid.separable.descend`.

    Returns
    -------
    LftFit
        With ``criterion`` "free-run": residual, rms and costs are those of the free run, and the
        covariance holds for a residual with the colour of this one.

    Raises
    ------
    IdentifiabilityError
        If the rows are too few.
    ModelError
        If the free run of the start diverges.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.lft import LftStructure, fit_lft, lags
    >>> rng = np.random.default_rng(0)
    >>> u, x = rng.uniform(-2, 2, 1500), np.zeros(1500)
    >>> for k in range(1, 1500):
    ...     x[k] = 0.8 * x[k - 1] + np.tanh(u[k - 1])
    >>> y = x + 0.5 * rng.standard_normal(1500)  # noise of the sensor
    >>> predicted = fit_lft((u, y), LftStructure(n_a=1, z_lags=lags("u", 1), knots=6))
    >>> simulated = refine_free_run((u, y), predicted)
    >>> float(predicted.a[1].round(1)), float(simulated.a[1].round(1))
    (-0.7, -0.8)
    """
    if initial_state not in ("measured", "rest", "available"):
        raise UsageError(f"initial_state is {initial_state!r}: choose measured, rest or available")
    problem = _Problem.of(data, start, rows, initial_state)
    if not np.isfinite(problem.at(problem.start).cost):
        raise ModelError(
            "the free run that was to be refined diverges: start from a model with fewer lags of the "
            "output, or with constant extrapolation"
        )
    with one_thread():
        found = descend(problem.at, problem.start, tolerance=tolerance, max_evaluations=max_evaluations)
        model = problem.model(found.x)
        covariance, noise_std = problem.covariance(found.x, found.point.residual)
    z = problem.z(model)
    return replace(
        model,
        covariance=covariance,
        noise_std=noise_std,
        residual=found.point.residual,
        times=problem.rows,
        z=z,
        end_taps=np.zeros((2, model.d.size)),  # the knots are held
        straight_rms=float("nan"),
        costs=found.costs,
        converged=found.status.converged,
        status=found.status.value,
        criterion="free-run",
    )


@dataclass(frozen=True, eq=False)
class _Problem:
    """Free-run residual as a function of (linear lags, g, tangent coordinates of d, map's coefficients).

    ``times`` are rows of the signals, which end where no row of the fit follows, ``rows`` those of the data.
    """

    signals: Signals
    begin: LftFit
    times: Indices
    rest: tuple[bool, ...]
    rows: Indices

    @classmethod
    def of(cls, data: Data, begin: LftFit, rows: Mask | None, initial_state: str) -> "_Problem":
        signals = signals_of(data)
        measured = begin.measured_starts(data)
        if initial_state == "measured" and not all(measured):
            raise DataError("an experiment begins with outputs that were not measured: start it from rest")
        rest = [initial_state == "rest" or not known for known in measured]
        chosen = signals.learning if rows is None else np.asarray(rows)
        first = np.concatenate(
            [
                np.full(run.stop - run.start, 0 if still else begin.structure.largest_lag)
                for run, still in zip(signals.runs(), rest, strict=True)
            ]
        )
        times = np.flatnonzero(chosen & (signals.age() >= first) & np.isfinite(signals.y))
        signals, rest, local = _trimmed(signals, rest, times)
        problem = cls(signals, begin, local, tuple(rest), times.astype(np.int64))
        if times.size <= problem.start.size:
            raise IdentifiabilityError(
                f"{times.size} rows cannot determine {problem.start.size} parameters: give more data"
            )
        return problem

    @cached_property
    def kept(self) -> Indices:
        """Places of the lags of A and B that were not left out, among all."""
        structure = self.begin.structure
        gone = structure.left_out()
        return np.array([i for i, lag in enumerate(structure.linear_lags) if lag not in gone], dtype=np.int64)

    @cached_property
    def tangents(self) -> Floats:
        """Orthonormal directions across d."""
        d = self.begin.d
        return np.linalg.qr(np.column_stack([d, np.eye(d.size)]))[0][:, 1 : d.size]

    @cached_property
    def start(self) -> Floats:
        """The point of the model to be refined."""
        begin = self.begin
        linear = np.concatenate([begin.a[1:], begin.b])[self.kept]
        return np.concatenate([linear, begin.g[1:], np.zeros(begin.d.size - 1), begin.map.coefficients])

    def model(self, x: Floats) -> LftFit:
        """Return the model at a point."""
        begin, structure = self.begin, self.begin.structure
        n_d = begin.d.size
        linear, g, t, c = np.split(x, np.cumsum([self.kept.size, structure.n_g, n_d - 1]))
        every = np.zeros(structure.n_a + len(structure.b_lags))
        every[self.kept] = linear
        d = begin.d + self.tangents @ t
        curve = Spline(begin.map.knots, c, begin.map.degree, begin.map.extrapolation)
        return replace(
            begin,
            a=np.concatenate([[1.0], every[: structure.n_a]]),
            b=every[structure.n_a :],
            g=np.concatenate([[1.0], g]),
            d=d / np.linalg.norm(d),
            map=curve,
        )

    def at(self, x: Floats) -> Residual:
        """Return the residual at a point; infinite where the run diverges."""
        run = self.model(x).run_from(self.signals, list(self.rest), diverged="nan")
        residual = (self.signals.y - run)[self.times]
        if not np.isfinite(residual).all():
            residual = np.full(self.times.size, np.inf)
        return Residual(residual, lambda: -self.derivative(x)[self.times])

    def derivative(self, x: Floats) -> Floats:
        """Return the derivative of the free run by the point, shape (n_samples, n_point)."""
        model, structure = self.model(x), self.begin.structure
        n_linear = structure.n_a + len(structure.b_lags)
        n_d = model.d.size
        by = np.zeros((self.signals.n_samples, n_linear + structure.n_g + n_d + model.map.coefficients.size))
        fed = self.signals.y.copy()
        b_delay = np.array([delay for _, delay in structure.b_lags], dtype=np.int64)
        z_delay = np.array([delay for _, delay in structure.z_lags], dtype=np.int64)
        b_channel = self.signals.channels(structure.b_lags)
        z_channel = self.signals.channels(structure.z_lags)
        for run, still in zip(self.signals.runs(), self.rest, strict=True):
            run_with_sensitivities(
                self.signals.u[run], fed[run], 0 if still else structure.largest_lag, model.a, model.b,
                b_channel, b_delay, model.g, model.d, z_channel, z_delay, model.map.knots,
                model.map.degree, EXTRAPOLATIONS[model.map.extrapolation], model.map.coefficients, by[run],
            )  # fmt: skip
        first = n_linear + structure.n_g
        return np.column_stack(
            [
                by[:, self.kept],
                by[:, n_linear:first],
                by[:, first : first + n_d] @ self._by_tangents(x),
                by[:, first + n_d :],
            ]
        )

    def _by_tangents(self, x: Floats) -> Floats:
        """Return the derivative of d by its tangent coordinates."""
        first = self.kept.size + self.begin.structure.n_g
        v = self.begin.d + self.tangents @ x[first : first + self.begin.d.size - 1]
        length = float(np.linalg.norm(v))
        return (self.tangents - np.outer(v, v @ self.tangents) / length**2) / length

    def z(self, model: LftFit) -> Floats:
        """Return the inputs of the map in the free run, on the rows of the fit."""
        fed = model.run_from(self.signals, list(self.rest))
        signals = replace(self.signals, y=fed)
        times = self.times[self.times >= model.structure.z_delay]
        return signals.lagged(model.structure.z_lags, times) @ model.d

    def covariance(self, x: Floats, residual: Floats) -> tuple[Floats, float]:
        r"""Return the covariance :math:`(J'J)^{-1} J'VJ (J'J)^{-1}`, and the residual's deviation.

        V is the covariance of an autoregressive model of the residual: :math:`J'VJ = \sigma^2 |F'J|^2`
        with F' running 1/D backwards in time.
        """
        from sysid.linear.uncertainty import autoregression, backwards

        experiment = np.searchsorted(np.asarray(self.signals.starts), self.times, side="right")
        cuts = np.flatnonzero((np.diff(self.times) != 1) | (np.diff(experiment) != 0)) + 1
        noise, noise_std = autoregression(np.split(residual, cuts))
        jacobian = self.derivative(x)[self.times]
        scale = np.linalg.norm(jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        left, sizes, right = np.linalg.svd(jacobian / scale, full_matrices=False)
        known = sizes > RANK_TOLERANCE * sizes[0]
        turned = np.hstack([backwards(part.T, noise) for part in np.split(left[:, known], cuts)])
        spread = noise_std * np.sqrt(residual.size / max(residual.size - x.size, 1))
        root = (right[known].T / sizes[known]) @ turned * spread / scale[:, np.newaxis]
        blind = np.einsum("ij,ij->j", right[~known], right[~known]) > RANK_TOLERANCE
        turn = self._turn(x)
        covariance = turn @ (root @ root.T) @ turn.T
        lost = np.any(turn[:, blind] != 0.0, axis=1)
        covariance[lost, :] = np.nan
        covariance[:, lost] = np.nan
        return covariance, float(np.sqrt(residual @ residual / max(residual.size - x.size, 1)))

    def _turn(self, x: Floats) -> Floats:
        """Return the derivative of (A and B, g, d, map) by the point."""
        n_d, first = self.begin.d.size, self.kept.size + self.begin.structure.n_g
        turn = np.zeros((x.size + 1, x.size))
        turn[:first, :first] = np.eye(first)
        turn[first : first + n_d, first : first + n_d - 1] = self._by_tangents(x)
        turn[first + n_d :, first + n_d - 1 :] = np.eye(x.size - first - n_d + 1)
        return turn


def _trimmed(
    signals: Signals, rest: list[bool], times: NDArray[np.intp]
) -> tuple[Signals, list[bool], Indices]:
    """Leave out experiments without rows of the fit, and what follows the last row in the others."""
    kept, still, local, starts = [], [], [], []
    n = 0
    for run, at_rest in zip(signals.runs(), rest, strict=True):
        own = times[(times >= run.start) & (times < run.stop)]
        if own.size:
            starts.append(n)
            kept.append(np.arange(run.start, own[-1] + 1))
            still.append(at_rest)
            local.append(own - run.start + n)
            n += kept[-1].size
    if not kept:
        raise IdentifiabilityError("no row is left for the fit: give rows with measured outputs and lags")
    rows = np.concatenate(kept)
    parts = replace(
        signals, u=signals.u[rows], y=signals.y[rows], starts=tuple(starts), learning=signals.learning[rows]
    )
    return parts, still, np.concatenate(local).astype(np.int64)
