"""Models linear in state and input: exact discretisation, with derivatives by the parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.linear.forms import Floats
from sysid.physics.expressions import ZERO, Expression, derivative, evaluate, substitute, symbols
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
    M = _filled(form.rates, values, (size, size)) * period
    output = _filled(form.outputs, values, (form.n_outputs, size))
    count = len(form.rate_slopes) if slopes else 0
    dM = np.array([_filled(entries, values, (size, size)) for entries in form.rate_slopes[:count]])
    d_output = np.array(
        [_filled(entries, values, (form.n_outputs, size)) for entries in form.output_slopes[:count]]
    ).reshape(count, form.n_outputs, size)
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


def _filled(entries: tuple[Entry, ...], values: Mapping[str, float], shape: tuple[int, int]) -> Floats:
    matrix = np.zeros(shape)
    for row, column, expression in entries:
        matrix[row, column] = evaluate(expression, values)
    return matrix
