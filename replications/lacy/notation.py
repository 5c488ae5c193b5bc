"""The matrices of Section 4 and 5 as the paper writes them, to hold the fast forms against."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

Floats = np.ndarray


@dataclass(frozen=True, eq=False)
class Notation:
    """P, Q, R, U, Y, Phi, Psi and the projector of eqs. (6)-(15), and eqs. (22)-(27).

    Parameters
    ----------
    u, y : ndarray, shape (n + p,)
    n : int
        Order.
    """

    u: Floats
    y: Floats
    n: int

    @property
    def p(self) -> int:
        """Rows of the regression."""
        return self.y.size - self.n

    @cached_property
    def P(self) -> Floats:
        """Removes the last n components."""
        return np.asarray(np.eye(self.y.size)[: self.p])

    @cached_property
    def Q(self) -> Floats:
        """Removes the first n components, eq. (11)."""
        return np.asarray(np.eye(self.y.size)[self.n :])

    def shift(self, power: int) -> Floats:
        """Return R^power; R moves the first component to the end."""
        return np.roll(np.eye(self.y.size), power, axis=1)

    @staticmethod
    def e(i: int, j: int) -> Floats:
        """Return the i-th column of the identity of size j, eq. (6)."""
        return np.asarray(np.eye(j)[i - 1])

    def a_column(self, i: int) -> Floats:
        """Return e_(n+1-i, 2n+1), which selects a_(n+1-i)."""
        return self.e(self.n + 1 - i, 2 * self.n + 1)

    @cached_property
    def Phi(self) -> Floats:
        """The regression matrix by eqs. (7)-(9)."""
        n, m = self.n, 2 * self.n + 1
        inputs = sum(
            np.outer(self.P @ self.shift(i - 1) @ self.u, self.e(2 * (n + 1) - i, m)) for i in range(1, n + 2)
        )
        outputs = sum(
            np.outer(self.P @ self.shift(i - 1) @ self.y, self.a_column(i)) for i in range(1, n + 1)
        )
        return np.asarray(inputs - outputs)

    @cached_property
    def Gram(self) -> Floats:
        """(Phi^T Phi)^-1."""
        return np.linalg.inv(self.Phi.T @ self.Phi)

    @cached_property
    def Psi(self) -> Floats:
        """The left inverse of Phi, eq. (14)."""
        return np.asarray(self.Gram @ self.Phi.T)

    @cached_property
    def Pi(self) -> Floats:
        """The projector of eq. (15)."""
        return np.asarray(np.eye(self.p) - self.Phi @ self.Psi)

    def gradient(self, factor: Floats) -> Floats:
        """Return eq. (22) with the missing factor given; it is y."""
        qy = self.Q @ self.y
        found = 2 * self.Q.T @ self.Pi @ qy
        for i in range(1, self.n + 1):
            scalar = factor @ self.Q.T @ self.Psi.T @ self.a_column(i)
            found = found + 2 * self.shift(i - 1).T @ self.P.T @ self.Pi @ qy * scalar
        return np.asarray(found)

    def U_of(self, j: int) -> Floats:
        """Return U(j), eq. (24)."""
        unit = self.e(j, self.y.size)
        return np.outer(unit, self.y) + np.outer(self.y, unit)

    def hessian(self, factor: Floats) -> Floats:
        """Return eq. (23) with the factor missing in its last product given; it is y."""
        return np.column_stack([self._column(j, factor) for j in range(1, self.y.size + 1)])

    def _column(self, j: int, factor: Floats) -> Floats:
        Q, P, Pi, Phi, Psi, Gram = self.Q, self.P, self.Pi, self.Phi, self.Psi, self.Gram
        qy, unit = Q @ self.y, self.e(j, self.y.size)
        found = 2 * Q.T @ Pi @ Q @ unit
        for i in range(1, self.n + 1):
            ei = self.a_column(i)
            shifted = P @ self.shift(i - 1) @ unit
            V = symmetric(np.outer(Pi @ shifted, ei @ Psi))  # (25)
            W = symmetric(np.outer(Phi.T @ qy, ei) * (qy @ Pi @ shifted))  # (26)
            X = symmetric(np.outer(qy, shifted) * (qy @ Psi.T @ ei))  # (27)
            last = np.outer(qy, ei) * (factor @ Q.T @ Pi @ shifted)
            bracket = (Psi.T @ W + Pi @ X @ Phi - last) @ Gram
            found = found + 2 * Q.T @ V @ qy
            found = found + 2 * self.shift(i - 1).T @ P.T @ Pi @ Q @ self.U_of(j) @ Q.T @ Psi.T @ ei
            for column in range(1, self.n + 1):
                found = found + 2 * self.shift(column - 1).T @ P.T @ bracket @ self.a_column(column)
        return np.asarray(found)


def symmetric(matrix: Floats) -> Floats:
    """Return a matrix plus its transpose."""
    return np.asarray(matrix + matrix.T)
