"""The map of a Wiener-Hammerstein model, eliminated by a QR that never holds the whole record.

For given linear blocks the output y = G2 [sum_j lambda_j phi_j(G1 u)] is linear in the coefficients lambda_j
of the map.  Rows are made block by block and folded into a triangular factor, so that memory does not grow
with the record.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid.data.record import Mask
from sysid.lft.linear_block import coordinates
from sysid.lft.wiener_hammerstein.columns import Columns
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.linear.forms import Floats
from sysid.linear.reduction import Segment, solve
from sysid.linear.simulation import simulate_polynomial
from sysid.separable.factor import fold

BLOCK_ROWS = 2048
RESPONSE_ROWS = 1000
# Weight of the map's second differences against what the data say of an average coefficient: far too small to
# matter where there are data, it carries the map on where there are none.
SMOOTHING = 1e-5


@dataclass(frozen=True)
class Problem:
    """What a search works on.

    The data do not tell how gain is shared: the largest weight of each block is held.

    Attributes
    ----------
    segments : tuple of Segment
        Experiments; inputs of shape (n_rows, 1).
    template : WienerHammerstein
        Gives knots, delay and all that is not searched.
    """

    segments: tuple[Segment, ...]
    template: WienerHammerstein

    @property
    def n_basis(self) -> int:
        """Coefficients of the map."""
        return int(self.template.map.coefficients.size)

    @property
    def n_rows(self) -> int:
        """Rows that count."""
        return sum(int(segment.used.sum()) for segment in self.segments)

    @cached_property
    def free(self) -> Mask:
        """Which reflections and weights are searched."""
        n1, n2 = self.template.orders
        free = np.ones(2 * (n1 + n2) + 2, dtype=np.bool_)
        free[n1 + np.argmax(np.abs(self.template.front.weights))] = False
        free[2 * n1 + 1 + n2 + np.argmax(np.abs(self.template.back.weights))] = False
        return free

    @cached_property
    def smoothing(self) -> Floats:
        """Weighted second differences of the map's coefficients, shape (n_basis - 2, n_basis)."""
        back = self.template.back
        impulse = np.zeros(RESPONSE_ROWS)
        impulse[0] = 1.0
        size = float(np.linalg.norm(simulate_polynomial(back.b, back.a, impulse)))
        typical = size * np.sqrt(self.n_rows / self.n_basis)
        return np.asarray(SMOOTHING * typical * np.diff(np.eye(self.n_basis), 2, axis=0))

    @property
    def start(self) -> Floats:
        """The searched parameters of the template."""
        return np.asarray(self.template.vector[: self.free.size][self.free])

    def model(self, x: Floats) -> WienerHammerstein:
        """Return the template with other searched parameters."""
        vector = self.template.vector
        vector[: self.free.size][self.free] = x
        return self.template.with_vector(vector)


class Point:
    """The problem at one set of blocks, as `sysid.separable.descent.descend` sees it."""

    def __init__(self, problem: Problem, x: Floats):
        self.problem = problem
        self._blocks = problem.model(x)

    @cached_property
    def _projection(self) -> tuple[float, Floats]:
        p = self.problem.n_basis
        triangle = reduced(self.problem, self._blocks, derivatives=False)
        coefficients = solve(triangle[:p, :p], triangle[:p, -1])
        residual = triangle[:, -1].copy()
        residual[:p] -= triangle[:p, :p] @ coefficients
        return float(residual @ residual), coefficients

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        return self._projection[0]

    @property
    def model(self) -> WienerHammerstein:
        """The blocks with the best map."""
        return replace(self._blocks, map=replace(self._blocks.map, coefficients=self._projection[1]))

    def linearise(self) -> tuple[Floats, Floats]:
        """Return J (triangular) and r by the searched parameters, the map eliminated (Kaufman's Jacobian)."""
        p = self.problem.n_basis
        return -self.triangle[p:-1, p:-1], self.triangle[p:-1, -1]

    @cached_property
    def triangle(self) -> Floats:
        """The factor of [derivatives of the output by the map, by the searched parameters; the output]."""
        triangle = reduced(self.problem, self.model, derivatives=True)
        p = self.problem.n_basis
        chained = triangle[:, p:-1] @ searched_columns(self.problem, self.model)
        return np.column_stack([triangle[:, :p], chained, triangle[:, -1]])


def searched_columns(problem: Problem, model: WienerHammerstein) -> Floats:
    """Return the derivatives of what the columns stand for by the searched parameters."""
    front, back = coordinates(model.front), coordinates(model.back)
    chain = np.zeros((problem.free.size, problem.free.size))
    chain[: front.shape[0], : front.shape[0]] = front
    chain[front.shape[0] :, front.shape[0] :] = back
    return chain[:, problem.free]


def reduced(problem: Problem, model: WienerHammerstein, *, derivatives: bool) -> Floats:
    """Return the triangular factor of the columns and the output."""
    triangle: Floats | None = None
    for segment in problem.segments:
        for rows, y, used in blocks_of_rows(segment, model, derivatives=derivatives):
            rows[:, -1] = y
            triangle = fold(triangle, (rows if used.all() else rows[used]).T)
    assert triangle is not None
    smooth = np.zeros((max(problem.n_basis - 2, 0), triangle.shape[1]))
    smooth[:, : problem.n_basis] = problem.smoothing
    return fold(triangle, smooth.T)


def blocks_of_rows(
    segment: Segment, model: WienerHammerstein, *, derivatives: bool
) -> Iterator[tuple[Floats, Floats, Mask]]:
    """Give columns (and one more to be filled), output and the rows that count, block after block."""
    columns = Columns(model, segment.u[:, 0], derivatives)
    for first in range(0, segment.y.size, BLOCK_ROWS):
        y = segment.y[first : first + BLOCK_ROWS]
        yield columns.next_rows(y.size, spare=1), y, segment.used[first : first + BLOCK_ROWS]
