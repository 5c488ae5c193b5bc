"""From composite parameters back to the linear system and the nonlinearity, and what cannot be had."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import IdentifiabilityError, UsageError
from sysid.recursive.base import Floats, Snapshot

if TYPE_CHECKING:
    from sysid.nonlinearities.segment import Segments

Normalisation = Literal["first", "unit-norm"]
Structure = Literal["general", "dead-zone", "preload", "symmetric"]

SMALLEST_FIRST = 1e-9
"""b_1 below this share of the norm of b cannot be made 1."""
SAME_SLOPE = 1e-9
"""Slopes that differ by less than this share are equal: they determine no symmetric dead zone."""

_NEEDS = {
    "general": "",
    "dead-zone": "without preload (L1 = L2 = 0), eq. (3.18a)",
    "preload": "without dead zone (D1 = D2 = 0), eq. (3.18b)",
    "symmetric": "with D1 = -D2, L1 = -L2 and K1 != K2, eq. (3.18c)",
}


@dataclass(frozen=True)
class RankOne:
    """The decomposition M = b d^T.

    Attributes
    ----------
    b : ndarray, shape (order,)
    d : ndarray, shape (n_levels,)
    ratio : float
        Second singular value over the first: how far M is from rank one.
    """

    b: Floats
    d: Floats
    ratio: float


def rank_one(composite: ArrayLike, normalisation: Normalisation = "first") -> RankOne:
    """Decompose mu_ij = b_i d_j by singular values, eqs. (3.12) and (4.5).

    Parameters
    ----------
    composite : array_like, shape (order, n_levels)
        The matrix M.  If it is not of rank one, the nearest such matrix is taken.
    normalisation : {"first", "unit-norm"}
        b_1 = 1, or (3.10): norm 1 and the largest element positive.

    Returns
    -------
    RankOne

    Raises
    ------
    IdentifiabilityError
        If M is zero, or b_1 is zero and shall be one.
    UsageError
        If the normalisation is unknown.

    Examples
    --------
    >>> rank_one([[1.0, 2.0], [-2.0, -4.0]]).d
    array([1., 2.])
    >>> rank_one([[1.0, 2.0], [-2.0, -4.0]], "unit-norm").b.round(4)
    array([-0.4472,  0.8944])
    """
    if normalisation not in ("first", "unit-norm"):
        raise UsageError(f"there is no normalisation {normalisation!r}: use 'first' or 'unit-norm'")
    matrix = np.atleast_2d(np.asarray(composite, dtype=np.float64))
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    if not singular[0] > 0.0:
        raise IdentifiabilityError(
            "the composite parameters are all zero, so they hold neither b nor d: drive the input longer"
        )
    b, d = left[:, 0], singular[0] * right[0]
    if normalisation == "first":
        if abs(b[0]) < SMALLEST_FIRST:
            raise IdentifiabilityError(
                f"b_1 is {b[0]:.1e} of the norm of b, so it cannot be made 1: use the normalisation "
                "'unit-norm'"
            )
        b, d = b / b[0], d * b[0]
    else:
        sign = float(np.sign(b[np.argmax(np.abs(b))]))
        b, d = sign * b, sign * d
    return RankOne(b, d, float(singular[1] / singular[0]) if singular.size > 1 else 0.0)


@dataclass(frozen=True)
class HammersteinParameters:
    """What the composite parameters tell about the plant.

    Attributes
    ----------
    a, b : ndarray, shape (order,)
        Coefficients of the linear system.
    d : ndarray, shape (n_levels,)
        F(V_j) / V_j.
    K1, K2, H1, H2 : float
        Slopes and offsets of the positive and the negative segment, (3.16) and (3.17).
    D1, D2, L1, L2 : float
        Ends of the dead zone and preloads; NaN where they are not identifiable.
    structure, normalisation : str
        What was assumed.
    ratio : float
        Second over first singular value of M: small when the model holds.
    note : str
        What is not identifiable, and why; empty when everything is.
    """

    a: Floats
    b: Floats
    d: Floats
    K1: float
    K2: float
    H1: float
    H2: float
    D1: float
    D2: float
    L1: float
    L2: float
    structure: Structure
    normalisation: Normalisation
    ratio: float
    note: str

    @property
    def segments(self) -> "Segments":
        """The nonlinearity as a map.

        Raises
        ------
        IdentifiabilityError
            If D and L are not identifiable.
        """
        from sysid.nonlinearities.segment import Segments

        values = (self.D1, self.D2, self.L1, self.L2)
        if not all(map(math.isfinite, values)):
            raise IdentifiabilityError(self.note)
        return Segments(self.K1, self.K2, *values)

    def transfer_function(self, period: float = 1.0) -> Any:
        """Return B/A as a python-control transfer function of the sampling period [s]."""
        import control

        return control.tf([*self.b], [1.0, *self.a], period)


def recover(
    snapshot: Snapshot, structure: Structure = "general", normalisation: Normalisation = "first"
) -> HammersteinParameters:
    """Recover B, the segments and, where the structure allows it, dead zones and preloads.

    Parameters
    ----------
    snapshot : Snapshot
        Of any `Recursive` estimator; two levels or more on either side of zero.
    structure : {"general", "dead-zone", "preload", "symmetric"}
        What is known of the nonlinearity.  Each side of F shows only its line K v + H; with both a dead
        zone and a preload, H = L - K D holds two unknowns.
    normalisation : {"first", "unit-norm"}
        See `rank_one`.  The gain of b and the values of F share one factor; D does not depend on it.

    Returns
    -------
    HammersteinParameters

    Raises
    ------
    IdentifiabilityError
        If M is zero or a side of zero has fewer than two levels.
    UsageError
        If the structure or the normalisation is unknown.

    Examples
    --------
    >>> theta = np.array([0.5, -1.0, 0.5, 0.5, 1.0])  # n = 1: a_1 and d_1 .. d_4 with b_1 = 1
    >>> found = recover(Snapshot(0, theta, 1, (-4.0, -2.0, 2.0, 4.0)), "dead-zone")
    >>> round(found.K1, 12), round(found.H1, 12), round(found.D1, 12)
    (1.5, -2.0, 1.333333333333)
    """
    if structure not in _NEEDS:
        raise UsageError(f"there is no structure {structure!r}: use one of {', '.join(_NEEDS)}")
    found = rank_one(snapshot.composite, normalisation)
    levels = np.array(snapshot.levels)
    K1, H1 = _line(levels, found.d, levels > 0, "positive")
    K2, H2 = _line(levels, found.d, levels < 0, "negative")
    D1, D2, L1, L2, note = _breaks(structure, K1, K2, H1, H2)
    return HammersteinParameters(
        snapshot.a.copy(), found.b, found.d, K1, K2, H1, H2, D1, D2, L1, L2, structure, normalisation,
        found.ratio, note,
    )  # fmt: skip


def _line(levels: Floats, d: Floats, side: Any, name: str) -> tuple[float, float]:
    """Slope and offset of one segment; through two points exactly (3.16), (3.17)."""
    v, x = levels[side], (d * levels)[side]
    if v.size < 2:
        raise IdentifiabilityError(
            f"the {name} side has {v.size} input levels, a line needs 2: choose levels beyond the dead zone "
            "on both sides"
        )
    if v.size == 2:
        return float((x[1] - x[0]) / (v[1] - v[0])), float((v[1] * x[0] - v[0] * x[1]) / (v[1] - v[0]))
    slope, offset = np.polyfit(v, x, 1)
    return float(slope), float(offset)


def _breaks(
    structure: Structure, K1: float, K2: float, H1: float, H2: float
) -> tuple[float, float, float, float, str]:
    """D1, D2, L1, L2 and what cannot be had, by (3.18)."""
    nan, scale = math.nan, max(abs(K1), abs(K2))
    if structure == "preload":
        return 0.0, 0.0, H1, H2, ""
    if structure == "dead-zone":
        D1 = -H1 / K1 if abs(K1) > SAME_SLOPE * scale else nan
        D2 = -H2 / K2 if abs(K2) > SAME_SLOPE * scale else nan
        lost = [name for name, value in (("D1", D1), ("D2", D2)) if math.isnan(value)]
        note = f"{' and '.join(lost)} not identifiable: the slope of that side is zero" if lost else ""
        return D1, D2, 0.0, 0.0, note
    if structure == "symmetric":
        if abs(K1 - K2) <= SAME_SLOPE * scale:
            note = "D and L are not identifiable: with K1 = K2 the two sides give one equation twice"
            return nan, nan, nan, nan, note
        D = (H1 + H2) / (K2 - K1)
        L = K1 * D + H1
        return D, -D, L, -L, ""
    ways = "; ".join(f"'{name}' {words}" for name, words in _NEEDS.items() if words)
    note = (
        "D1, D2, L1, L2 are not identifiable: each side shows only H = L - K D, one equation in two "
        f"unknowns; they follow for a structure {ways}"
    )
    return nan, nan, nan, nan, note
