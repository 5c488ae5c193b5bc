"""Separators of labelled points: multicategory linear programming, or a support vector machine."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sysid.errors import UsageError
from sysid.nonlinearities.piecewise_affine.kernels import fill_clusters
from sysid.nonlinearities.piecewise_affine.points import regions_of

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

Separation = Literal["linear-programming", "svm"]

MOST_PIECES = 4
"""A mode that no convex region holds is cut into so many pieces at a time, at most."""


def separators(z: Floats, labels: Labels, classes: int, method: Separation) -> Floats:
    """Return affine functions, the greatest of which tells the class, shape (classes, n_z + 1).

    Parameters
    ----------
    z : ndarray, shape (n_points, n_z)
        Scaled.
    labels : ndarray of int, shape (n_points,)
        Each class occurs.
    classes : int
    method : {"linear-programming", "svm"}
        The second one needs scikit-learn.
    """
    if classes == 1:
        return np.zeros((1, z.shape[1] + 1))
    if method == "linear-programming":
        return by_linear_programming(z, labels, classes)
    if method == "svm":
        return by_support_vectors(z, labels, classes)
    raise UsageError(f"separation is {method!r}; choose 'linear-programming' or 'svm'")


def by_linear_programming(z: Floats, labels: Labels, classes: int) -> Floats:
    """Separate by the linear programme of Bennett and Mangasarian (1994).

    It minimises the mean violation, class by class, of (c_i - c_j) phi >= 1 over all points of class i and
    all other classes j.  Solved in its dual form, of few equations and many bounded unknowns: the
    separators are the multipliers of the equations.
    """
    from scipy.optimize import linprog
    from scipy.sparse import csr_array

    solve: Any = linprog  # its stubs know no matrix of bounds

    n, n_z = z.shape
    phi = np.column_stack([z, np.ones(n)])
    p = n_z + 1
    # The separators matter up to a common function: the first one is zero.
    rival = np.array([[j for j in range(classes) if j != i] for i in range(classes)])[labels]
    pairs = n * (classes - 1)
    column = np.arange(pairs)
    point = np.repeat(np.arange(n), classes - 1)
    rows, columns, values = [], [], []
    for classes_of, sign in ((np.repeat(labels, classes - 1), 1.0), (rival.ravel(), -1.0)):
        kept = classes_of > 0
        rows.append(((classes_of[kept] - 1)[:, None] * p + np.arange(p)).ravel())
        columns.append(np.repeat(column[kept], p))
        values.append(sign * phi[point[kept]].ravel())
    matrix = csr_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
        shape=((classes - 1) * p, pairs),
    )
    limit = 1.0 / np.bincount(labels, minlength=classes)[labels[point]]
    found = solve(
        -np.ones(pairs),
        A_eq=matrix,
        b_eq=np.zeros(matrix.shape[0]),
        bounds=np.column_stack([np.zeros(pairs), limit]),
        method="highs-ds",
    )
    rest = -np.asarray(found.eqlin.marginals).reshape(classes - 1, p)
    return np.concatenate([np.zeros((1, p)), rest])


def by_support_vectors(z: Floats, labels: Labels, classes: int) -> Floats:
    """Separate by linear support vector machines of scikit-learn, all classes at once."""
    try:
        from sklearn.svm import LinearSVC
    except ImportError as error:
        raise UsageError(
            "separation 'svm' needs scikit-learn, which is not installed; install sysid with the extra "
            "`svm`, or take 'linear-programming', which needs nothing more"
        ) from error
    if classes > 2:
        machine = LinearSVC(C=10.0, multi_class="crammer_singer", max_iter=100_000, random_state=0)
    else:
        machine = LinearSVC(C=10.0, dual=False, max_iter=100_000)
    machine.fit(z, labels)
    rows = np.column_stack([machine.coef_, machine.intercept_])
    return np.concatenate([np.zeros((1, rows.shape[1])), rows]) if classes == 2 else rows


def separated(
    z: Floats, labels: Labels, modes: int, method: Separation, rng: np.random.Generator, tolerated: float
) -> tuple[Floats, Labels]:
    """Return separators and the mode of each region, with several regions for a mode where need be.

    Where more than the tolerated share of the points lies in regions of other modes, a mode is cut into
    parts by its points' places, as long as that halves the number of misplaced points.
    """
    owners = np.arange(modes)
    parts = labels.copy()
    rows = separators(z, parts, modes, method)
    while owners.size < 2 * modes + 1:
        wrong = regions_of(z, rows) != parts
        if wrong.mean() <= tolerated:
            break
        best, fewest = None, int(wrong.sum()) // 2
        counts = np.bincount(parts[wrong], minlength=owners.size)
        for part in np.argsort(-counts, kind="stable")[:2]:
            own = np.flatnonzero(parts == part)
            for pieces in range(2, MOST_PIECES + 1):
                piece = _clusters(z[own], pieces, rng)
                if np.bincount(piece, minlength=pieces).min() < z.shape[1] + 2:
                    continue
                cut, grown = parts.copy(), np.append(owners, np.full(pieces - 1, owners[part]))
                cut[own] = np.where(piece > 0, owners.size + piece - 1, part)
                trial = separators(z, cut, grown.size, method)
                left = int((grown[regions_of(z, trial)] != labels).sum())
                if left <= fewest:
                    best, fewest = (cut, trial, grown), left - 1
        if best is None:
            break
        parts, rows, owners = best
    return rows, owners


def _clusters(z: Floats, count: int, rng: np.random.Generator) -> Labels:
    """Part points by k-means, the best of a few starts; a cluster may be empty."""
    best, kept = np.inf, np.zeros(z.shape[0], dtype=np.intp)
    for _ in range(5):
        first = rng.choice(z.shape[0], min(count, z.shape[0]), replace=False)
        nearest = np.zeros(z.shape[0], dtype=np.intp)
        total = fill_clusters(z, z[first], 30, nearest)
        if total < best:
            best, kept = total, nearest
    return kept
