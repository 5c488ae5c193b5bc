"""Models and data that the tests of composite local linear models share."""

import numpy as np

from sysid.local_linear import Experiment, LocalLinearModel, Sizes
from sysid.local_linear.passes import regressors
from sysid.local_linear.structure import course

SHAPES = [(3, 4, 2, 2, 2, 60), (1, 1, 1, 1, 1, 30), (2, 2, 1, 3, 1, 40), (5, 3, 2, 2, 1, 80)]
"""States, models, inputs, outputs, scheduling signals, samples."""


def random_case(shape, seed=0, own_scheduling=True):
    """Return sizes, eta and an experiment with stable local models."""
    rng = np.random.default_rng(seed)
    n, s, m, p, q, n_samples = shape
    sizes = Sizes(n, s, m, p, q)
    A = rng.standard_normal((s, n, n))
    A *= 0.7 / np.abs(np.linalg.eigvals(A)).max(axis=1)[:, None, None]
    widths, centres = rng.uniform(0.5, 1.5, (s, q)), rng.uniform(-1, 1, (s, q))
    eta = sizes.pack(A, rng.standard_normal((p, n)), widths, centres)
    u = rng.standard_normal((n_samples, m))
    phi = rng.uniform(-1.5, 1.5, (n_samples, q)) if own_scheduling else None
    return sizes, eta, Experiment.of(u, phi)


def phi_of(sizes, eta, experiment, **options):
    """Return the regressors as a matrix."""
    found = regressors(course(sizes, eta, experiment), **options)
    return found.reshape(-1, found.shape[2])


def random_model(shape, seed=0):
    """Return a model and its inputs and scheduling."""
    sizes, eta, experiment = random_case(shape, seed)
    G = np.random.default_rng(seed + 1).standard_normal((sizes.n_states, sizes.channels))
    return LocalLinearModel.of(sizes, eta, G), experiment.inputs[:, :-1], experiment.scheduling
