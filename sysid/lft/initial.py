"""First estimates of an LFT model, section 4.3.1 of Pepona (2009), step by step."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Mask
from sysid.errors import IdentifiabilityError
from sysid.lft.problem import LftProblem
from sysid.lft.signals import Data, signals_of, usable_rows
from sysid.lft.structure import LftStructure
from sysid.lft.threads import on_one_thread
from sysid.nonlinearities.spline import Spline, equal_knots

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class InitialEstimate:
    """What each step of the initialisation gives.

    Attributes
    ----------
    a : ndarray, shape (n_a + 1,)
        Coefficients of A, the leading 1 included, step 1.
    b : ndarray, shape (n_b,)
        Coefficients of B in the order of its lags, step 1.
    constant : float
        Mean of w, step 1.
    v : ndarray, shape (n_rows,)
        What A and B leave of y, an estimate of w, step 2.
    d : ndarray, shape (n_taps,)
        Coefficients of D, scaled to length 1, step 3.
    z : ndarray, shape (n_rows,)
        Input of the map, step 4.
    map : Spline
        Fitted to (z, v), step 5.
    g : ndarray, shape (n_g + 1,)
        1, then zeros, step 6.
    """

    a: Floats
    b: Floats
    constant: float
    v: Floats
    d: Floats
    z: Floats
    map: Spline
    g: Floats


@on_one_thread
def initial_estimate(
    data: Data, structure: LftStructure, *, rows: Mask | None = None, centred: bool = False
) -> InitialEstimate:
    """Estimate an LFT model as if its map were the identity, section 4.3.1.

    Parameters
    ----------
    data : Record, or pair of array_like (u, y)
    structure : LftStructure
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    centred : bool
        Whether step 3 has a constant beside the taps.  The source has none, which pulls d
        towards the mean of the taps where they and w have one.

    Raises
    ------
    IdentifiabilityError
        If the rows are too few, or what A and B leave does not depend on any tap.

    Examples
    --------
    >>> import numpy as np
    >>> u = np.random.default_rng(0).uniform(-1, 1, 400)
    >>> y = np.zeros(400)
    >>> y[2:] = np.tanh(0.6 * u[1:-1] + 0.8 * u[:-2])
    >>> start = initial_estimate((u, y), LftStructure(z_lags=(("u", 1), ("u", 2))))
    >>> start.d.round(1)
    array([0.6, 0.8])
    """
    signals = signals_of(data)
    problem = LftProblem.of(signals, structure, usable_rows(signals, structure, rows))
    return first_steps(problem, centred=centred)


def first_steps(problem: LftProblem, *, centred: bool) -> InitialEstimate:
    """Run the steps on the rows of a problem."""
    structure = problem.structure
    linear, v, d = first_direction(problem, centred=centred)
    z = problem.taps[problem.index[:, 0]] @ d
    curve = Spline.fitted(
        z, v, equal_knots(z, structure.knots - 1), degree=structure.degree,
        extrapolation=structure.extrapolation,
    )  # fmt: skip
    a, b = split_linear(problem, linear[:-1])
    g = np.concatenate([[1.0], np.zeros(structure.n_g)])
    return InitialEstimate(a, b, float(linear[-1]), v, d, z, curve, g)


def first_direction(problem: LftProblem, *, centred: bool) -> tuple[Floats, Floats, Floats]:
    """Run steps 1 to 3: return A, B and the constant, what they leave of the output, and d."""
    y, fixed = problem.y, problem.fixed
    ones = np.ones((y.size, 1))
    linear = np.asarray(np.linalg.lstsq(np.column_stack([fixed, ones]), y)[0], dtype=np.float64)
    v = y - fixed @ linear[:-1]
    taps = problem.taps[problem.index[:, 0]]
    weights = np.linalg.lstsq(np.column_stack([taps, ones]) if centred else taps, v)[0][: taps.shape[1]]
    length = float(np.linalg.norm(weights))
    if length == 0.0:
        raise IdentifiabilityError(
            "what A and B leave of the output does not depend on any lag in z: take the shared lags out of "
            "A or B"
        )
    d = np.asarray(weights / length if taps.shape[1] > 1 else np.ones(1), dtype=np.float64)
    return linear, v, d


def split_linear(problem: LftProblem, linear: Floats) -> tuple[Floats, Floats]:
    """Return A with its leading 1, and B, with zeros for lags that were left out."""
    structure = problem.structure
    found = dict(zip(problem.fixed_lags, linear.tolist(), strict=True))
    every = np.array([found.get(lag, 0.0) for lag in structure.linear_lags])
    return np.concatenate([[1.0], every[: structure.n_a]]), every[structure.n_a :]
