"""An LFT model: parameters with their covariance, predictions, the map with its band."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import DataError, ModelError, UsageError
from sysid.nonlinearities.spline import EXTRAPOLATIONS, Spline

if TYPE_CHECKING:
    from sysid.lft.signals import Data, Signals
    from sysid.lft.structure import LftStructure

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

# A free run has left for good when it is this many times further out than any measurement.
_FAR = 1e6


@dataclass(frozen=True, eq=False)
class LftModel:
    r"""A model :math:`A y = B u + G f(D x) + e`, apart from the data it was fitted to.

    Attributes
    ----------
    structure : LftStructure
    inputs : tuple of str
    output : str
    a : ndarray, shape (n_a + 1,)
        Coefficients of A, the leading 1 included.
    b : ndarray, shape (n_b,)
        Coefficients of B in the order of ``structure.b_lags``.
    g : ndarray, shape (n_g + 1,)
        Coefficients of G, the leading 1 included.
    d : ndarray, shape (n_taps,)
        Coefficients of D in the order of ``structure.z_lags``; length 1.
    map : Spline
        The map w = f(z).
    names : tuple of str
        Names of all parameters, in the order of ``covariance``.
    covariance : ndarray, shape (n_names, n_names)
        Of A, B, G, D and the map's coefficients together, for white residuals; singular along d.
    noise_std : float
        Standard deviation of the one-step residual, in the unit of the output.
    end_taps : ndarray, shape (2, n_taps)
        The lagged samples at which z is least and largest; the first and the last knot move with them.
    """

    structure: "LftStructure"
    inputs: tuple[str, ...]
    output: str
    a: Floats
    b: Floats
    g: Floats
    d: Floats
    map: Spline
    names: tuple[str, ...]
    covariance: Floats
    noise_std: float
    end_taps: Floats

    @cached_property
    def standard_errors(self) -> Floats:
        """Standard errors in the order of ``names``."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard error of each coefficient of A, B, G and D; a single tap is fixed."""
        linear = [lag for lag in self.structure.linear_lags if lag not in self.structure.left_out()]
        every = dict(zip(self.structure.linear_lags, [*self.a[1:], *self.b], strict=True))
        values = [*(every[lag] for lag in linear), *self.g[1:], *self.d]
        found = {
            n: (float(v), float(e)) for n, v, e in zip(self.names, values, self.standard_errors, strict=False)
        }
        if self.d.size == 1:
            found.popitem()
        return found

    def map_band(self, z: ArrayLike, level: float = 0.95) -> tuple[Floats, Floats]:
        """Return the limits of the map's pointwise confidence interval, each in the shape of ``z``.

        The uncertainty of d counts: it moves the knots.

        Parameters
        ----------
        z : array_like, shape (n_points,)
        level : float
            Between 0 and 1.
        """
        from scipy.special import ndtri

        if not 0.0 < level < 1.0:
            raise UsageError(f"level is {level:g}: give a number between 0 and 1")
        points = np.asarray(z, dtype=float)
        half = float(ndtri(0.5 + 0.5 * level)) * self._deviation(self._gradient(points.reshape(-1)))
        value = self.map(points)
        return value - half.reshape(points.shape), value + half.reshape(points.shape)

    def _gradient(self, points: Floats) -> Floats:
        """Return the derivatives of the map at fixed points by d and the coefficients."""
        low, high = float(self.map.knots[0]), float(self.map.knots[-1])
        place = ((points - low) / (high - low))[:, np.newaxis]
        by_d = -self.map.slope(points)[:, np.newaxis] * (
            (1.0 - place) * self.end_taps[0] + place * self.end_taps[1]
        )
        return np.column_stack([by_d, self.map.basis(points)])

    def _deviation(self, gradient: Floats) -> Floats:
        """Return the standard deviations of values whose derivatives are given."""
        part = self.covariance[-gradient.shape[1] :, -gradient.shape[1] :]
        variance = np.einsum("ij,jk,ik->i", gradient, part, gradient)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    def one_step(self, data: "Data") -> Floats:
        """Predict each output from the measurements before it.

        Parameters
        ----------
        data : Record, or pair of array_like (u, y)

        Returns
        -------
        ndarray, shape (n_samples,)
            NaN in the first rows of each experiment, whose lags were not measured.
        """
        signals = self._signals(data)
        return self._run(signals, [False] * len(signals.starts), free=False)

    def simulate(self, data: "Data", *, initial_state: str = "measured", diverged: str = "raise") -> Floats:
        """Run the model freely: it is fed its own outputs, one run an experiment.

        Parameters
        ----------
        data : Record, or pair of array_like (u, y)
        initial_state : {"measured", "rest", "available"}
            Whether the lags at the start of each experiment are measured, and returned as they
            are, or zero; with "available", zero where they were not measured.
        diverged : {"raise", "nan"}
            What becomes of a run that diverges; NaN from there on.

        Returns
        -------
        ndarray, shape (n_samples,)

        Raises
        ------
        ModelError
            If the free run diverges.
        DataError
            If an output at the start of an experiment was not measured.
        """
        if initial_state not in ("measured", "rest", "available"):
            raise UsageError(f"initial_state is {initial_state!r}: choose measured, rest or available")
        if diverged not in ("raise", "nan"):
            raise UsageError(f"diverged is {diverged!r}: choose raise or nan")
        signals = self._signals(data)
        rest = [initial_state == "rest"] * len(signals.starts)
        if initial_state == "available":
            rest = [not measured for measured in self.measured_starts(data)]
        return self.run_from(signals, rest, diverged=diverged)

    def run_from(self, signals: "Signals", rest: list[bool], *, diverged: str = "raise") -> Floats:
        """Run freely, each experiment from rest or from measured lags."""
        return self._run(signals, rest, free=True, diverged=diverged)

    def measured_starts(self, data: "Data") -> list[bool]:
        """Tell for each experiment whether the outputs were measured that a free run begins with."""
        signals = self._signals(data)
        first = self.structure.largest_lag
        return [bool(np.isfinite(signals.y[run][:first]).all()) for run in signals.runs()]

    def oriented(self, d: ArrayLike) -> Self:
        """Return the same model with the sign of d nearest to a given one: f(z) = f'(-z)."""
        given = np.asarray(d, dtype=float)
        if given.shape != self.d.shape:
            raise UsageError(f"d of shape {given.shape} was given; the model has {self.d.size} taps")
        if float(given @ self.d) >= 0.0:
            return self
        k, p = self.map.coefficients.size, self.d.size
        before = self.covariance.shape[0] - k - p
        order = np.concatenate([np.arange(before + p), before + p + np.arange(k)[::-1]])
        sign = np.ones(order.size)
        sign[before : before + p] = -1.0
        mirrored = Spline(
            -self.map.knots[::-1], self.map.coefficients[::-1], self.map.degree, self.map.extrapolation
        )
        return replace(
            self,
            d=-self.d,
            map=mirrored,
            covariance=self.covariance[np.ix_(order, order)] * np.outer(sign, sign),
            end_taps=self.end_taps[::-1],
            **self._mirrored(),
        )

    def _mirrored(self) -> dict[str, Any]:
        """Return what else changes with the sign of d."""
        return {}

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of G/A and B/A; a map that is fed the output moves them."""
        return np.asarray(np.roots(self.a), dtype=np.complex128)

    def linearised(self, z: float) -> Floats:
        """Return A of the model linearised at a point of its map, the leading 1 included.

        With slope s of the map it is A - s G D_y, D_y the taps of D that weigh the output.
        """
        slope = float(self.map.slope([z])[0])
        taps = np.zeros(self.structure.z_delay + 1)
        for (signal, delay), weight in zip(self.structure.z_lags, self.d, strict=True):
            if signal in ("y", self.output):
                taps[delay] += weight
        through = slope * np.convolve(self.g, taps)
        total = np.zeros(max(self.a.size, through.size))
        total[: self.a.size] = self.a
        total[: through.size] -= through
        return np.trim_zeros(total, "b")

    def _signals(self, data: "Data") -> "Signals":
        from sysid.lft.signals import signals_of

        signals = signals_of(data)
        if len(signals.inputs) != len(self.inputs):
            raise DataError(f"the data have {len(signals.inputs)} inputs, the model {len(self.inputs)}")
        return signals

    def _run(self, signals: "Signals", rest: list[bool], *, free: bool, diverged: str = "raise") -> Floats:
        from sysid.lft.kernels import run_experiment

        fed = signals.y.copy()
        out = np.full(signals.n_samples, np.nan)
        measured = np.abs(signals.y[np.isfinite(signals.y)])
        scale = max(float(measured.max(initial=0.0)), float(np.abs(self.map.coefficients).max()))
        b_delay = np.array([delay for _, delay in self.structure.b_lags], dtype=np.int64)
        z_delay = np.array([delay for _, delay in self.structure.z_lags], dtype=np.int64)
        b_channel, z_channel = (
            signals.channels(self.structure.b_lags),
            signals.channels(self.structure.z_lags),
        )
        for run, at_rest in zip(signals.runs(), rest, strict=True):
            part, first = fed[run], 0 if at_rest else self.structure.largest_lag
            if free and not np.isfinite(part[:first]).all():
                row = run.start + int(np.argmin(np.isfinite(part[:first])))
                raise DataError(
                    f"the free run needs the first {first} outputs of each experiment, and row {row + 1} "
                    "has none: start from rest, or give them"
                )
            if free:
                out[run.start : min(run.start + first, run.stop)] = part[:first]
            left = run_experiment(
                signals.u[run], part, free, first, self.a, self.b, b_channel, b_delay, self.g, self.d,
                z_channel, z_delay, self.map.knots, self.map.degree,
                EXTRAPOLATIONS[self.map.extrapolation], self.map.coefficients,
                _FAR * scale, out[run], np.empty(part.size),
            )  # fmt: skip
            if left >= 0 and diverged == "nan":
                out[run.start + left : run.stop] = np.nan
            elif left >= 0:
                radius = float(np.abs(self.poles).max(initial=0.0))
                raise ModelError(
                    f"the free run diverges: in row {run.start + left + 1} it is {_FAR:g} times further out "
                    f"than any measurement; the largest pole of 1/A has the modulus {radius:.4g}: take fewer "
                    "lags of the output, or constant extrapolation"
                )
        return out

    def _lines(self) -> list[str]:
        knots = self.map.knots
        return [
            *(
                f"  {name:9s} {value: .6g} ± {error:.2g}"
                for name, (value, error) in self.parameters().items()
            ),
            f"  map       degree {self.map.degree}, {knots.size} knots, {knots[0]:.4g} to {knots[-1]:.4g}",
        ]

    def __repr__(self) -> str:
        return "\n".join([f"LftModel: {self.output} from {', '.join(self.inputs)}", *self._lines()])


@dataclass(frozen=True, eq=False)
class LftFit(LftModel):
    """A fitted LFT model.

    Attributes
    ----------
    residual : ndarray, shape (n_rows,)
        What the criterion sums the squares of: the one-step residual, or that of the free run.
    times : ndarray of int, shape (n_rows,)
        Row of the data that each residual belongs to.
    z : ndarray, shape (n_points,)
        The points at which the map was used: the data it rests on.
    straight_rms : float
        Root mean square of the one-step residual with a straight line in place of the map, d and G held.
    costs : tuple of float
        Sum of squared residuals at the start and after every step of the best search.
    agreeing, searches : int
        How many of the searches ended at the best cost, and how many there were.
    converged : bool
    status : str
        One sentence: how the search ended.
    notes : tuple of str
        What the structure leaves undetermined, and what was left out.
    criterion : {"one-step", "free-run"}
        What was minimised.
    """

    residual: Floats
    times: Indices
    z: Floats
    straight_rms: float
    costs: tuple[float, ...]
    agreeing: int
    searches: int
    converged: bool
    status: str
    notes: tuple[str, ...]
    criterion: str = "one-step"

    @property
    def n_rows(self) -> int:
        """Rows of the fit."""
        return self.residual.size

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def rms(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(self.cost / self.n_rows))

    def bend(self, z: ArrayLike) -> tuple[Floats, Floats]:
        """Return what the map has beyond the straight line nearest to it over its data.

        Parameters
        ----------
        z : array_like, shape (n_points,)

        Returns
        -------
        bend, std_error : ndarray, shape (n_points,)
        """
        points = np.asarray(z, dtype=float).reshape(-1)
        line = np.linalg.pinv(np.column_stack([np.ones_like(self.z), self.z]))
        at_points = np.column_stack([np.ones_like(points), points])
        value = self.map(points) - at_points @ (line @ self.map(self.z))
        gradient = self._gradient(points) - at_points @ (line @ self._gradient(self.z))
        return value, self._deviation(gradient)

    def straight_line_test(self) -> float:
        """Return the probability of a map bent as much as this one if it is a straight line.

        An F test of the coefficients' deviation from a line, by their covariance.
        """
        from scipy.stats import f

        size = self.map.coefficients.size
        covariance = self.covariance[-size:, -size:]
        # Coefficients at the averages of the knots around them make a straight line.
        full = np.concatenate([[self.map.knots[0]] * self.map.degree, self.map.knots])
        full = np.concatenate([full, [self.map.knots[-1]] * self.map.degree])
        places = np.array([full[i + 1 : i + 1 + self.map.degree].mean() for i in range(size)])
        lines = np.column_stack([np.ones(size), places - places.mean()])
        across = np.linalg.qr(np.column_stack([lines, np.eye(size)]))[0][:, 2:size]
        if across.shape[1] == 0 or not np.isfinite(covariance).all():
            return 1.0
        off = across.T @ self.map.coefficients
        free = self.n_rows - len(self.names) + 1
        ratio = float(off @ np.linalg.pinv(across.T @ covariance @ across) @ off) / off.size
        return float(f.sf(ratio, off.size, free))

    def _mirrored(self) -> dict[str, Any]:
        return {"z": -self.z}

    def __repr__(self) -> str:
        head = (
            f"LftFit: {self.output} from {', '.join(self.inputs)}, {self.criterion} rms {self.rms:.4g} on "
            f"{self.n_rows} rows"
        )
        return "\n".join([head, *self._lines(), f"  {self.status}", *(f"  {note}" for note in self.notes)])
