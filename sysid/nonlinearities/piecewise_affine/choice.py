"""How many modes a bound on the error needs, and the bound at the knee of that curve."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import UsageError
from sysid.nonlinearities.piecewise_affine.points import Points
from sysid.nonlinearities.piecewise_affine.subsystems import USUAL, PartitionSearch, subsystems

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ModesAgainstDelta:
    """Number of modes of the bounded-error procedure for several bounds.

    Attributes
    ----------
    deltas : ndarray, shape (n_deltas,)
        Ascending, in the unit of w.
    modes : ndarray of int, shape (n_deltas,)
    unexplained : ndarray, shape (n_deltas,)
        Share of the points that no submodel explains within the bound.
    """

    deltas: Floats
    modes: Labels
    unexplained: Floats

    @property
    def knee(self) -> float:
        """The bound where the curve bends most; see `knee`."""
        return knee(self.deltas, self.modes)

    def __repr__(self) -> str:
        lines = ["    delta  modes  unexplained"]
        for delta, count, share in zip(self.deltas, self.modes, self.unexplained, strict=True):
            mark = "  <- knee" if delta == self.knee else ""
            lines.append(f"{delta:9.4g} {count:6d} {share:12.1%}{mark}")
        return "\n".join(lines)


def modes_against_delta(
    z: ArrayLike,
    w: ArrayLike,
    deltas: ArrayLike,
    *,
    rng: np.random.Generator,
    runs: int = 1,
    search: PartitionSearch = USUAL,
) -> ModesAgainstDelta:
    """Return how many modes explain the points within each bound (figure 5.3 of Pepona).

    Parameters
    ----------
    z, w, rng, search
        As in `bounded_error`.
    deltas : array_like, shape (n_deltas,)
        Bounds; equally spaced logarithms show the knee best.
    runs : int
        The least number of modes of so many runs counts, for the search is random.

    Raises
    ------
    UsageError, IdentifiabilityError
        If the bounds or the points cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> z = rng.uniform(-1, 1, 400)
    >>> w = np.where(z > 0.3, 1.0 - z, z) + rng.uniform(-0.05, 0.05, 400)
    >>> curve = modes_against_delta(z, w, [0.02, 0.06, 0.1, 0.8], rng=rng)
    >>> curve.modes[1:], curve.knee
    (array([2, 2, 1]), 0.06)
    """
    bounds = np.unique(np.asarray(deltas, dtype=np.float64))
    if not bounds.size or not (np.isfinite(bounds).all() and bounds[0] > 0.0):
        raise UsageError(f"modes against delta: deltas are {bounds.tolist()}; give numbers > 0")
    if runs < 1:
        raise UsageError(f"modes against delta: runs is {runs}; give 1 at least")
    points = Points.of(z, w, who="modes against delta")
    modes, unexplained = [], []
    for delta in bounds:
        found = [subsystems(points, float(delta), rng, search) for _ in range(runs)]
        best = min(found, key=lambda one: one.theta.shape[0])
        modes.append(best.theta.shape[0])
        unexplained.append(best.unexplained)
    return ModesAgainstDelta(bounds, np.array(modes), np.array(unexplained))


def knee(deltas: ArrayLike, modes: ArrayLike) -> float:
    """Return the bound at the knee of the curve of modes against bounds.

    On logarithmic axes it is the point farthest below the straight line between the curve's ends, the
    smallest such bound where several are; at a bound where the random search found more modes than at a
    smaller one, the smaller number counts.

    Parameters
    ----------
    deltas, modes : array_like, shape (n_deltas,)

    Examples
    --------
    >>> knee([0.1, 0.2, 0.4, 0.8, 1.6], [12, 5, 2, 2, 1])
    0.4
    """
    bounds, counts = np.asarray(deltas, dtype=np.float64), np.asarray(modes, dtype=np.float64)
    if bounds.shape != counts.shape or bounds.ndim != 1 or bounds.size < 2:
        raise UsageError(
            f"knee: deltas of shape {bounds.shape} and modes of shape {counts.shape} were given; give "
            "two bounds at least, and a number of modes for each"
        )
    if bounds.min() <= 0.0 or counts.min() < 1 or np.unique(bounds).size < bounds.size:
        raise UsageError("knee: give different bounds > 0, and one mode at least for each")
    order = np.argsort(bounds)
    across = np.log(bounds[order] / bounds[order[0]])
    down = np.log(np.minimum.accumulate(counts[order]))
    line = down[0] + (down[-1] - down[0]) * across / across[-1]
    below = line - down
    best = int(np.flatnonzero(below >= below.max() - 1e-12)[0])
    return float(bounds[order[best]])


def plot_modes_against_delta(curve: ModesAgainstDelta, axes: "Axes | None" = None) -> "Axes":
    """Draw the number of modes against the bound, with the knee (figure 5.3 of Pepona).

    Parameters
    ----------
    curve : ModesAgainstDelta
    axes : matplotlib.axes.Axes, optional
        New ones unless given.
    """
    from matplotlib.ticker import MaxNLocator

    if axes is None:
        from matplotlib.figure import Figure

        axes = Figure(figsize=(5.0, 3.2), layout="constrained").subplots()
    axes.plot(curve.deltas, curve.modes, "o-", color="C0", markersize=4)
    if curve.deltas.size > 1:
        here = int(curve.modes[curve.deltas == curve.knee][0])
        axes.plot([curve.knee], [here], "o", color="C3", markersize=9, fillstyle="none")
        axes.annotate(
            f"knee: {here} modes at {curve.knee:.3g}",
            (curve.knee, here),
            xytext=(8, 8),
            textcoords="offset points",
            color="C3",
        )
    axes.set_xscale("log")
    axes.set_xlabel("bound on the error δ")
    axes.set_ylabel("number of modes")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    return axes
