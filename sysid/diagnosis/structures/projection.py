"""What is left of signals once others have taken up what they can."""

import numpy as np

from sysid.diagnosis.effects.base import Floats

# Directions that the others already span to this share are left out.
DEPENDENT = 1e-7
LEAST = float(np.sqrt(DEPENDENT))


def orthonormal(columns: Floats, besides: Floats | None = None, *, least: float = LEAST) -> Floats:
    """Return an orthonormal basis of the span of columns, that of ``besides`` projected out.

    Of columns scaled to unit length, singular values below the share ``least`` of the largest count as none.
    """
    with np.errstate(all="ignore"):  # a slope that runs off has no length, and is left out
        size = np.linalg.norm(columns, axis=0)
    columns = columns[:, (size > 0.0) & np.isfinite(size)]
    if columns.shape[1] == 0:
        return columns
    columns = columns / np.linalg.norm(columns, axis=0)
    if besides is not None and besides.shape[1]:
        for _ in range(2):  # twice is enough for orthogonality to rounding
            columns = without(columns, besides)
        size = np.linalg.norm(columns, axis=0)
        columns = columns[:, size > DEPENDENT] / size[size > DEPENDENT]
    if columns.shape[1] < 2:
        return columns
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(U[:, s > least * s[0]])


def without(columns: Floats, Q: Floats) -> Floats:
    """Return columns, or one, with what an orthonormal basis spans projected out."""
    return np.asarray(columns - Q @ (Q.T @ columns))
