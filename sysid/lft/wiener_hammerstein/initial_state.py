"""The initial state of a Wiener-Hammerstein model, estimated on the first rows of an experiment."""

import numpy as np

from sysid.data.record import Mask
from sysid.lft.between_samples import HALF_LENGTH
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.linear.forms import Floats
from sysid.linear.kernels import kautz_columns
from sysid.linear.simulation import simulate_polynomial
from sysid.separable.descent import levenberg_marquardt

# A free response is followed until this share of its energy is left, over so many rows at most.
DEAD_ENERGY = 1e-12
LONGEST = 20_000
EVALUATIONS = 30


def run_from(model: WienerHammerstein, u: Floats, y: Floats, used: Mask, rms: float) -> Floats:
    """Simulate one experiment, its initial state estimated on its first rows.

    Both blocks start from the steady state of the first input and a free response besides.  A few rows do not
    determine a state of high order, so the estimate is a Bayesian one: the model's error is known from its
    fit, and before anything is measured a free response over the whole experiment is held to be no larger
    than the block's output itself.

    Parameters
    ----------
    model : WienerHammerstein
    u, y : ndarray, shape (n_rows,)
    used : ndarray of bool, shape (n_rows,)
        Rows whose output is compared, as far as a free response reaches.
    rms : float
        Root mean square of the model's error.
    """
    front, back = free_responses(model.front, u.size), free_responses(model.back, u.size)
    n1, length = front.shape[0], max(front.shape[1], back.shape[1])
    rows = used[:length] & np.isfinite(y[:length])
    if not rows.any():
        return model.simulate(u)
    first = u[: length + 2 * HALF_LENGTH]  # a map between samples looks ahead
    front, back = _padded(front, u.size), _padded(back, u.size)
    near_front, near_back = front[:, : first.size], back[:, :length][:, rows]
    z = model.map_input(first)
    sizes = np.concatenate(
        [np.full(n1, np.std(z)), np.full(back.shape[0], np.std(y[:length][rows]))]
    ) * np.sqrt(u.size)
    ridge = np.diag(rms / np.maximum(sizes, 1e-300))

    def residual(x: Floats) -> Floats:
        output = model.simulate(first, x[:n1] @ near_front)[:length][rows] + x[n1:] @ near_back
        return np.concatenate([output - y[:length][rows], ridge @ x])

    def jacobian(x: Floats) -> Floats:
        # The map at samples gives the derivative closely enough: the cost decides which steps are taken.
        slope = model.map.slope(z + x[:n1] @ near_front)
        through = [simulate_polynomial(model.back.b, model.back.a, slope * row) for row in near_front]
        forced = np.reshape(through, (n1, first.size))[:, :length][:, rows]
        return np.vstack([np.vstack([forced, near_back]).T, ridge])

    x = levenberg_marquardt(residual, jacobian, np.zeros(sizes.size), max_evaluations=EVALUATIONS).x
    return np.asarray(model.simulate(u, x[:n1] @ front) + x[n1:] @ back)


def free_responses(block: LinearBlock, n_rows: int) -> Floats:
    """Return the responses to the states of a block, of unit norm, until they have died out.

    Parameters
    ----------
    block : LinearBlock
    n_rows : int
        Length at most.

    Returns
    -------
    ndarray, shape (order, length)
    """
    impulse = np.zeros(min(n_rows, LONGEST))
    impulse[:1] = 1.0
    responses = np.zeros((block.order, impulse.size))
    a1, a2 = block.sections
    kautz_columns(impulse, a1, a2, block.order, np.zeros((a1.size, 2)), responses)
    responses /= np.maximum(np.linalg.norm(responses, axis=1, keepdims=True), 1e-300)
    left = np.cumsum((responses**2).sum(axis=0)[::-1])[::-1]
    return responses[:, : int(np.sum(left > DEAD_ENERGY))]


def _padded(responses: Floats, n_rows: int) -> Floats:
    return np.pad(responses, ((0, 0), (0, n_rows - responses.shape[1])))
