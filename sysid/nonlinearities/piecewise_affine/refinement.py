"""Refinement of a partition into feasible subsystems: which points belong together, which submodels do.

Bemporad, Garulli, Paoletti and Vicino (2005), Section V: a point that one submodel alone explains within
the bound belongs to it; one that several explain is undecided and follows its neighbours; one that none
explains is left out.
"""

import numpy as np
from numpy.typing import NDArray

from sysid._compile import compiled
from sysid.nonlinearities.piecewise_affine.points import Points
from sysid.nonlinearities.piecewise_affine.relaxation import misfit

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

INFEASIBLE, UNDECIDED = -1, -2
LISTED = 48
"""So many nearest neighbours of each point are looked through for decided ones."""


def refined(
    points: Points,
    theta: Floats,
    delta: float,
    *,
    neighbours: int,
    merge: float,
    smallest: int,
    rounds: int,
) -> tuple[Floats, Labels]:
    """Return submodels (modes, n_z + 1, n_w), scaled, and labels; negative ones are not decided.

    Parameters
    ----------
    points : Points
    theta : ndarray
        Submodels to start from.
    delta : float
        Bound, in scaled units.
    neighbours : int
        An undecided point follows the majority of so many decided neighbours.
    merge : float
        Two submodels become one where that one explains their points but for this share.
    smallest : int
        A mode of fewer points is dropped.
    rounds : int
        At most.
    """
    from scipy.spatial import cKDTree

    near = np.asarray(cKDTree(points.z).query(points.z, k=min(LISTED, points.n))[1], dtype=np.intp)
    labels = np.empty(points.n, dtype=np.intp)
    for _ in range(rounds):
        before = theta
        labels = classify(points, theta, delta, near, neighbours)
        theta, labels = _joined(points, theta, labels, delta, merge)
        theta, labels = _without_small(points, theta, labels, smallest)
        if theta.shape == before.shape and np.abs(theta - before).max() <= 1e-9:
            break
    return theta, labels


def classify(points: Points, theta: Floats, delta: float, near: Labels, neighbours: int) -> Labels:
    """Return each point's mode, `INFEASIBLE` or, where its neighbours leave it open, `UNDECIDED`."""
    labels = np.empty(points.n, dtype=np.intp)
    _classify(points.z, points.w, theta, delta, near, neighbours, labels)
    return labels


@compiled
def _classify(
    z: Floats, w: Floats, theta: Floats, delta: float, near: Labels, neighbours: int, labels: Labels
) -> None:
    n, modes = z.shape[0], theta.shape[0]
    fits = np.zeros((n, modes), np.bool_)
    decided = np.empty(n, np.intp)
    for k in range(n):
        count, last = 0, 0
        for i in range(modes):
            fits[k, i] = misfit(z, w, theta[i], k) <= delta
            if fits[k, i]:
                count += 1
                last = i
        decided[k] = last if count == 1 else (INFEASIBLE if count == 0 else UNDECIDED)
        labels[k] = decided[k]
    votes = np.empty(modes, np.intp)
    for k in range(n):
        if decided[k] != UNDECIDED:
            continue
        votes[:] = 0
        cast = 0
        for j in near[k]:
            if decided[j] >= 0 and cast < neighbours:
                votes[decided[j]] += 1
                cast += 1
        best = 0
        for i in range(modes):
            if votes[i] > votes[best]:
                best = i
        if 2 * votes[best] > cast and fits[k, best]:
            labels[k] = best


def _joined(
    points: Points, theta: Floats, labels: Labels, delta: float, merge: float
) -> tuple[Floats, Labels]:
    """Fit each mode anew, and join pairs of modes that one submodel explains as well."""
    modes = theta.shape[0]
    theta = _kept_where_few(points, theta, labels)
    i = 0
    while i < modes - 1:
        for j in range(i + 1, modes):
            both = (labels == i) | (labels == j)
            if not both.any():
                continue
            joint = np.where(both, 0, INFEASIBLE)
            one = points.fitted(joint, 1)[0]
            explained = _within(points, one[0], delta, both)
            apart = _within(points, theta[i], delta, labels == i) + _within(
                points, theta[j], delta, labels == j
            )
            if explained >= (1.0 - merge) * apart:
                labels = np.where(labels == j, i, labels)
                labels = np.where(labels > j, labels - 1, labels)
                theta = np.delete(theta, j, axis=0)
                theta[i] = one[0]
                modes -= 1
                break
        else:
            i += 1
    return theta, labels


def _kept_where_few(points: Points, theta: Floats, labels: Labels) -> Floats:
    fitted, counts = points.fitted(labels, theta.shape[0])
    enough = counts >= points.n_z + 1
    return np.where(enough[:, None, None], fitted, theta)


def _within(points: Points, theta: Floats, delta: float, own: NDArray[np.bool_]) -> int:
    phi = np.column_stack([points.z[own], np.ones(int(own.sum()))])
    return int((np.abs(points.w[own] - phi @ theta).max(axis=1, initial=0.0) <= delta).sum())


def _without_small(points: Points, theta: Floats, labels: Labels, smallest: int) -> tuple[Floats, Labels]:
    """Drop modes of too few points; the largest one stays."""
    counts = np.bincount(labels[labels >= 0], minlength=theta.shape[0])
    keep = counts >= smallest
    keep[int(np.argmax(counts))] = True
    if keep.all():
        return theta, labels
    names = np.where(keep, np.cumsum(keep) - 1, INFEASIBLE)
    return theta[keep], np.where(labels >= 0, names[np.maximum(labels, 0)], labels)
