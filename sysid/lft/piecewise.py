"""Linear dynamics around a piecewise affine map: the model (5.5)-(5.7) and its regression form."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid._compile import compiled
from sysid.errors import DataError, ModelError
from sysid.lft.structure import Lag
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class PiecewiseStructure:
    r"""Orders and lags of :math:`A(q) y = B(q) u + G(q) f(z) + \varepsilon`.

    :math:`A = 1 + a_1 q^{-1} + \dots`, :math:`G = 1 + g_1 q^{-1} + \dots`; f is piecewise affine.

    Parameters
    ----------
    n_a : int
        Order of A.
    b_lags : sequence of int
        Delays of u in B [samples].
    n_g : int
        Order of G.
    z_lags : sequence of (str, int)
        Arguments of the map: ``("y", d)`` with d >= 1, or ``("u", d)`` with d >= 0.

    Raises
    ------
    ModelError
        If an order or lag makes no sense.

    Examples
    --------
    >>> PiecewiseStructure(1, (1,), 1, (("y", 2), ("u", 2))).names(2)
    ('a1', 'b1', 'g1', 'theta1_1', 'theta1_2', 'theta1_3', 'theta2_1', 'theta2_2', 'theta2_3')
    """

    n_a: int
    b_lags: tuple[int, ...]
    n_g: int
    z_lags: tuple[Lag, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "b_lags", tuple(self.b_lags))
        object.__setattr__(self, "z_lags", tuple((signal, delay) for signal, delay in self.z_lags))
        for name, order in (("n_a", self.n_a), ("n_g", self.n_g)):
            if order < 0:
                raise ModelError(f"{name} is {order}: give an order from 0")
        if not self.z_lags:
            raise ModelError("the map has no argument: give at least one lag of u or y in z_lags")
        for lags, what in ((self.b_lags, "b_lags"), (self.z_lags, "z_lags")):
            if len(set(lags)) < len(lags):
                raise ModelError(f"{what} names a lag twice, {lags}: give each once")
        if any(delay < 0 for delay in self.b_lags):
            raise ModelError(f"b_lags holds a negative delay, {self.b_lags}: give delays from 0")
        for signal, delay in self.z_lags:
            if signal not in ("u", "y") or delay < (signal == "y"):
                raise ModelError(
                    f"the map's argument {(signal, delay)} is not known at time k: "
                    'give ("y", d) with d >= 1 or ("u", d) with d >= 0'
                )

    @property
    def first(self) -> int:
        """First sample whose prediction rests on samples alone, the n-bar of (5.20)."""
        furthest = max(delay for _, delay in self.z_lags)
        return max(self.n_a, max(self.b_lags, default=0), self.n_g + furthest)

    @property
    def n_known(self) -> int:
        """Number of regressors that are measured: those of a and b."""
        return self.n_a + len(self.b_lags)

    @property
    def n_linear(self) -> int:
        r"""Number of parameters of the linear part, that of :math:`\eta_L` in (5.9)."""
        return self.n_known + self.n_g

    def linear_names(self) -> tuple[str, ...]:
        """Return the names of the parameters of the linear part, ``b`` numbered by delay."""
        return (
            *(f"a{i}" for i in range(1, self.n_a + 1)),
            *(f"b{delay}" for delay in self.b_lags),
            *(f"g{i}" for i in range(1, self.n_g + 1)),
        )

    def names(self, n_modes: int) -> tuple[str, ...]:
        """Return the names of all parameters but the boundaries."""
        width = len(self.z_lags) + 1
        theta = (f"theta{i}_{j}" for i in range(1, n_modes + 1) for j in range(1, width + 1))
        return (*self.linear_names(), *theta)


@dataclass(frozen=True)
class Rows:
    """The regression form (5.8) of records.

    Attributes
    ----------
    y : ndarray, shape (n_rows,)
        Outputs that are predicted.
    known : ndarray, shape (n_rows, n_a + n_b)
        The measured regressors of (5.10b): -y(k-1), ..., u(k-d), ...
    phi : ndarray, shape (n_w, n_z + 1)
        Arguments of the map with a one behind; each experiment has n_g rows more than predictions.
    now : ndarray of int, shape (n_rows,)
        Row of `phi` at the time of each prediction; l samples earlier is ``now - l``.
    lengths : tuple of int
        Predictions of each experiment.
    """

    y: Floats
    known: Floats
    phi: Floats
    now: Integers
    lengths: tuple[int, ...]

    @property
    def z(self) -> Floats:
        """Arguments of the map, shape (n_w, n_z)."""
        return self.phi[:, :-1]

    @cached_property
    def at(self) -> Integers:
        """Prediction made at the time of each row of `phi`, -1 where there is none."""
        found = np.full(self.phi.shape[0], -1)
        found[self.now] = np.arange(self.now.size)
        return found

    def delayed(self, w: Floats, lag: int) -> Floats:
        """Return w(k - lag) at the time of each prediction, rows of `w` as of `phi`."""
        return w[self.now - lag]


def rows_of(structure: PiecewiseStructure, u: ArrayLike | Sequence[Floats], y: ArrayLike) -> Rows:
    """Return the regression form of one record, or of several given as lists of arrays.

    Parameters
    ----------
    structure : PiecewiseStructure
    u, y : array_like, shape (n_samples,), or lists of such
        Input and output.

    Raises
    ------
    DataError
        If lengths differ, a value is not finite or a record is too short.

    Examples
    --------
    >>> rows = rows_of(PiecewiseStructure(1, (), 1, (("u", 0),)), [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    >>> rows.known.ravel().tolist(), rows.z.ravel().tolist(), rows.now.tolist()
    ([-4.0, -5.0], [1.0, 2.0, 3.0], [1, 2])
    """
    several = isinstance(u, list | tuple) and len(u) > 0 and np.ndim(u[0]) == 1
    pairs = list(zip(u, y, strict=True)) if several else [(u, y)]  # type: ignore[arg-type]
    parts = [_rows_of_one(structure, *_checked(structure, one_u, one_y)) for one_u, one_y in pairs]
    offsets = np.cumsum([0, *(part.phi.shape[0] for part in parts[:-1])])
    return Rows(
        np.concatenate([part.y for part in parts]),
        np.vstack([part.known for part in parts]),
        np.vstack([part.phi for part in parts]),
        np.concatenate([part.now + start for part, start in zip(parts, offsets, strict=True)]),
        tuple(part.y.size for part in parts),
    )


def _checked(structure: PiecewiseStructure, u: ArrayLike, y: ArrayLike) -> tuple[Floats, Floats]:
    """Return input and output as arrays that belong together."""
    given, measured = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    if given.ndim != 1 or given.shape != measured.shape:
        raise DataError(
            f"input of shape {given.shape} and output of shape {measured.shape}: give one value of each "
            "a sample"
        )
    if given.size <= structure.first:
        raise DataError(
            f"a record of {given.size} samples has no prediction, as the longest lag takes "
            f"{structure.first}: give a longer one"
        )
    for name, values in (("input", given), ("output", measured)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise DataError(f"{name} {int(bad[0])} is {values[bad[0]]}: split the record there or fill it")
    return given, measured


def _rows_of_one(structure: PiecewiseStructure, u: Floats, y: Floats) -> Rows:
    first, n = structure.first, y.size

    def lagged(values: Floats, delay: int, start: int) -> Floats:
        return values[start - delay : n - delay]

    known = [-lagged(y, i, first) for i in range(1, structure.n_a + 1)]
    known += [lagged(u, delay, first) for delay in structure.b_lags]
    begin = first - structure.n_g
    arguments = [lagged(u if signal == "u" else y, delay, begin) for signal, delay in structure.z_lags]
    return Rows(
        y[first:],
        np.column_stack(known) if known else np.empty((n - first, 0)),
        np.column_stack([*arguments, np.ones(n - begin)]),
        np.arange(structure.n_g, n - begin),
        (n - first,),
    )


@dataclass(frozen=True)
class PiecewiseLft:
    r"""A model :math:`A(q) y = B(q) u + G(q) f(z)` with numbers.

    Attributes
    ----------
    structure : PiecewiseStructure
    a, b, g : ndarray
        Coefficients a_1 ..., those of B in the order of `b_lags`, and g_1 ... (g_0 = 1).
    map : PiecewiseAffineMap
        f.
    """

    structure: PiecewiseStructure
    a: Floats
    b: Floats
    g: Floats
    map: PiecewiseAffineMap

    @classmethod
    def of(cls, structure: PiecewiseStructure, linear: ArrayLike, map: PiecewiseAffineMap) -> "PiecewiseLft":
        r"""Return the model with the parameters :math:`\eta_L` of (5.9)."""
        eta = np.asarray(linear, dtype=float)
        a, b, g = np.split(eta, [structure.n_a, structure.n_known])
        return cls(structure, a, b, g, map)

    @property
    def linear(self) -> Floats:
        r"""Parameters of the linear part, :math:`\eta_L` of (5.9)."""
        return np.concatenate([self.a, self.b, self.g])

    @property
    def values(self) -> dict[str, float]:
        """Parameters but the boundaries, by name."""
        theta = self.map.theta
        numbers = np.concatenate([self.linear, theta.ravel()])
        return dict(zip(self.structure.names(theta.shape[0]), numbers.tolist(), strict=True))

    def one_step(self, u: ArrayLike, y: ArrayLike) -> Floats:
        """Return the prediction of y from the past of u and y, NaN before `structure.first`.

        Parameters
        ----------
        u, y : array_like, shape (n_samples,)
            Input and measured output.
        """
        rows = rows_of(self.structure, u, y)
        predicted = np.full(np.size(y), np.nan)
        predicted[self.structure.first :] = self.predict(rows)
        return predicted

    def predict(self, rows: Rows) -> Floats:
        """Return the one-step predictions of rows, shape (n_rows,)."""
        w = self.map(rows.z)
        moving = sum((c * rows.delayed(w, lag) for lag, c in enumerate(self.g, 1)), rows.delayed(w, 0))
        return np.asarray(rows.known @ np.concatenate([self.a, self.b]) + moving)

    def simulate(self, u: ArrayLike, error: ArrayLike | None = None, initial: ArrayLike = ()) -> Floats:
        r"""Return the free run.

        Parameters
        ----------
        u : array_like, shape (n_samples,)
            Input.
        error : array_like, shape (n_samples,), optional
            Equation error :math:`\varepsilon`.
        initial : array_like, shape (m,)
            The first outputs; with fewer than `structure.first` of them, what lies before is zero.

        Returns
        -------
        ndarray, shape (n_samples,)
        """
        given = np.asarray(u, dtype=float)
        start = np.asarray(initial, dtype=float)
        first = self.structure.first
        noise = np.zeros(given.size) if error is None else np.asarray(error, dtype=float)
        if noise.shape != given.shape or given.ndim != 1:
            raise DataError(f"input of shape {given.shape} and error of shape {noise.shape}: give both alike")
        if start.size > given.size:
            raise DataError(f"{start.size} initial outputs for {given.size} inputs: give fewer")
        padded = np.concatenate([np.zeros(first), given])
        noise = np.concatenate([np.zeros(first), noise])
        y = np.concatenate([np.zeros(first), start, np.zeros(given.size - start.size)])
        _run(padded, noise, y, max(first, first + start.size), *self._packed())
        return y[first:]

    def _packed(self) -> tuple[Floats, Floats, Integers, Floats, Integers, Integers, Floats, Floats]:
        """Return the numbers as the kernel takes them; separators and submodels by region."""
        s, map_ = self.structure, self.map
        return (
            np.ascontiguousarray(self.a),
            np.ascontiguousarray(self.b),
            np.array(s.b_lags, dtype=np.int64),
            np.ascontiguousarray(self.g),
            np.array([signal == "u" for signal, _ in s.z_lags], dtype=np.int64),
            np.array([delay for _, delay in s.z_lags], dtype=np.int64),
            np.ascontiguousarray(map_.theta[map_.owners]),
            np.ascontiguousarray(map_.separators),
        )


@compiled
def _run(
    u: Floats,
    noise: Floats,
    y: Floats,
    begin: int,
    a: Floats,
    b: Floats,
    b_lags: Integers,
    g: Floats,
    from_u: Integers,
    delays: Integers,
    theta: Floats,
    separators: Floats,
) -> None:
    """Fill in y from ``begin`` on."""
    n_z = delays.size
    w = np.zeros(y.size)
    for k in range(begin - g.size, y.size):
        best = -np.inf
        for region in range(theta.shape[0]):
            score, value = separators[region, n_z], theta[region, n_z]
            for j in range(n_z):
                z = u[k - delays[j]] if from_u[j] else y[k - delays[j]]
                score += separators[region, j] * z
                value += theta[region, j] * z
            if score > best:
                best, w[k] = score, value
        if k < begin:
            continue
        total = w[k] + noise[k]
        for i in range(a.size):
            total -= a[i] * y[k - 1 - i]
        for i in range(b.size):
            total += b[i] * u[k - b_lags[i]]
        for i in range(g.size):
            total += g[i] * w[k - 1 - i]
        y[k] = total
