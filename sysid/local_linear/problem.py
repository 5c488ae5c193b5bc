"""The search problem of one or several experiments: projected cost and its linearisation."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sysid.errors import IdentifiabilityError
from sysid.local_linear import kernels
from sysid.local_linear.gradients import Elimination, eliminate
from sysid.local_linear.passes import fly, pull_back_slopes, regressors, sensitivities
from sysid.local_linear.structure import Course, Experiment, Mask, Sizes, course
from sysid.separable.factor import fold

Floats = NDArray[np.float64]
Jacobian = Literal["kaufman", "exact", "approach-2b"]

JACOBIANS: tuple[Jacobian, ...] = ("kaufman", "exact", "approach-2b")
START_RIDGE = 1e-6
"""Weight of initial states beside outputs of size one: it picks the smallest that fit equally well."""


@dataclass(frozen=True)
class Problem:
    r"""Least squares in :math:`\eta` with the linear parameters eliminated.

    Attributes
    ----------
    sizes : Sizes
    experiments : sequence of Experiment
    y : sequence of ndarray, shapes (n_samples, n_outputs)
    used : sequence of ndarray of bool, shapes (n_samples,)
        Rows that count.
    starts : bool
        Whether the initial state of each experiment is estimated; zero otherwise.
    jacobian : {"kaufman", "exact", "approach-2b"}
        What linearises the problem; approach-2b, as printed, is no Jacobian and there for comparison.
    """

    sizes: Sizes
    experiments: Sequence[Experiment]
    y: Sequence[Floats]
    used: Sequence[Mask]
    starts: bool = False
    jacobian: Jacobian = "kaufman"

    @property
    def n_unknowns(self) -> int:
        """Parameters, initial states included."""
        starts = self.sizes.n_states * len(self.experiments) if self.starts else 0
        return self.sizes.n_eta + self.sizes.n_linear + starts

    def __call__(self, eta: Floats) -> "At":
        """Evaluate the problem; where the simulation diverges the cost is infinite."""
        with np.errstate(all="ignore"):
            courses = [course(self.sizes, eta, experiment) for experiment in self.experiments]
            phi = self._stacked([regressors(one, starts=self.starts) for one in courses])
        try:
            found = eliminate(phi, self._data()) if np.all(np.isfinite(phi)) else None
        except IdentifiabilityError:
            if phi.shape[0] < phi.shape[1]:
                raise
            found = None
        if found is not None and not np.all(np.isfinite(found.theta)):
            found = None  # columns of 1e-300, of a local model that is hardly ever in charge
        return At(self, courses, found)

    def _data(self) -> Floats:
        parts = [np.ravel(y[used]) for y, used in zip(self.y, self.used, strict=True)]
        return np.concatenate([*parts, np.zeros(self._n_starts)])

    @property
    def _n_starts(self) -> int:
        return self.sizes.n_states * len(self.experiments) if self.starts else 0

    def _stacked(self, blocks: Sequence[Floats]) -> Floats:
        """Stack the rows that count; columns of initial states get a place for each experiment."""
        rows = [
            (block if used.all() else block[used]).reshape(-1, block.shape[2])
            for block, used in zip(blocks, self.used, strict=True)
        ]
        if not self.starts:
            return rows[0] if len(rows) == 1 else np.vstack(rows)
        n, common = self.sizes.n_states, self.sizes.n_linear
        ends = np.cumsum([0, *(part.shape[0] for part in rows)])
        phi = np.zeros((ends[-1] + self._n_starts, common + self._n_starts))
        for number, part in enumerate(rows):
            where = slice(ends[number], ends[number + 1])
            phi[where, :common] = part[:, :common]
            phi[where, common + number * n : common + (number + 1) * n] = part[:, common:]
        phi[ends[-1] :, common:] = START_RIDGE * np.sqrt(ends[-1]) * np.eye(self._n_starts)
        return phi


@dataclass(frozen=True)
class At:
    """The problem at one eta; `sysid.separable.descend` takes it as a point.

    Attributes
    ----------
    problem : Problem
    courses : sequence of Course
    found : Elimination or None
        None where the simulation diverges or a local model is not visited.
    """

    problem: Problem
    courses: Sequence[Course]
    found: Elimination | None

    @property
    def cost(self) -> float:
        """Projected cost (12)."""
        return np.inf if self.found is None else self.found.cost

    @property
    def solution(self) -> Elimination:
        """The elimination; only where the cost is finite."""
        assert self.found is not None
        return self.found

    def gains(self) -> Floats:
        """Return G, shape (n_states, channels)."""
        sizes = self.problem.sizes
        return self.solution.theta[: sizes.n_linear].reshape(sizes.n_states, -1)

    def starting_states(self) -> Floats:
        """Return x(0) of each experiment, shape (n_experiments, n_states)."""
        sizes, count = self.problem.sizes, len(self.courses)
        if not self.problem.starts:
            return np.zeros((count, sizes.n_states))
        return self.solution.theta[sizes.n_linear :].reshape(count, sizes.n_states)

    def output_slopes(self) -> Floats:
        """Return the derivative of the residual by eta at fixed linear parameters, (n_rows, n_eta)."""
        G, blocks = self.gains(), []
        for one, used, start in zip(self.courses, self.problem.used, self.starting_states(), strict=True):
            block = sensitivities(one, fly(one, G, start), sign=-1.0)
            blocks.append((block if used.all() else block[used]).reshape(-1, block.shape[2]))
        ridge = np.zeros(
            (self.solution.tail.size - sum(block.shape[0] for block in blocks), blocks[0].shape[1])
        )
        return blocks[0] if len(blocks) == 1 and not ridge.size else np.vstack([*blocks, ridge])

    def linearise(self) -> tuple[Floats, Floats]:
        """Return Jacobian and residual in coordinates in which both are triangular."""
        jacobian, residual = self.derivative()
        n = jacobian.shape[1]
        # One pass with a narrow panel costs a third of a factorisation of the whole.
        folded = fold(None, np.ascontiguousarray(np.column_stack([jacobian, residual]).T))
        return folded[:, :n], folded[:, n]

    def derivative(self) -> tuple[Floats, Floats]:
        """Return Jacobian and residual, in coordinates rotated by Q unless they are approach 2b's."""
        moved, found = self.output_slopes(), self.solution
        if self.problem.jacobian == "approach-2b":
            return moved, found.residual
        tail = found.rotate(moved)[1]
        if self.problem.jacobian == "kaufman":
            return tail, found.tail
        head = -found.solve_transposed(self.second_term())
        return np.vstack([head, tail]), np.concatenate([np.zeros(found.n_linear), found.tail])

    def second_term(self) -> Floats:
        """Return (d Phi / d eta)' r, shape (n_linear, n_eta)."""
        problem, first = self.problem, 0
        n, common = problem.sizes.n_states, problem.sizes.n_linear
        table = np.zeros((self.solution.n_linear, problem.sizes.n_eta))
        for number, (one, used) in enumerate(zip(self.courses, problem.used, strict=True)):
            r = np.zeros((used.size, problem.sizes.n_outputs))
            count = int(used.sum()) * r.shape[1]
            r[used] = self.solution.residual[first : first + count].reshape(-1, r.shape[1])
            first += count
            mu = np.empty((used.size, n))
            kernels.adjoint(one.A, r @ one.C, mu)
            part = pull_back_slopes(one, r, mu, starts=problem.starts)
            table[:common] += part[:common]
            if problem.starts:
                table[common + number * n : common + (number + 1) * n] += part[common:]
        return table
