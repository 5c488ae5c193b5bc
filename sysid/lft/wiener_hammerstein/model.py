"""The Wiener-Hammerstein model: a static map between two linear blocks."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import UsageError
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein.columns import Columns
from sysid.linear.forms import Floats
from sysid.nonlinearities.spline import Spline

BLOCK_ROWS = 16_384
# A block whose gain at zero frequency is below this share of its largest gain is normalised by the largest
# one.
SMALL_GAIN = 0.05
FREQUENCIES = 512


@dataclass(frozen=True, eq=False)
class WienerHammerstein:
    """y = G2 f(G1 u), G1 and G2 linear, f static.

    Attributes
    ----------
    front, back : LinearBlock
        G1 and G2.
    map : Spline
        f.
    delay : int
        Samples by which the input is late.
    oversampling : int
        1: the map acts on samples.  R > 1: it acts in continuous time, found at R points in a sampling
        period.
    resting : bool
        Whether the input was zero before a record; otherwise it was constant at its first value.

    Examples
    --------
    >>> import numpy as np
    >>> lag = LinearBlock.from_polynomials([0.5], [1.0, -0.5])
    >>> square = Spline.fitted(np.linspace(-2, 2, 50), np.linspace(-2, 2, 50) ** 2, [-2.0, 2.0])
    >>> WienerHammerstein(lag, square, lag).simulate([0.0, 1.0, 1.0]).round(9)
    array([0.     , 0.125  , 0.34375])
    """

    front: LinearBlock
    map: Spline
    back: LinearBlock
    delay: int = 0
    oversampling: int = 1
    resting: bool = False

    @property
    def orders(self) -> tuple[int, int]:
        """Orders of the front and the back block."""
        return self.front.order, self.back.order

    @property
    def vector(self) -> Floats:
        """Reflections and weights of the front block, the same of the back block, coefficients of the map."""
        blocks = (self.front.reflections, self.front.weights, self.back.reflections, self.back.weights)
        return np.concatenate([*blocks, self.map.coefficients])

    def with_vector(self, vector: Floats) -> "WienerHammerstein":
        """Return the model of the same structure with other parameters."""
        n1, n2 = self.orders
        parts = np.split(vector, np.cumsum([n1, n1 + 1, n2, n2 + 1]))
        spline = replace(self.map, coefficients=parts[4])
        return replace(
            self, front=LinearBlock(parts[0], parts[1]), back=LinearBlock(parts[2], parts[3]), map=spline
        )

    def simulate(self, u: ArrayLike, transient: ArrayLike | None = None) -> Floats:
        """Return the output, from the steady state of the first input (from rest for a resting model).

        Parameters
        ----------
        u : array_like, shape (n_samples,)
        transient : array_like, shape (n_samples,), optional
            Added to the front block's output: its free response to another initial state.

        Returns
        -------
        ndarray, shape (n_samples,)

        Raises
        ------
        UsageError
            If the input has another shape or is not finite.
        """
        extra = None if transient is None else np.asarray(transient, dtype=np.float64)
        columns = Columns(self, checked_input(u), transient=extra)
        blocks = [
            columns.next_rows(min(BLOCK_ROWS, columns.n_left)) @ self.map.coefficients
            for _ in range(0, columns.n_left, BLOCK_ROWS)
        ]
        return np.concatenate(blocks)

    def map_input(self, u: ArrayLike) -> Floats:
        """Return z = G1 u, shape (n_samples,)."""
        return Columns(self, checked_input(u)).front_signal()

    def normalised(self) -> "WienerHammerstein":
        """Return the same model with gains of one: the data do not tell how gain is shared.

        Both blocks have the gain 1 at zero frequency, so that the map is the steady-state characteristic of
        the whole; a block that lets hardly anything pass there has the largest gain 1.
        """
        g1, g2 = _gain(self.front), _gain(self.back)
        order = 1 if g1 > 0 else -1
        spline = replace(
            self.map,
            knots=(self.map.knots / g1)[::order],
            coefficients=(self.map.coefficients * g2)[::order],
        )
        return replace(self, front=self.front.scaled(1.0 / g1), back=self.back.scaled(1.0 / g2), map=spline)


def checked_input(u: ArrayLike) -> Floats:
    """Return an input as an array; UsageError if it is none."""
    signal = np.ascontiguousarray(u, dtype=np.float64)
    if signal.ndim != 1 or signal.size == 0 or not np.isfinite(signal).all():
        raise UsageError(f"the input has shape {signal.shape}: give one finite number for each sample")
    return signal


def _gain(block: LinearBlock) -> float:
    constant = float(block.response([0.0])[0].real) if np.abs(block.a.sum()) > 0 else np.inf
    gains = block.response(np.linspace(0.0, np.pi, FREQUENCIES + 1)[1:])
    largest = gains[np.argmax(np.abs(gains))]
    if np.isfinite(constant) and abs(constant) >= SMALL_GAIN * abs(largest):
        return constant
    return float(np.abs(largest)) or 1.0
