"""The iteration of Table 4.1 of Pepona (2009) as it is printed, to show what it does; not for use.

Its stopping test is inverted, so that it ends at the first step that lowers the cost by much, and
goes on as long as the steps do little or harm; a step uphill raises the damping but is kept.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data.record import Mask
from sysid.errors import UsageError
from sysid.lft.estimate import Start, first_start, given_start
from sysid.lft.problem import LftProblem
from sysid.lft.signals import Data, signals_of, usable_rows
from sysid.lft.structure import LftStructure
from sysid.lft.threads import on_one_thread
from sysid.separable import kaufman_jacobian, project

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PrintedSearch:
    """The course of the printed iteration.

    Attributes
    ----------
    d, g : ndarray
        Where it ended: d scaled to length 1, g with its leading 1.
    costs : ndarray, shape (n_steps + 1,)
        V of eq. (4.20) at the start and after every step, uphill or not.
    damping : ndarray, shape (n_steps,)
        Damping delta of each step.
    steps : ndarray, shape (n_steps, n_taps + n_g)
        The steps of (d, g1, ...).
    stopped : bool
        Whether the stopping test ended it, rather than the limit of steps.
    """

    d: Floats
    g: Floats
    costs: Floats
    damping: Floats
    steps: Floats
    stopped: bool

    @property
    def ratios(self) -> Floats:
        """Cost after each step over that before it; the printed test stops at the first one below rho."""
        return self.costs[1:] / self.costs[:-1]


@on_one_thread
def printed_search(
    data: Data,
    structure: LftStructure,
    *,
    rows: Mask | None = None,
    start: Start | tuple[ArrayLike, ArrayLike] | None = None,
    gamma: float = 2.0,
    rho: float = 0.95,
    until: Literal["printed", "reversed"] = "printed",
    damping: Literal["delta", "power"] = "delta",
    max_steps: int = 100,
) -> PrintedSearch:
    r"""Run Table 4.1 step by step.

    Parameters
    ----------
    data, structure, rows, start
        As for `fit_lft`.
    gamma : float
        Factor of the damping, above 1.
    rho : float
        Threshold of the stopping test, at least 0.95 and below 1.
    until : {"printed", "reversed"}
        Whether to stop when the ratio of costs is at most rho, as printed, or when it is above.
    damping : {"delta", "power"}
        Whether :math:`\delta^j` is the damping of step j, or delta to the power j.
    max_steps : int
        Limit, which the table does not have.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> u = rng.uniform(-1, 1, 400)
    >>> y = np.zeros(400)
    >>> y[2:] = np.exp(0.6 * u[1:-1] + 0.8 * u[:-2]) + 0.1 * rng.standard_normal(398)
    >>> wiener = LftStructure(z_lags=(("u", 1), ("u", 2)))
    >>> course = printed_search((u, y), wiener, start=([0.9, 0.44], [1.0]))
    >>> course.stopped, len(course.steps)  # one good step, and it is over
    (True, 1)
    """
    if not (gamma > 1.0 and 0.95 <= rho < 1.0):
        raise UsageError(
            f"gamma is {gamma:g} and rho {rho:g}: give gamma above 1 and rho from 0.95 to below 1"
        )
    signals = signals_of(data)
    problem = LftProblem.of(signals, structure, usable_rows(signals, structure, rows))
    d, g = first_start(problem) if start is None else given_start(problem, start)
    # All taps move freely here: the table does not mention the constraint on the length of d.
    free = replace(problem, centre=np.zeros(d.size), tangents=np.eye(d.size))
    eta = np.concatenate([d, g[1:]])
    projection = project(free.regressors(eta), free.y)
    costs, dampings = [projection.cost], list[float]()
    steps: list[Floats] = []
    delta, stopped = 1.0, False
    while not stopped and len(steps) < max_steps:
        weight = np.sqrt(delta if damping == "delta" else delta ** (len(steps) + 1))
        model_jacobian = -kaufman_jacobian(projection, free.derivative(eta))
        extended = np.vstack([model_jacobian, weight * np.eye(eta.size)])
        target = np.concatenate([projection.residual, np.zeros(eta.size)])
        step = np.linalg.lstsq(extended, target)[0]
        eta = eta + step
        phi = free.regressors(eta)
        if not np.isfinite(phi).all():
            break
        projection = project(phi, free.y)
        dampings.append(delta)
        steps.append(step)
        costs.append(projection.cost)
        ratio = costs[-1] / costs[-2]
        delta = gamma * delta if ratio > 1.0 else delta / gamma
        stopped = ratio <= rho if until == "printed" else rho < ratio <= 1.0
    return PrintedSearch(
        d=free.direction(eta),
        g=free.numerator(eta),
        costs=np.array(costs) / (2.0 * free.y.size),
        damping=np.array(dampings),
        steps=np.array(steps).reshape(len(steps), eta.size),
        stopped=stopped,
    )
