"""The one-step prediction (4.18) of the examples, written out plainly, and the precision it allows.

Nothing here eliminates a parameter or knows of the estimator: derivatives are taken by differences, so that
bounds and identities found here are independent of what they are held against.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from replications.pepona.setting import EXAMPLES, Example, Floats, Signals, delayed, experiment
from sysid.bounds import least_squares_bound
from sysid.nonlinearities.spline import equal_knots, spline_basis

FIRST = 3
"""Samples before the first one that every example can predict from measured signals."""
LONG = 20_000
"""Samples over which the information of a bound is averaged."""
STEP = 1e-4
"""Of the central differences of fourth order; their error is about the fourth power of it."""


@dataclass(frozen=True, eq=False)
class Predictor:
    """One-step predictions from FIRST on, as functions of the parameters of the system as it runs.

    Attributes
    ----------
    example : Example
    signals : Signals
    """

    example: Example
    signals: Signals

    @property
    def measured(self) -> Floats:
        """The outputs that are predicted."""
        return self.signals.y[FIRST:]

    def internal(self, d: Floats) -> Floats:
        """Return z, eq. (4.10b), or y(k-2) in Example 4.4."""
        if d.size:
            return np.convolve(self.signals.u, np.concatenate([[0.0], d]))[: self.signals.u.size]
        return delayed(delayed(self.signals.y))

    def known(self, parameters: Floats) -> Floats:
        """Return the predictions with the true map; parameters as `theta` orders them."""
        a, b, g, d = self.split(parameters)
        w = self.example.function(self.internal(d))
        return self._combine(a, b, g, w)

    def spline(self, parameters: Floats, coefficients: Floats) -> Floats:
        """Return the predictions with a cubic spline whose knots span the range of z."""
        a, b, g, d = self.split(parameters)
        return self._combine(a, b, g, self.basis(d) @ coefficients)

    def basis(self, d: Floats) -> Floats:
        """Return the B-splines at z; z before FIRST - 1 is made up and never used."""
        z = self.internal(d)
        z[: FIRST - 1] = z[FIRST - 1]
        return spline_basis(z, equal_knots(z, self.example.knots - 1))

    def _combine(self, a: float, b: float, g: float, w: Floats) -> Floats:
        u, y = self.signals.u, self.signals.y
        return (a * delayed(y) + b * delayed(u) + w + g * delayed(w))[FIRST:]

    def split(self, parameters: Floats) -> tuple[float, float, float, Floats]:
        """Return a, b, g and d; those that the example does not have are zero or empty."""
        values = dict(zip(names(self.example), parameters, strict=True))
        d = np.array([values[name] for name in values if name.startswith("d")])
        return values.get("a1", 0.0), values.get("b1", 0.0), values.get("g1", 0.0), d


def names(example: Example) -> tuple[str, ...]:
    """Return the parameters of an example in the order of its table."""
    return example.parameters


def theta(example: Example) -> Floats:
    """Return the true parameters of the system as it runs, in the order of its table."""
    values = {"a1": example.a, "b1": example.b, "g1": example.g}
    values |= {f"d{i + 1}": value for i, value in enumerate(example.d)}
    return np.array([values[name] for name in example.parameters])


def derivatives(function: Callable[[Floats], Floats], point: Floats, step: float = STEP) -> Floats:
    """Return the derivatives of a vector function by differences, shape (n_values, n_parameters)."""
    columns = []
    for direction in np.eye(point.size):
        near, far = (
            function(point + s * direction) - function(point - s * direction) for s in (step, 2 * step)
        )
        columns.append((8.0 * near - far) / (12.0 * step))
    return np.column_stack(columns)


def tangent(example: Example) -> Floats:
    """Return an orthonormal basis of the directions that keep ||d|| = 1, shape (n_parameters, any)."""
    normal = np.array([[0.0 if name[0] != "d" else 1.0] for name in example.parameters])
    normal[:, 0] *= theta(example)
    if not np.any(normal):
        return np.eye(len(example.parameters))
    return np.linalg.svd(normal.T)[2][1:].T


def best_spline(predictor: Predictor) -> Floats:
    """Return the spline coefficients nearest to the true map at the true z."""
    d = np.array(predictor.example.d)
    z = predictor.internal(d)
    z[: FIRST - 1] = z[FIRST - 1]
    return np.asarray(np.linalg.lstsq(predictor.basis(d), predictor.example.function(z), rcond=None)[0])


@cache
def bounds(case: str) -> Mapping[str, Mapping[str, float]]:
    """Return the asymptotic standard deviations of the parameters with the map known and as a spline.

    The information is averaged over a long record and taken for the rows of the example; ||d|| = 1 holds in
    both.  For normal noise these are Cramér-Rao bounds; for uniform noise what least squares attains.
    """
    example = EXAMPLES[case]
    predictor = Predictor(example, experiment(example, LONG, np.random.default_rng(2009)))
    truth, along = theta(example), tangent(example)
    coefficients = best_spline(predictor)
    known = derivatives(predictor.known, truth) @ along
    moved = derivatives(lambda p: predictor.spline(p, coefficients), truth) @ along
    by_coefficient = np.column_stack(
        [
            predictor.spline(truth, unit)
            - predictor._combine(*_dynamics(predictor, truth), 0.0 * predictor.signals.u)
            for unit in np.eye(coefficients.size)
        ]
    )
    found = {}
    for kind, jacobian in (("known", known), ("spline", np.column_stack([moved, by_coefficient]))):
        n = along.shape[1]
        covariance = least_squares_bound([jacobian], example.noise**2, example.samples - FIRST)[:n, :n]
        spread = np.sqrt(np.diag(along @ covariance @ along.T))
        found[kind] = dict(zip(example.parameters, spread.tolist(), strict=True))
    return found


def _dynamics(predictor: Predictor, parameters: Floats) -> tuple[float, float, float]:
    a, b, g, _ = predictor.split(parameters)
    return a, b, g
