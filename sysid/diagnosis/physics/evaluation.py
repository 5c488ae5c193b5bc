"""A problem as a search evaluates it."""

from typing import Protocol

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.separable.descent import Residual


class Searched(Protocol):
    """What a search asks of a problem."""

    @property
    def jumps(self) -> bool:
        """Whether a sensor jumps, so that derivatives are taken without it."""

    def residual(self, point: Floats) -> Floats:
        """Return the residual at a point."""

    def jacobian(self, point: Floats) -> Floats:
        """Return the Jacobian at a point."""

    def with_derivative(self, point: Floats) -> tuple[Floats, Floats]:
        """Return residual and Jacobian."""


class Evaluation:
    """Residuals of a problem, with the Jacobian at once as long as the search takes its steps.

    Parameters
    ----------
    problem : Searched
    most : int
        Evaluations that the search may make: after the last one it takes no further step.
    """

    def __init__(self, problem: Searched, most: int) -> None:
        self._problem, self._left = problem, most
        self._derivative_is_wanted = True

    def __call__(self, point: Floats) -> Residual:
        """Return the residual at a point, and how to get its Jacobian."""
        self._left -= 1
        if self._problem.jumps or not self._derivative_is_wanted or not self._left:
            return Residual(self._problem.residual(point), lambda: self._asked(self._problem.jacobian(point)))
        self._derivative_is_wanted = False
        residual, J = self._problem.with_derivative(point)
        return Residual(residual, lambda: self._asked(J))

    def _asked(self, J: Floats) -> Floats:
        self._derivative_is_wanted = True
        return finite(J)


def finite(J: Floats) -> Floats:
    """Return a Jacobian with zeros where a small move makes the model diverge."""
    return J if np.isfinite(J).all() else np.nan_to_num(J, nan=0.0, posinf=0.0, neginf=0.0)
