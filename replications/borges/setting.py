"""What the paper's experiment is made of."""

import numpy as np
from numpy.typing import NDArray

from sysid.local_linear import Experiment, Problem, Sizes
from sysid.local_linear.problem import Jacobian
from sysid.local_linear.search import linear_starts

Floats = NDArray[np.float64]

SAMPLES = 1000
N_STATES, N_MODELS, N_INPUTS, N_OUTPUTS = 3, 4, 2, 2
WEIGHTS_FROM, WEIGHTS_TO = -1.0, 1.0
"""Interval in which centres and widths start."""

HALF_WIDTH = 1.0
"""Inputs are uniform on [-1, 1], the range of Narendra and Parthasarathy: with normal inputs of variance one,
which the paper may mean, the system diverges."""

NOISE = {"noise-free": 0.0, "20-dB": 0.1}
"""Standard deviation of the noise over that of each output."""


def sizes(q: int) -> Sizes:
    """Return the numbers of the model; q = 1 schedules by the first input, q = 2 by both."""
    return Sizes(N_STATES, N_MODELS, N_INPUTS, N_OUTPUTS, q)


def narendra(u: Floats) -> Floats:
    """Return the outputs of the system of Section 4 from rest, shape (n_samples, 2)."""
    y = np.zeros((u.shape[0], 2))
    before = 0.0
    for k in range(u.shape[0] - 1):
        (y1, y2), (u1, u2) = y[k], u[k]
        bottom = 2.0 + y2**2
        y[k + 1, 0] = (0.8 * y1**3 + u1**2 * u2) / bottom
        y[k + 1, 1] = (y1 + y1 * y2 + (before - 0.5) * (u2 + 0.8)) / bottom
        before = u1
    return y


def experiment(
    rng: np.random.Generator, noise: str, n_samples: int = SAMPLES
) -> tuple[Floats, Floats, Floats]:
    """Return inputs, outputs with noise and without."""
    u = rng.uniform(-HALF_WIDTH, HALF_WIDTH, (n_samples, N_INPUTS))
    clean = narendra(u)
    y = clean + NOISE[noise] * clean.std(axis=0) * rng.standard_normal(clean.shape)
    return u, y, clean


def problem_of(u: Floats, y: Floats, q: int, jacobian: Jacobian = "kaufman") -> Problem:
    """Return the search problem of a data set."""
    used = np.ones(u.shape[0], dtype=bool)
    return Problem(sizes(q), [Experiment.of(u, u[:, :q])], [y], [used], jacobian=jacobian)


def start(problem: Problem, rng: np.random.Generator) -> Floats:
    """Return the start of Section 4: PI-MOESP for every local model, weights uniform on [-1, 1]."""
    A, C = linear_starts(problem)[1]
    shape = (N_MODELS, problem.sizes.n_scheduling)
    widths, centres = rng.uniform(WEIGHTS_FROM, WEIGHTS_TO, (2, *shape))
    return problem.sizes.pack(np.repeat(A[np.newaxis], N_MODELS, axis=0), C, widths, centres)


def diverging_share(runs: int = 50) -> float:
    """Return the share of experiments with normal inputs of variance one in which the system diverges."""
    rng, gone = np.random.default_rng(5), 0
    with np.errstate(all="ignore"):
        for _ in range(runs):
            y = narendra(rng.standard_normal((SAMPLES, N_INPUTS)))
            gone += bool(not np.isfinite(y).all() or np.abs(y).max() > 1e6)
    return gone / runs


def numbers() -> dict[str, float]:
    """Return the set-up as the studies use it, under the names of the claims."""
    one = sizes(1)
    step = narendra(np.array([[0.0, 0.0], [0.0, 0.0]]))
    return {
        "setting/samples": float(SAMPLES),
        "setting/local-models": float(one.n_models),
        "setting/order": float(one.n_states),
        "setting/inputs": float(one.n_inputs),
        "setting/outputs": float(one.n_outputs),
        "setting/eta": float(one.n_eta),
        "setting/eta/q2": float(sizes(2).n_eta),
        "setting/theta": float(one.n_linear),
        "setting/weights-from": WEIGHTS_FROM,
        "setting/weights-to": WEIGHTS_TO,
        "setting/first-output": float(step[1, 1]),
        "setting/diverging_share": diverging_share(),
    }
