"""A diagnosed linear model apart from its record."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.export.saved_effects import DIVERGES, SavedEffect
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.parameters import equation_text
from sysid.diagnosis.linear.rows import Data
from sysid.errors import ModelError

SCHEMA = 1
KIND = "sysid-linear-model"


@dataclass(frozen=True)
class SavedModel:
    """A linear model with effects, apart from the record it was fitted to.

    Attributes
    ----------
    a, b : tuple of float
        Coefficients a1, ..., an and b1, ..., bn.
    constant : float
    period : float
        Sampling period [s].
    effects : tuple of SavedEffect
    """

    a: tuple[float, ...]
    b: tuple[float, ...]
    constant: float
    period: float
    effects: tuple[SavedEffect, ...]

    @property
    def order(self) -> int:
        """Degree of A."""
        return len(self.a)

    @property
    def rest(self) -> Floats:
        """Initial state of a run from rest, shape (order,)."""
        return np.zeros(self.order)

    def parameters(self) -> list[tuple[str, float, str]]:
        """Return name, value and unit of each coefficient."""
        named = [(f"a{i}", value) for i, value in enumerate(self.a, 1)]
        named += [(f"b{i}", value) for i, value in enumerate(self.b, 1)]
        return [(name, value, "") for name, value in [*named, ("constant", self.constant)]]

    def equation(self) -> str:
        """Return the difference equation with its effects, for a reader."""
        laws = [(effect.choice.written, effect.parameters) for effect in self.effects]
        return equation_text(self.order, True, self.chain()[1], laws)

    def visited(self, u: ArrayLike) -> Floats:
        """Return states from which a search for an initial one may begin besides rest: none is needed."""
        return np.empty((0, self.order))

    def simulate(self, u: ArrayLike, start: ArrayLike | None = None) -> Floats:
        """Return the free run for an input, shape (n_samples,), from rest or from a state (order,)."""
        signal = np.array(u, dtype=np.float64).ravel()
        chain, point = self.chain(self.rest if start is None else start)
        begin = np.array([0, signal.size])
        data = Data(signal, np.zeros(signal.size), np.ones(signal.size, dtype=bool), begin, self.period)
        run = chain.run(data, point)
        if run is None:
            raise ModelError(DIVERGES)
        return run.y

    def chain(self, start: ArrayLike | None = None) -> tuple[Chain, Floats]:
        """Return what simulates one experiment, and its point."""
        state = () if start is None else np.asarray(start, dtype=np.float64)
        choices = [effect.choice for effect in self.effects]
        own = [value for effect in self.effects for value in effect.values]
        chain = Chain(self.order, choices, constant=True, free_start=start is not None)
        return chain, np.array([*self.a, *self.b, self.constant, *state, *own])

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "kind": KIND,
            "schema": SCHEMA,
            "period": self.period,
            "a": list(self.a),
            "b": list(self.b),
            "constant": self.constant,
            "effects": [effect.to_json() for effect in self.effects],
        }
