"""Composite local linear state-space models: weights and simulation in the user's units."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import DataError, ModelError
from sysid.local_linear import kernels
from sysid.local_linear.structure import Experiment, Sizes, course

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class LocalLinearModel:
    r"""A composite local linear model, (1)-(4) of Borges, Verdult and Ayala Botto (2005).

    .. math:: x_{k+1} = \sum_i p_i(\phi_k) (A_i x_k + B_i u_k + O_i), \qquad y_k = C x_k

    with normalised radial-basis weights :math:`p_i \propto \exp(-\|W_i (\phi - c_i)\|^2)`.

    Attributes
    ----------
    A : ndarray, shape (n_models, n_states, n_states)
    B : ndarray, shape (n_models, n_states, n_inputs)
    O : ndarray, shape (n_models, n_states)
    C : ndarray, shape (n_outputs, n_states)
    centres, widths : ndarray, shape (n_models, n_scheduling)
        Centres in the unit of the scheduling signal; widths are reciprocal: a larger one is narrower.

    Raises
    ------
    ModelError
        If shapes do not match or a value is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> model = LocalLinearModel(A=[[[0.5]], [[0.9]]], B=[[[1.0]], [[0.2]]], O=[[0.0], [0.0]], C=[[1.0]],
    ...     centres=[[-1.0], [1.0]], widths=[[1.0], [1.0]])
    >>> model.weights([[0.0], [3.0]]).round(4)
    array([[0.5, 0.5],
           [0. , 1. ]])
    >>> model.simulate(np.ones(3)).round(4).ravel()
    array([0.    , 0.2144, 0.4058])
    """

    A: Floats
    B: Floats
    O: Floats  # noqa: E741
    C: Floats
    centres: Floats
    widths: Floats

    def __post_init__(self) -> None:
        for name in ("A", "B", "O", "C", "centres", "widths"):
            values = np.array(getattr(self, name), dtype=float)
            if not np.all(np.isfinite(values)):
                raise ModelError(f"{name} holds a value that is not finite: give finite matrices")
            object.__setattr__(self, name, values)
        s, n = self.A.shape[0], self.A.shape[-1]
        expected = {"A": (s, n, n), "B": (s, n, -1), "O": (s, n), "C": (-1, n), "centres": (s, -1)}
        expected["widths"] = self.centres.shape
        for name, shape in expected.items():
            found = getattr(self, name).shape
            matches = len(found) == len(shape) and all(
                wanted in (-1, size) for wanted, size in zip(shape, found, strict=True)
            )
            if not matches:
                wanted = tuple("any" if size == -1 else size for size in shape)
                raise ModelError(f"{name} has shape {found}: give {wanted} to go with A of {self.A.shape}")

    @property
    def sizes(self) -> Sizes:
        """Numbers of states, local models, inputs, outputs and scheduling signals."""
        s, n, m = self.B.shape
        return Sizes(n, s, m, self.C.shape[0], self.centres.shape[1])

    @property
    def eta(self) -> Floats:
        """Nonlinear parameters."""
        return self.sizes.pack(self.A, self.C, self.widths, self.centres)

    @property
    def G(self) -> Floats:
        """The linear parameters [B_1 O_1 ... B_s O_s], shape (n_states, channels)."""
        return np.hstack([np.column_stack(pair) for pair in zip(self.B, self.O, strict=True)])

    @classmethod
    def of(cls, sizes: Sizes, eta: Floats, G: Floats) -> "LocalLinearModel":
        """Make one from its parameters."""
        A, C, widths, centres = sizes.unpack(eta)
        blocks = G.reshape(sizes.n_states, sizes.n_models, -1).transpose(1, 0, 2)
        return cls(A, blocks[:, :, :-1], blocks[:, :, -1], C, centres, widths)

    def weights(self, scheduling: ArrayLike) -> Floats:
        """Return the weights p_i, shape (n_samples, n_models), of scheduling (n_samples, n_scheduling)."""
        phi = np.ascontiguousarray(self._checked(scheduling, self.sizes.n_scheduling, "scheduling"))
        weights = np.empty((phi.shape[0], self.sizes.n_models))
        slopes = np.empty((phi.shape[0], 2, *self.centres.shape))
        kernels.soft_weights(phi, self.centres, self.widths, weights, slopes)
        return weights

    def simulate(
        self, u: ArrayLike, scheduling: ArrayLike | None = None, start: ArrayLike | None = None
    ) -> Floats:
        """Simulate the outputs from inputs alone.

        Parameters
        ----------
        u : array_like, shape (n_samples,) or (n_samples, n_inputs)
        scheduling : array_like, shape (n_samples, n_scheduling), optional
            The inputs by default.
        start : array_like, shape (n_states,), optional
            x(0), zero by default.

        Returns
        -------
        ndarray, shape (n_samples, n_outputs)
            Not finite from where on the model diverges.

        Raises
        ------
        DataError
            If a signal has another number of channels than the model, or a value that is not finite.
        """
        from sysid.local_linear.passes import fly

        inputs = self._checked(u, self.sizes.n_inputs, "u")
        phi = inputs if scheduling is None else scheduling
        experiment = Experiment.of(inputs, self._checked(phi, self.sizes.n_scheduling, "scheduling"))
        begin = np.zeros(self.sizes.n_states) if start is None else np.asarray(start, dtype=float)
        with np.errstate(all="ignore"):
            flight = fly(course(self.sizes, self.eta, experiment), self.G, begin)
            return np.asarray(flight.x[:-1] @ self.C.T)

    @staticmethod
    def _checked(signal: ArrayLike, channels: int, name: str) -> Floats:
        values = np.asarray(signal, dtype=float)
        values = values[:, np.newaxis] if values.ndim == 1 else values
        if values.ndim != 2 or values.shape[1] != channels:
            raise DataError(f"{name} has shape {values.shape}: the model takes (n_samples, {channels})")
        bad = np.argwhere(~np.isfinite(values))
        if bad.size:
            row, column = bad[0]
            raise DataError(
                f"{name} is {values[row, column]} at row {row}, channel {column}: fill or leave it out"
            )
        return values

    def __repr__(self) -> str:
        sizes = self.sizes
        return (
            f"LocalLinearModel({sizes.n_models} local models of order {sizes.n_states}, {sizes.n_inputs} "
            f"inputs, {sizes.n_outputs} outputs, {sizes.n_scheduling} scheduling signals)"
        )
