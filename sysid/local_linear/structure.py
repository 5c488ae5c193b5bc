"""Sizes and parameters of a composite local linear model, and everything one experiment needs of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import ModelError
from sysid.local_linear import kernels

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Sizes:
    r"""Numbers of a model: n, s, m, l and q of Borges (2006).

    Nonlinear parameters are stacked as :math:`\eta = (A, C, w, c)`, each row by row: A is
    :math:`[A_1 \dots A_s]`; w and c go by local model.  Linear ones are the rows of
    :math:`G = [B_1\,O_1 \dots B_s\,O_s]`, then the initial states if they are estimated.

    Examples
    --------
    >>> Sizes(n_states=3, n_models=4, n_inputs=2, n_outputs=2, n_scheduling=1).n_eta
    50
    """

    n_states: int
    n_models: int
    n_inputs: int
    n_outputs: int
    n_scheduling: int

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 1:
                raise ModelError(f"{name} is {value}: a composite local linear model needs at least 1")

    @property
    def channels(self) -> int:
        """Inputs and the constant, for every local model: rows of p kron (u, 1)."""
        return self.n_models * (self.n_inputs + 1)

    @property
    def n_linear(self) -> int:
        """Entries of G."""
        return self.n_states * self.channels

    @property
    def n_dynamic(self) -> int:
        """Entries of A and C, the part of eta that a change of the state's coordinates moves."""
        return self.n_states * (self.n_states * self.n_models + self.n_outputs)

    @property
    def n_eta(self) -> int:
        """Nonlinear parameters."""
        return self.n_dynamic + 2 * self.n_models * self.n_scheduling

    def pack(self, A: ArrayLike, C: ArrayLike, widths: ArrayLike, centres: ArrayLike) -> Floats:
        """Return eta from A of shape (n_models, n_states, n_states), C, widths and centres."""
        local = np.asarray(A, dtype=float).transpose(1, 0, 2)
        return np.concatenate(
            [np.ravel(np.asarray(part, dtype=float)) for part in (local, C, widths, centres)]
        )

    def unpack(self, eta: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A of shape (n_models, n_states, n_states), C, widths and centres."""
        n, s, p, q = self.n_states, self.n_models, self.n_outputs, self.n_scheduling
        A, C, widths, centres = np.split(eta, np.cumsum([n * n * s, n * p, s * q]))
        local = np.ascontiguousarray(A.reshape(n, s, n).transpose(1, 0, 2))
        return local, C.reshape(p, n), widths.reshape(s, q), centres.reshape(s, q)


@dataclass(frozen=True)
class Experiment:
    """One experiment as the model sees it.

    Attributes
    ----------
    inputs : ndarray, shape (n_samples, n_inputs + 1)
        The inputs and a one.
    scheduling : ndarray, shape (n_samples, n_scheduling)
    """

    inputs: Floats
    scheduling: Floats

    @classmethod
    def of(cls, u: ArrayLike, scheduling: ArrayLike | None = None) -> "Experiment":
        """Make one from inputs; they are the scheduling vector too unless another is given."""
        u = _columns(u)
        phi = u if scheduling is None else _columns(scheduling)
        if phi.shape[0] != u.shape[0]:
            raise ModelError(
                f"the scheduling has {phi.shape[0]} rows and the input {u.shape[0]}: give one row a sample"
            )
        return cls(np.ascontiguousarray(np.column_stack([u, np.ones(u.shape[0])])), np.ascontiguousarray(phi))

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.inputs.shape[0])


def _columns(signal: ArrayLike) -> Floats:
    values = np.asarray(signal, dtype=float)
    return values[:, np.newaxis] if values.ndim == 1 else values


@dataclass(frozen=True)
class Course:
    """What eta makes of one experiment before G is known.

    Attributes
    ----------
    sizes : Sizes
    local, C : ndarray
        A_i, shape (n_models, n_states, n_states), and C.
    weights : ndarray, shape (n_samples, n_models)
    slopes : ndarray, shape (n_samples, 2, n_models, n_scheduling)
        Derivatives of log r_i by widths and by centres.
    A : ndarray, shape (n_samples, n_states, n_states)
        The mixture of the A_i.
    z : ndarray, shape (n_samples, 1, channels)
        p kron (u, 1).
    inputs : ndarray, shape (n_samples, n_inputs + 1)
    """

    sizes: Sizes
    local: Floats
    C: Floats
    weights: Floats
    slopes: Floats
    A: Floats
    z: Floats
    inputs: Floats


def course(sizes: Sizes, eta: Floats, experiment: Experiment) -> Course:
    """Mix the local models over an experiment."""
    n, s = sizes.n_states, sizes.n_models
    local, C, widths, centres = sizes.unpack(np.asarray(eta, dtype=float))
    n_samples = experiment.n_samples
    weights = np.empty((n_samples, s))
    slopes = np.empty((n_samples, 2, s, sizes.n_scheduling))
    kernels.soft_weights(experiment.scheduling, centres, widths, weights, slopes)
    A = (weights @ local.reshape(s, n * n)).reshape(n_samples, n, n)
    z = np.empty((n_samples, 1, sizes.channels))
    kernels.row_products(weights, experiment.inputs, z, 0)
    return Course(sizes, local, np.ascontiguousarray(C), weights, slopes, A, z, experiment.inputs)
