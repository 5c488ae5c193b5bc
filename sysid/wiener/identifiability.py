"""What the data behind a nonlinearity determine of the linear system, and what they only bound."""

from dataclasses import dataclass

import numpy as np

from sysid.nonlinearities.base import Floats
from sysid.nonlinearities.preimages import Preimage
from sysid.wiener.likelihood import simulate

_RANK = 1e-8


@dataclass(frozen=True)
class Identifiability:
    """What the data determine.

    Attributes
    ----------
    gain : bool
        Whether the size of the gain can be had; not if every part of the preimage is a cone (sign).
    gain_sign : bool
        Whether its sign can be had; not if with y also -y explains the data (y^2, absolute value).
    exact_directions, unknowns : int
        Unknowns are theta and the initial state. So many directions of them are fixed by samples whose
        preimage is made of points; the others are only bounded, by constant regions.
    sentence : str
        The same in words.
    """

    gain: bool
    gain_sign: bool
    exact_directions: int
    unknowns: int
    sentence: str


def identifiability(
    u: Floats, y: Floats, theta: Floats, order: int, preimage: Preimage, normalisation: str
) -> Identifiability:
    """Report what can be identified at a solution."""
    free = normalisation == "free"
    gain = not (preimage.has_no_scale and free)
    gain_sign = not (preimage.is_even and free)
    point_samples = np.minimum.reduceat(preimage.is_point, preimage.first[:-1])
    state = initial_state(u, y, theta, order)
    _, sensitivity = simulate(u, theta, state, order)
    rows = np.nan_to_num(sensitivity[:, point_samples].T)
    unknowns = 3 * order + 1 - (0 if free else 1)
    rank = 0
    if rows.size:
        norms = np.linalg.norm(rows, axis=0)
        values = np.linalg.svd(rows / np.where(norms > 0, norms, 1.0), compute_uv=False)
        rank = min(int(np.sum(values > _RANK * values[0])), unknowns)
    parts = []
    if not gain:
        parts.append("the gain is not identifiable: every multiple of y gives the same output")
    if not gain_sign:
        parts.append("the sign of the gain is not identifiable: -y gives the same output")
    if rank < unknowns:
        parts.append(
            f"of {unknowns} unknowns {rank} are fixed by samples without constant region, the others are "
            "bounded"
        )
    sentence = "; ".join(parts) or "all parameters are identifiable"
    return Identifiability(gain, gain_sign, rank, unknowns, sentence)


def initial_state(u: Floats, y: Floats, theta: Floats, order: int) -> Floats:
    """Return the initial state that brings the free run nearest to y, in least squares."""
    forced, sensitivity = simulate(u, theta, np.zeros(order), order)
    responses = sensitivity[2 * order + 1 :]
    # A diverging response would swamp the first samples, which tell the state.
    usable = np.all(np.abs(responses) < 1e6, axis=0) & (np.abs(forced) < 1e9)
    if not usable.any():
        return np.zeros(order)
    found = np.linalg.lstsq(responses[:, usable].T, (y - forced)[usable], rcond=None)[0]
    return np.asarray(found)
