"""Weights over the scheduling space."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import UsageError
from sysid.local_linear.model import LocalLinearModel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESOLUTION = 201


def plot_weights(model: LocalLinearModel, scheduling: ArrayLike, axes: "Axes | None" = None) -> "Axes":
    """Draw where each local model is in charge, over the range that a scheduling signal visits.

    One signal: a curve for each weight above the visited values.  Two: contours at a half of each weight over
    the visited points.

    Parameters
    ----------
    model : LocalLinearModel
    scheduling : array_like, shape (n_samples, n_scheduling)
        Visited values.
    axes : matplotlib Axes, optional

    Raises
    ------
    UsageError
        If there are more than two scheduling signals.
    """
    import matplotlib.pyplot as plt

    n_signals = model.sizes.n_scheduling
    if n_signals > 2:
        raise UsageError(f"weights over {n_signals} scheduling signals cannot be drawn: one or two can")
    visited = np.asarray(scheduling, dtype=float).reshape(-1, n_signals)
    if axes is None:
        axes = plt.subplots()[1]
    low, high = visited.min(axis=0), visited.max(axis=0)
    grids = [np.linspace(a, b, RESOLUTION) for a, b in zip(low, high, strict=True)]
    colours = [f"C{i % 10}" for i in range(model.sizes.n_models)]
    if n_signals == 1:
        for i, weights in enumerate(model.weights(grids[0][:, np.newaxis]).T):
            axes.plot(grids[0], weights, color=colours[i], label=f"model {i + 1}")
        axes.plot(visited[:, 0], np.full(visited.shape[0], -0.04), "|", color="0.6", markersize=5)
        axes.set(xlabel="scheduling signal", ylabel="weight", ylim=(-0.08, 1.05))
    else:
        across, up = np.meshgrid(*grids)
        weights = model.weights(np.column_stack([across.ravel(), up.ravel()]))
        axes.plot(visited[:, 0], visited[:, 1], ".", color="0.75", markersize=2)
        for i, colour in enumerate(colours):
            if weights[:, i].min() < 0.5 < weights[:, i].max():
                axes.contour(across, up, weights[:, i].reshape(across.shape), levels=[0.5], colors=[colour])
            axes.plot([], [], color=colour, label=f"model {i + 1}")
        axes.set(xlabel="scheduling signal 1", ylabel="scheduling signal 2")
    axes.legend()
    return axes
