r"""Which parameters of the piecewise affine LFT model data can determine: Lemma 5.1, and what holds.

Adding :math:`\alpha^T z` to every mode changes :math:`G(q) f(z)` by :math:`G(q) \alpha^T z`.  Data cannot
see it where that is a combination of the measured regressors.  Lemma 5.1 asks that no lag of z is a
measured regressor, which suffices; it is not necessary, as *all* lags that G(q) makes must be.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import IdentifiabilityError
from sysid.lft.piecewise import PiecewiseStructure
from sysid.lft.structure import Lag

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Common:
    """A regressor that stands in the linear part and, delayed by G(q), in the map.

    Attributes
    ----------
    column : str
        Such as ``y(k-1)``.
    parameter : str
        Its coefficient in the linear part, such as ``a1``.
    argument : str
        The argument of the map whose delay it is.
    lag : int
        Delay l in G(q): the regressor is an argument of w(k-l).
    """

    column: str
    parameter: str
    argument: str
    lag: int

    def __str__(self) -> str:
        """Say where the column appears."""
        polynomial = "A(q) y" if self.parameter.startswith("a") else "B(q) u"
        delayed = "w(k)" if self.lag == 0 else f"w(k-{self.lag})"
        return f"{self.column} appears in both {polynomial} ({self.parameter}) and {delayed}"


@dataclass(frozen=True)
class Identifiability:
    """What Lemma 5.1 says of a structure, and what is true.

    Attributes
    ----------
    common : tuple of Common
        Regressors common to the linear part and the map: empty is the condition of Lemma 5.1.
    free : ndarray, shape (n_free, n_z + 1)
        Changes of the slopes and the offset, the same in every mode, that the linear part undoes.
    arguments : tuple of str
        Names of the columns of `free`.
    """

    common: tuple[Common, ...]
    free: Floats
    arguments: tuple[str, ...]

    @property
    def lemma(self) -> bool:
        """Whether the condition of Lemma 5.1 holds."""
        return not self.common

    @property
    def identifiable(self) -> bool:
        """Whether data can tell the linear part from the map."""
        return not len(self.free)

    def __str__(self) -> str:
        """Name the columns."""
        listed = "; ".join(str(one) for one in self.common)
        if self.identifiable and self.lemma:
            return "identifiable: no regressor is common to the linear part and the map"
        if self.identifiable:
            return f"identifiable although Lemma 5.1 fails ({listed}): other lags of the argument stand alone"
        names = ", ".join(self.undetermined)
        reason = listed or "G(1) = 0 removes every constant"
        return f"not identifiable: {reason}; the slopes along {names} are not determined"

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Arguments of the map whose coefficients are free."""
        moved = np.abs(self.free).max(axis=0, initial=0.0) > 1e-9
        return tuple(name for name, free in zip(self.arguments, moved, strict=True) if free)


def column_name(lag: Lag) -> str:
    """Return the name of a regressor.

    Examples
    --------
    >>> column_name(("y", 2)), column_name(("u", 0))
    ('y(k-2)', 'u(k)')
    """
    signal, delay = lag
    return f"{signal}(k-{delay})" if delay else f"{signal}(k)"


def identifiability(structure: PiecewiseStructure, g: ArrayLike | None = None) -> Identifiability:
    """Hold a structure against Lemma 5.1 and against the exact condition.

    Parameters
    ----------
    structure : PiecewiseStructure
    g : array_like, shape (n_g,), optional
        Coefficients g_1, ...; without them what holds for almost all.

    Examples
    --------
    Example 5.1, Eq. (5.14), with z(k) = (y(k-1), u(k-1)), and as (5.15):

    >>> print(identifiability(PiecewiseStructure(0, (1,), 0, (("y", 1), ("u", 1)))))
    not identifiable: u(k-1) appears in both B(q) u (b1) and w(k); the slopes along u(k-1) are not determined
    >>> print(identifiability(PiecewiseStructure(0, (1,), 0, (("y", 2), ("u", 2)))))
    identifiable: no regressor is common to the linear part and the map
    """
    filter_ = np.concatenate([[1.0], _generic(structure.n_g) if g is None else np.asarray(g, dtype=float)])
    known: dict[Lag, str] = {("y", i): f"a{i}" for i in range(1, structure.n_a + 1)}
    known |= {("u", delay): f"b{delay}" for delay in structure.b_lags}
    common = [
        Common(
            column_name((signal, delay + lag)), known[signal, delay + lag], column_name((signal, delay)), lag
        )
        for signal, delay in structure.z_lags
        for lag in range(structure.n_g + 1)
        if (signal, delay + lag) in known and filter_[lag] != 0.0
    ]
    arguments = (*(column_name(lag) for lag in structure.z_lags), "1")
    return Identifiability(tuple(common), _free(structure, filter_, known), arguments)


def require_identifiable(structure: PiecewiseStructure) -> None:
    """Refuse a structure whose linear part and map cannot be told apart.

    Raises
    ------
    IdentifiabilityError
        With the columns that appear twice, and the remedy.
    """
    found = identifiability(structure)
    if not found.identifiable:
        listed = "; ".join(str(one) for one in found.common)
        raise IdentifiabilityError(
            f"{listed}: no data can tell the two apart; take {', '.join(found.undetermined)} out of z_lags, "
            "or the column out of the linear part"
        )


def _generic(n_g: int) -> Floats:
    """Coefficients that fulfil no polynomial equation by accident."""
    return np.random.default_rng(5).uniform(0.3, 0.9, n_g)


def _free(structure: PiecewiseStructure, filter_: Floats, known: dict[Lag, str]) -> Floats:
    """Return a basis of the common changes of theta that the measured regressors undo."""
    reached = {(s, d + lag) for s, d in structure.z_lags for lag in range(filter_.size)} - set(known)
    place = {lag: i for i, lag in enumerate(sorted(reached))}
    effect = np.zeros((len(place) + 1, len(structure.z_lags) + 1))
    for j, (signal, delay) in enumerate(structure.z_lags):
        for lag, coefficient in enumerate(filter_):
            if (signal, delay + lag) in place:
                effect[place[signal, delay + lag], j] = coefficient
    effect[-1, -1] = filter_.sum()  # the constant, which no measured regressor makes
    _, sizes, directions = np.linalg.svd(effect)
    rank = int(np.sum(sizes > 1e-10 * max(1.0, float(np.abs(filter_).max()))))
    return np.asarray(directions[rank:])
