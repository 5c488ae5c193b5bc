"""Identification of a Wiener system behind a known nonlinearity that need not be invertible."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear import simulate_polynomial
from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import KnownMap, Preimage
from sysid.wiener import solvers
from sysid.wiener.criterion import Criterion, Normalisation, check_excitation
from sysid.wiener.identifiability import Identifiability, identifiability
from sysid.wiener.solvers import Candidate, Outcome

NODE_LIMIT = 50_000_000
REGION_LIMIT = 4096


@dataclass(frozen=True, eq=False)
class WienerFit:
    """An identified Wiener system y = B/A u, z = N(y).

    Attributes
    ----------
    theta : ndarray, shape (2 order + 1,)
        [a1 ... an b0 ... bn] with A = 1 + a1 q^-1 + ... .
    order : int
    nonlinearity : KnownMap
    y : ndarray, shape (n_samples,)
        The estimated intermediate signal, a point of the preimage.
    cost, criterion : float
        J_y^2, and what was minimised.
    solver, status : str
        Which solver the preimage asked for, and why it stopped.
    exact : bool
        Whether no better point of the preimage exists.
    effort : int
        Nodes or iterations.
    preimage : Preimage
        With the data that were moved into the range.
    identifiability : Identifiability
        What the data determine.
    candidates : tuple of Candidate
        The best points found, best first.
    """

    theta: Floats
    order: int
    nonlinearity: KnownMap
    y: Floats
    cost: float
    criterion: float
    solver: str
    status: str
    exact: bool
    effort: int
    preimage: Preimage = field(repr=False)
    identifiability: Identifiability
    candidates: tuple[Candidate, ...] = field(repr=False)

    @property
    def a(self) -> Floats:
        """Denominator [1, a1, ... an] by rising powers of q^-1."""
        return np.concatenate([[1.0], self.theta[: self.order]])

    @property
    def b(self) -> Floats:
        """Numerator [b0, ... bn] by rising powers of q^-1."""
        return self.theta[self.order :]

    @property
    def moved(self) -> int:
        """Number of data that lay outside the range of the nonlinearity."""
        return int(self.preimage.moved.size)

    def simulate(self, u: ArrayLike) -> Floats:
        """Return the output of the model for an input, from rest."""
        return self.nonlinearity(simulate_polynomial(self.b, self.a, u))

    def __repr__(self) -> str:
        numbers = ", ".join(f"{value:.5g}" for value in self.theta)
        return (
            f"WienerFit(theta=[{numbers}], {self.solver}: {self.status}; {self.moved} data moved into the "
            f"range; {self.identifiability.sentence})"
        )


def identify_wiener(
    u: ArrayLike,
    z: ArrayLike,
    nonlinearity: KnownMap,
    order: int,
    *,
    normalisation: Normalisation = "free",
    relative: bool | None = None,
    starts: int = 8,
    keep: int = 1,
    node_limit: int = NODE_LIMIT,
    region_limit: int = REGION_LIMIT,
    seed: int = 0,
) -> WienerFit:
    r"""Identify a Wiener system by minimising J_y over the preimage of its output.

    Lacy, Erwin and Bernstein (2001), Section 5. The solver follows from the preimage: one point is a single
    evaluation; finite sets are searched exactly by branch and bound; boxes by bounded minimisation from
    several starts; unions of both region by region.

    Parameters
    ----------
    u, z : array_like, shape (n_samples,)
        Input and measured output.
    nonlinearity : KnownMap
        The static map behind the linear system.
    order : int
        Order of the linear system.
    normalisation : {"free", "dc-gain", "sum-b"}
        What fixes the gain where the data do not, or where it belongs to the nonlinearity (Section 6).
    relative : bool, optional
        Minimise :math:`J_y^2/\|Qy\|^2` instead of :math:`J_y^2`. By default so for boxes and unions with a
        free gain: there J_y favours small y and, with a constant region around zero, is useless at y = 0.
        Finite sets have no scale to slide along and use J_y.
    starts : int
        Starts of the bounded minimisation.
    keep : int
        Sequences that branch and bound keeps.
    node_limit, region_limit : int
        Limits of branch and bound, and of the regions of a union that are all examined.
    seed : int
        Of the random starts.

    Returns
    -------
    WienerFit

    Raises
    ------
    DataError
        If input and output differ in length, or the output is not finite.
    UsageError
        If an option is out of its range.
    IdentifiabilityError
        If there are too few samples, the input does not excite, or y = 0 explains the data.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.nonlinearities import sine
    >>> u = np.random.default_rng(1).standard_normal(20)
    >>> y = simulate_polynomial([0.0, 0.445, 0.4299], [1.0, -1.03, 0.9048], u)
    >>> (identify_wiener(u, np.sin(y), sine(), order=2).theta.round(6) + 0.0).tolist()
    [-1.03, 0.9048, 0.0, 0.445, 0.4299]
    """
    inputs = np.array(u, dtype=np.float64)
    outputs = np.array(z, dtype=np.float64)
    if inputs.shape != outputs.shape:
        raise DataError(
            f"the input has {inputs.size} samples and the output {outputs.size}: give two sequences of "
            "one length"
        )
    for name, value in (("starts", starts), ("keep", keep), ("node_limit", node_limit)):
        if value < 1:
            raise UsageError(f"{name} is {value}: give at least 1")
    problem = Criterion(inputs, order, normalisation)
    check_excitation(inputs, order)
    preimage = nonlinearity.preimage(outputs)
    kind = preimage.kind
    _refuse_zero(nonlinearity, preimage)
    scale_free = relative if relative is not None else normalisation == "free"
    rng = np.random.default_rng(seed)
    outcome: Outcome
    if kind == "one point":
        outcome = solvers.direct(problem, preimage, scale_free)
    elif kind == "finite sets":
        outcome = solvers.finite_sets(problem, preimage, keep, node_limit)
    elif kind == "boxes":
        outcome = solvers.boxes(problem, preimage, scale_free, starts, rng)
    else:
        outcome = solvers.mixed(problem, preimage, scale_free, starts, region_limit, rng)
    best = outcome.candidates[0]
    return WienerFit(
        theta=best.theta,
        order=order,
        nonlinearity=nonlinearity,
        y=best.y,
        cost=best.cost,
        criterion=best.criterion,
        solver=outcome.solver,
        status=outcome.status,
        exact=outcome.exact,
        effort=outcome.effort,
        preimage=preimage,
        identifiability=identifiability(inputs, best.y, best.theta, order, preimage, normalisation),
        candidates=outcome.candidates,
    )


def naive_fit(u: ArrayLike, z: ArrayLike, order: int) -> Floats:
    """Fit the linear system with the output z taken for y; return theta = [a1 ... an b0 ... bn].

    Examples
    --------
    >>> import numpy as np
    >>> u = np.array([1.0, -1.0, 0.5, 2.0, -0.3, 0.7, 0.1])
    >>> naive_fit(u, np.append(0.0, 0.5 * u[:-1]), 1).round(12) + 0.0
    array([0. , 0. , 0.5])
    """
    return Criterion(np.asarray(u, dtype=np.float64), order).parameters(z)


def _refuse_zero(nonlinearity: KnownMap, preimage: Preimage) -> None:
    """Refuse data that y = 0 explains: then any small enough system does."""
    if np.all(preimage.nearest(np.zeros(preimage.n_samples)) == 0.0) and not preimage.has_no_scale:
        raise IdentifiabilityError(
            f"{nonlinearity.name}: y = 0 explains all {preimage.n_samples} data, so every small enough "
            "system does: use a larger input, until the output leaves the constant region"
        )
