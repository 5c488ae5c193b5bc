"""The rows of a Wiener-Hammerstein model and of its derivatives, made block after block."""

from typing import TYPE_CHECKING, Protocol

import numpy as np

from sysid.lft.between_samples import interpolation_taps
from sysid.lft.wiener_hammerstein.kernels import back_derivatives, back_rows, front_rows, map_rows
from sysid.linear.forms import Floats
from sysid.nonlinearities.spline import EXTRAPOLATIONS

if TYPE_CHECKING:
    from sysid.lft.linear_block import LinearBlock
    from sysid.nonlinearities.spline import Spline

# Below this 1 + a1 + a2 of a section is an integrator, which no constant input settles: it starts from zero.
SMALLEST_SUM = 1e-9


class Chain(Protocol):
    """A map between two linear blocks, see `sysid.lft.wiener_hammerstein.model.WienerHammerstein`."""

    @property
    def front(self) -> "LinearBlock":
        """The block before the map."""

    @property
    def map(self) -> "Spline":
        """The static map."""

    @property
    def back(self) -> "LinearBlock":
        """The block behind the map."""

    @property
    def delay(self) -> int:
        """Samples by which the input is late."""

    @property
    def oversampling(self) -> int:
        """Points in a sampling period at which the map is found."""

    @property
    def resting(self) -> bool:
        """Whether the input was zero before a record."""


class Columns:
    """The columns of one experiment.

    First the basis functions of the map behind the back block; with ``derivatives`` those of the output by
    the sections and the numerator of the front block, then the same of the back block.  The run starts from
    the steady state of the constant input before it; behind its end the input is held.

    Parameters
    ----------
    model : Chain
    u : ndarray, shape (n_samples,)
    derivatives : bool
    transient : ndarray, shape (n_samples,), optional
        Added to the front block's output: a free response.
    """

    def __init__(
        self,
        model: Chain,
        u: Floats,
        derivatives: bool = False,
        transient: Floats | None = None,
    ):
        self.model, self.derivatives = model, derivatives
        self.taps = interpolation_taps(model.oversampling)
        self.margin = self.taps.shape[1] if model.oversampling > 1 else 0
        self.n_left = u.size
        before = 0.0 if model.resting else float(u[0])
        held = (np.full(model.delay, before), u, np.full(self.margin, u[-1]))
        self.u = np.concatenate(held)[: u.size + self.margin]
        self.transient = np.zeros(self.u.size)
        if transient is not None:
            self.transient[: u.size] = transient
        self.place = 0
        self._settle(before)

    def next_rows(self, count: int, spare: int = 0) -> Floats:
        """Return the next rows, shape (count, n_columns + spare); spare columns are left to be filled."""
        basis = self.model.map.coefficients.size
        signals = self._next_signals(count)
        n_signals, n2 = signals.shape[1], self.model.back.order
        rows = np.empty((count, n_signals + self.derivatives * (2 * n2 + 1) + spare))
        a1, a2 = self.model.back.sections
        weights = self.model.back.weights
        back_rows(signals, a1, a2, weights, self.late, self.filters, rows)
        if self.derivatives:
            w = signals[:, :basis] @ self.model.map.coefficients
            back_derivatives(
                w, self.late_w, a1, a2, weights, self.back_state, self.back_poles, rows[:, n_signals:]
            )
        self.n_left -= count
        return rows

    def front_signal(self) -> Floats:
        """Return the map's input at all rows that are left, shape (n_samples,)."""
        ahead = self.buffer[self.margin :, 0]
        later = self._front(self.u[self.place :])[:, 0] + self.transient[self.place :]
        return np.concatenate([ahead, later])[: self.n_left]

    def _settle(self, before: float) -> None:
        front, back, n1 = self.model.front, self.model.back, self.model.front.order
        self.late_u = np.array([before])
        self.front_state = _settled(front, before)
        self.front_poles = np.zeros_like(self.front_state)
        z = self._front(np.array([before]))
        self.late_u[0] = before
        self.front_poles = _settled(front, float(z[0, 0]))
        row = self._front(np.array([before]))
        signals = self._map(np.repeat(row, 2 * self.margin + 1, axis=0), 1)
        self.late = signals[0].copy()
        self.filters = _settled(back, self.late)
        w = float(signals[0, : self.model.map.coefficients.size] @ self.model.map.coefficients)
        self.late_w = np.array([w])
        self.back_state = _settled(back, w)
        columns = np.zeros(back.order)
        columns[::2] = self.back_state[:, 0]
        columns[: back.order // 2 * 2 : 2] *= 2.0
        self.back_poles = _settled(back, float(columns @ back.weights[:-1] + w * back.weights[-1]))
        ahead = self._front(self.u[: self.margin])
        ahead[:, 0] += self.transient[: self.margin]
        self.buffer = np.vstack([np.repeat(row, self.margin, axis=0), ahead])
        self.place = self.margin
        assert row.shape[1] == 1 + self.derivatives * (2 * n1 + 1)

    def _next_signals(self, count: int) -> Floats:
        """Return the inputs of the back block."""
        new = self._front(self.u[self.place : self.place + count])
        new[:, 0] += self.transient[self.place : self.place + count]
        self.place += count
        front = np.vstack([self.buffer, new]) if self.margin else new
        self.buffer = front[front.shape[0] - 2 * self.margin :].copy()
        return self._map(front, count)

    def _front(self, u: Floats) -> Floats:
        front = self.model.front
        rows = np.empty((u.size, 1 + self.derivatives * (2 * front.order + 1)))
        a1, a2 = front.sections
        front_rows(u, self.late_u, a1, a2, front.weights, self.front_state, self.front_poles, rows)
        return rows

    def _map(self, front: Floats, count: int) -> Floats:
        spline = self.model.map
        signals = np.empty((count, spline.coefficients.size + front.shape[1] - 1))
        form = EXTRAPOLATIONS[spline.extrapolation]
        along = np.ascontiguousarray(front.T)  # sums over neighbouring samples run along the rows
        map_rows(along, self.taps, spline.knots, spline.degree, form, spline.coefficients, signals)
        return signals


def _settled(block: "LinearBlock", value: "float | Floats") -> Floats:
    """Return the states of all sections that constant inputs lead to, shape (n_sections, 2, ...).

    The all-pass between sections has the gain 1, so that each section sees the same constant.
    """
    a1, a2 = block.sections
    total = 1.0 + a1 + a2
    gains = np.where(total > SMALLEST_SUM, 1.0 / np.maximum(total, SMALLEST_SUM), 0.0)
    states = np.multiply.outer(gains, value)
    return np.ascontiguousarray(np.stack([states, states], axis=1))
