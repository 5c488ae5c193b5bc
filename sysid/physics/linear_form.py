"""Models linear in state and input: exact discretisation, with derivatives by the parameters."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid.linear.forms import Floats
from sysid.physics.expressions import ZERO, Evaluator, Expression, derivative, substitute, symbols
from sysid.physics.model import Model

Entry = tuple[int, int, Expression]


@dataclass(frozen=True)
class LinearForm:
    """Matrices [A B c] of x' = A x + B u + c and [C D e] of y = C x + D u + e, as expressions.

    Attributes
    ----------
    n_states, n_inputs, n_outputs : int
    rates, outputs : tuple of (row, column, expression)
        Entries other than zero.
    rate_slopes, output_slopes : tuple of tuple of (row, column, expression)
        Their derivatives by each of the chosen parameters.
    """

    n_states: int
    n_inputs: int
    n_outputs: int
    rates: tuple[Entry, ...]
    outputs: tuple[Entry, ...]
    rate_slopes: tuple[tuple[Entry, ...], ...]
    output_slopes: tuple[tuple[Entry, ...], ...]

    def matrices(self, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Return [A B c; 0] and [C D e]."""
        width = self.n_states + self.n_inputs + 1
        found = iter(self._entries(values))
        return (
            _filled(self.rates, found, (width, width)),
            _filled(self.outputs, found, (self.n_outputs, width)),
        )

    def slopes(self, values: Mapping[str, float]) -> tuple[Floats, Floats]:
        """Return the derivatives of both by each of the chosen parameters, on the first axis."""
        width, count = self.n_states + self.n_inputs + 1, len(self.rate_slopes)
        found = iter(self._entry_slopes(values))
        rates = [_filled(entries, found, (width, width)) for entries in self.rate_slopes]
        outputs = [_filled(entries, found, (self.n_outputs, width)) for entries in self.output_slopes]
        return (
            np.array(rates).reshape(count, width, width),
            np.array(outputs).reshape(count, self.n_outputs, width),
        )

    @cached_property
    def _entries(self) -> Evaluator:
        return Evaluator([expression for *_, expression in (*self.rates, *self.outputs)])

    @cached_property
    def _entry_slopes(self) -> Evaluator:
        entries = (entry for part in (*self.rate_slopes, *self.output_slopes) for entry in part)
        return Evaluator([expression for *_, expression in entries])


def linear_form(model: Model, parameters: Sequence[str]) -> LinearForm | None:
    """Return the matrices of a model, or None if it is not linear in state and input."""
    variables = [item.name for item in (*model.states, *model.inputs)]
    rates = _entries(model.reduced_rates(), variables)
    outputs = _entries(model.reduced_outputs(), variables)
    if rates is None or outputs is None:
        return None
    return LinearForm(
        n_states=len(model.states),
        n_inputs=len(model.inputs),
        n_outputs=len(model.outputs),
        rates=rates,
        outputs=outputs,
        rate_slopes=tuple(_slopes(rates, name) for name in parameters),
        output_slopes=tuple(_slopes(outputs, name) for name in parameters),
    )


def _entries(expressions: Sequence[Expression], variables: Sequence[str]) -> tuple[Entry, ...] | None:
    found: list[Entry] = []
    at_zero = dict.fromkeys(variables, ZERO)
    for row, expression in enumerate(expressions):
        for column, name in enumerate(variables):
            slope = derivative(expression, name)
            if symbols(slope) & set(variables):
                return None
            found.append((row, column, slope))
        found.append((row, len(variables), substitute(expression, at_zero)))
    return tuple(entry for entry in found if entry[2] != ZERO)


def _slopes(entries: tuple[Entry, ...], name: str) -> tuple[Entry, ...]:
    slopes = ((row, column, derivative(expression, name)) for row, column, expression in entries)
    return tuple(entry for entry in slopes if entry[2] != ZERO)


@dataclass(frozen=True)
class Discrete:
    """Matrices of the recursion, and their derivatives by the parameters, stacked on the first axis."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    A_slopes: Floats
    B_slopes: Floats
    C_slopes: Floats
    D_slopes: Floats


def discretise(form: LinearForm, values: Mapping[str, float], period: float, *, slopes: bool) -> Discrete:
    """Return the exact recursion for an input held between samples.

    The state, the input and a constant 1 form one vector; the exponential of its generator M holds
    A and B.  That of [[M, dM], [0, M]] holds their derivatives in its upper right block.
    """
    from scipy.linalg import expm

    n, m = form.n_states, form.n_inputs
    size = n + m + 1
    M, output = form.matrices(values)
    M *= period
    dM, d_output = np.empty((0, size, size)), np.empty((0, form.n_outputs, size))
    if slopes:
        dM, d_output = form.slopes(values)
    count = dM.shape[0]
    F, dF = np.full((size, size), np.nan), np.full((count, size, size), np.nan)
    if np.isfinite(M).all() and np.isfinite(dM).all():
        with np.errstate(all="ignore"):
            if count:
                paired = np.zeros((count, 2 * size, 2 * size))
                paired[:, :size, :size] = paired[:, size:, size:] = M
                paired[:, :size, size:] = dM * period
                both = expm(paired)
                F, dF = both[0, :size, :size], both[:, :size, size:]
            else:
                F = expm(M)
    return Discrete(
        *(F[:n, :n].copy(), F[:n, n:].copy(), output[:, :n].copy(), output[:, n:].copy()),
        *(dF[:, :n, :n].copy(), dF[:, :n, n:].copy(), d_output[..., :n].copy(), d_output[..., n:].copy()),
    )


def _filled(entries: tuple[Entry, ...], values: Iterator[float], shape: tuple[int, int]) -> Floats:
    """Return a matrix whose entries are the next values."""
    matrix = np.zeros(shape)
    for row, column, _ in entries:
        matrix[row, column] = next(values)
    return matrix
