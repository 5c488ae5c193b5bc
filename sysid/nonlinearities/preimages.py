"""What an output tells about the input of a known static map: points, intervals and unions of them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid._compile import compiled
from sysid.errors import DataError, ModelError
from sysid.nonlinearities.base import Floats

Indices = NDArray[np.int64]

TOUCHING = 1e-12
"""Parts of a preimage closer than this, relative to their size, are one."""


class Parts(NamedTuple):
    """Candidate parts of the preimages, one column a piece of the map, in ascending order.

    Each has shape (n_samples, n_pieces); ``valid`` tells which parts exist, ``weight`` is the density
    |dy/dz| of a point and of no use for an interval.
    """

    lower: Floats
    upper: Floats
    weight: Floats
    valid: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Preimage:
    r"""The sets :math:`\mathcal N^{-1}(z_k)`, each a finite union of intervals; points have length zero.

    Attributes
    ----------
    first : ndarray of int, shape (n_samples + 1,)
        The parts of sample k are ``first[k]`` to ``first[k + 1] - 1``, ascending.
    lower, upper : ndarray, shape (n_parts,)
        Ends of the parts; infinite where a part has none.
    weight : ndarray, shape (n_parts,)
        :math:`|dy/dz|` at a point: its share in the likelihood of z.
    moved : ndarray of int
        Samples whose datum lay outside the range and was replaced by the nearest point of the range.

    Examples
    --------
    >>> from sysid.nonlinearities import DEAD_ZONE, PiecewiseAffine
    >>> PiecewiseAffine.of(DEAD_ZONE, 1.0).preimage([0.0, 2.0])
    Preimage of 2 samples: boxes (1 of them points), 1 regions, 0 data moved into the range
    """

    first: Indices
    lower: Floats
    upper: Floats
    weight: Floats
    moved: Indices

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return self.first.size - 1

    @property
    def counts(self) -> Indices:
        """Number of parts of each sample, shape (n_samples,)."""
        return np.diff(self.first)

    @property
    def is_point(self) -> NDArray[np.bool_]:
        """Which parts are points, shape (n_parts,)."""
        return np.asarray(self.lower == self.upper)

    @property
    def kind(self) -> str:
        """``one point``, ``boxes`` (one part each), ``finite sets`` (points only) or ``mixed``."""
        single, points = bool(np.all(self.counts == 1)), bool(np.all(self.is_point))
        if points:
            return "one point" if single else "finite sets"
        return "boxes" if single else "mixed"

    @property
    def log10_regions(self) -> float:
        """Decimal logarithm of the number R of regions, the product of the numbers of parts."""
        return float(np.sum(np.log10(self.counts)))

    @property
    def regions(self) -> str:
        """The number of regions as text, rounded where it is large."""
        power = self.log10_regions
        return f"{10**power:.0f}" if power < 6 else f"{10 ** (power % 1):.1f}e{int(power)}"

    @property
    def has_no_scale(self) -> bool:
        """Whether every part ends at 0 or infinity only, so that no multiple of y can be told from y."""
        ends = np.concatenate([self.lower, self.upper])
        return bool(np.all((ends == 0.0) | np.isinf(ends)))

    @property
    def is_even(self) -> bool:
        """Whether with y also -y explains every datum."""
        for k in range(self.n_samples):
            part = slice(self.first[k], self.first[k + 1])
            lower, upper = self.lower[part], self.upper[part]
            finite = np.concatenate([lower, upper])
            size = float(np.max(np.abs(finite[np.isfinite(finite)]), initial=1.0))
            if not np.allclose(lower, -upper[::-1], rtol=0.0, atol=1e-9 * size):
                return False
        return True

    def nearest(self, y: Floats) -> Floats:
        """Return the point of each preimage nearest to y, shape (n_samples,)."""
        return nearest_points(self.first, self.lower, self.upper, np.ascontiguousarray(y, dtype=np.float64))

    def __repr__(self) -> str:
        points = int(np.sum(self.is_point))
        return (
            f"Preimage of {self.n_samples} samples: {self.kind} ({points} of them points), "
            f"{self.regions} regions, {self.moved.size} data moved into the range"
        )


class KnownMap(ABC):
    """A static nonlinearity z = N(y) that is known, together with its preimages.

    Attributes
    ----------
    name : str
        Name for messages and tables.
    """

    name: str

    @abstractmethod
    def __call__(self, y: ArrayLike) -> Floats:
        """Return z, in the shape of ``y``."""

    @abstractmethod
    def _parts(self, z: Floats) -> Parts:
        """Return the parts of the preimage of data in the range."""

    @abstractmethod
    def _into_range(self, z: Floats) -> Floats:
        """Return the nearest point of the range."""

    def preimage(self, z: ArrayLike) -> Preimage:
        """Return the preimage of each datum; a datum outside the range is moved to its nearest point.

        Parameters
        ----------
        z : array_like, shape (n_samples,)

        Raises
        ------
        DataError
            If a datum is not finite or the data are not one sequence.
        ModelError
            If a datum has no preimage although the nearest point of the range was taken.
        """
        data = checked_data(self.name, z)
        inside = self._into_range(data)
        parts = self._parts(inside)
        first, lower, upper, weight = gather(
            np.ascontiguousarray(parts.lower),
            np.ascontiguousarray(parts.upper),
            np.ascontiguousarray(parts.weight),
            np.ascontiguousarray(parts.valid),
            TOUCHING,
        )
        empty = np.flatnonzero(np.diff(first) == 0)
        if empty.size:
            k = int(empty[0])
            raise ModelError(
                f"{self.name}: the value {data[k]:g} of sample {k} has no preimage: check the pieces of the "
                "nonlinearity or widen its domain"
            )
        size = np.maximum(np.abs(data), 1.0)
        return Preimage(first, lower, upper, weight, np.flatnonzero(np.abs(inside - data) > 1e-9 * size))


def checked_data(what: str, z: ArrayLike) -> Floats:
    """Return measured outputs as one finite sequence."""
    data = np.array(z, dtype=np.float64)
    if data.ndim != 1:
        raise DataError(f"{what}: the output has shape {data.shape}; give one sequence (n_samples,)")
    bad = np.flatnonzero(~np.isfinite(data))
    if bad.size:
        raise DataError(
            f"{what}: the output of sample {int(bad[0])} is {data[bad[0]]}: remove the sample and those "
            "before it, or fill it"
        )
    return data


@compiled
def gather(
    lower: Floats, upper: Floats, weight: Floats, valid: NDArray[np.bool_], touching: float
) -> tuple[Indices, Floats, Floats, Floats]:
    """Collect the valid parts sample by sample; parts that touch become one."""
    n_samples, n_pieces = lower.shape
    first = np.zeros(n_samples + 1, dtype=np.int64)
    low, high, share = (
        np.empty(n_samples * n_pieces),
        np.empty(n_samples * n_pieces),
        np.empty(n_samples * n_pieces),
    )
    count = 0
    for k in range(n_samples):
        start = count
        for i in range(n_pieces):
            if not valid[k, i]:
                continue
            bottom = lower[k, i]
            if count > start and bottom - high[count - 1] <= touching * max(1.0, abs(bottom)):
                high[count - 1] = max(high[count - 1], upper[k, i])
                share[count - 1] = max(share[count - 1], weight[k, i])
            else:
                low[count], high[count], share[count] = bottom, upper[k, i], weight[k, i]
                count += 1
        first[k + 1] = count
    # Two pieces may give the same point with different roundings.
    for i in range(count):
        if high[i] - low[i] <= touching * max(1.0, min(abs(low[i]), abs(high[i]))):
            high[i] = low[i]
    return first, low[:count].copy(), high[:count].copy(), share[:count].copy()


@compiled
def nearest_points(first: Indices, lower: Floats, upper: Floats, y: Floats) -> Floats:
    """Return the point of each union nearest to y."""
    found = np.empty(y.shape[0])
    for k in range(y.shape[0]):
        best = np.inf
        for i in range(first[k], first[k + 1]):
            point = min(max(y[k], lower[i]), upper[i])
            if abs(point - y[k]) < best:
                best = abs(point - y[k])
                found[k] = point
    return found
