"""Random plants of known structure, and their simulation with effects inside."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sysid.demonstration.kernels import (
    FORCE_SIZE,
    difference_response,
    mechanics_response,
    tanks_response,
)
from sysid.errors import UsageError

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

MODELS = {
    "difference-equation": "linear",
    "dc-motor": "dc-motor",
    "mass-spring-damper": "mass-spring-damper",
    "two-mass": "two-mass",
    "two-tanks": "two-tanks",
    "positioning-stage": "positioning-stage",
}
"""Family of plants -> the model a user would fit to it."""

_STEP = 0.08  # Runge-Kutta step times the fastest pole: the local error is then below 1e-7 of the state
_LEAST_SUBSTEPS = 8


@dataclass(frozen=True)
class Inside:
    """Effects inside a plant; the defaults are none.

    Attributes
    ----------
    force : ndarray, shape (FORCE_SIZE,)
        As `sysid.demonstration.kernels` lists them.
    gain, scale : float
        The input is multiplied by 1 + gain tanh(output / scale).
    root : bool
        Outflow with the square root of the level.
    rim : float
        Level at which a tank overflows.
    """

    force: Floats = field(default_factory=lambda: np.zeros(FORCE_SIZE))
    gain: float = 0.0
    scale: float = 1.0
    root: bool = False
    rim: float = math.inf


@dataclass(frozen=True)
class Plant:
    """A plant with its true parameters.

    Attributes
    ----------
    family : str
        A key of `MODELS`.
    parameters : mapping of str to float
        True values; for a difference equation a1, a2, ... and b1, b2, ....
    period : float
        Sampling period [s].
    """

    family: str
    parameters: Mapping[str, float]
    period: float

    @property
    def order(self) -> int:
        """Order of the linear plant."""
        return self._numerator.size if self.family == "difference-equation" else len(self.dynamics[0])

    @property
    def _numerator(self) -> Floats:
        return np.array([value for name, value in self.parameters.items() if name.startswith("b")])

    @property
    def _denominator(self) -> Floats:
        return np.array([value for name, value in self.parameters.items() if name.startswith("a")])

    @property
    def dynamics(self) -> tuple[Floats, Floats]:
        """Matrix A and column B of the continuous-time plant."""
        p = self.parameters
        if self.family == "mass-spring-damper":
            return np.array([[0.0, 1.0], [-p["k"] / p["m"], -p["c"] / p["m"]]]), np.array([0.0, 1.0 / p["m"]])
        if self.family == "positioning-stage":
            return np.array([[0.0, 1.0], [0.0, -p["F_v"] / p["M"]]]), np.array([0.0, 1.0 / p["M"]])
        if self.family == "dc-motor":
            matrix = [[-p["b"] / p["J"], p["K"] / p["J"]], [-p["K"] / p["L"], -p["R"] / p["L"]]]
            return np.array(matrix), np.array([0.0, 1.0 / p["L"]])
        if self.family == "two-mass":
            first = [-(p["k1"] + p["k2"]), -(p["c1"] + p["c2"]), p["k2"], p["c2"]]
            second = [p["k2"], p["c2"], -p["k2"], -p["c2"]]
            matrix = [
                [0.0, 1.0, 0.0, 0.0],
                [x / p["m1"] for x in first],
                [0.0, 0.0, 0.0, 1.0],
                [x / p["m2"] for x in second],
            ]
            return np.array(matrix), np.array([0.0, 1.0 / p["m1"], 0.0, 0.0])
        matrix = [[-p["a1"], 0.0], [p["a1"], -p["a2"]]]
        return np.array(matrix), np.array([p["b"], 0.0])

    @property
    def poles(self) -> Complexes:
        """Poles of the sampled linear plant, shape (order,)."""
        if self.family == "difference-equation":
            return np.asarray(np.roots(np.r_[1.0, self._denominator]), complex)
        return np.asarray(np.exp(np.linalg.eigvals(self.dynamics[0]) * self.period), complex)

    @property
    def bandwidth(self) -> float:
        """Where the gain has fallen: the natural frequency of the slowest pole not at 1 [rad/sample]."""
        rates = np.abs(np.log(self.poles[np.abs(self.poles - 1.0) > 1e-6]))
        return float(np.clip(rates.min(), 0.03, 1.5))

    @property
    def rubbing(self) -> tuple[tuple[int, int, int], float]:
        """Places of position, velocity and output among the states, and one over the mass that rubs."""
        p = self.parameters
        mass = {"mass-spring-damper": "m", "positioning-stage": "M", "dc-motor": "J", "two-mass": "m1"}
        places = (0, 0, 0) if self.family == "dc-motor" else (0, 1, 0)
        return places, 1.0 / p[mass[self.family]]

    def response(self, u: Floats, inside: Inside | None = None) -> Floats:
        """Simulate the noise-free output from rest, shape (n_samples,)."""
        inside = inside or Inside()
        gain = np.array([inside.gain, inside.scale])
        u = np.ascontiguousarray(u, np.float64)
        if self.family == "difference-equation":
            return difference_response(self._denominator, self._numerator, u, inside.force, gain)
        matrix, column = self.dynamics
        fastest = float(np.abs(np.linalg.eigvals(matrix)).max())
        substeps = max(_LEAST_SUBSTEPS, math.ceil(fastest * self.period / _STEP))
        if self.family == "two-tanks":
            p = self.parameters
            outflow = np.array([p["a1"], p["a2"]])
            return tanks_response(outflow, p["b"], inside.root, inside.rim, u, self.period, substeps, gain)
        places, inverse_mass = self.rubbing
        return mechanics_response(
            matrix, column, np.array(places), inverse_mass, u, self.period, substeps, inside.force, gain
        )

    def motion(self, u: Floats) -> tuple[Floats, Floats, Floats]:
        """Simulate position, velocity and driving force of the body that rubs, without effects."""
        if self.family == "two-tanks":
            raise UsageError("the two tanks have no body that rubs; ask a mechanical plant for its motion.")
        if self.family == "difference-equation":
            y = self.response(u)
            return y, np.diff(y, prepend=0.0), u
        from scipy.signal import cont2discrete, dlsim

        matrix, column = self.dynamics
        n = len(matrix)
        system = (matrix, column[:, np.newaxis], np.eye(n), np.zeros((n, 1)))
        states = dlsim(cont2discrete(system, self.period), u)[1]
        position, velocity, _ = self.rubbing[0]
        drive = self.parameters["K"] * states[:, 1] if self.family == "dc-motor" else u
        return states[:, position], states[:, velocity], np.asarray(drive)


def draw_plant(rng: np.random.Generator, family: str, order: int | None = None) -> Plant:
    """Draw a plant of a family.

    Parameters
    ----------
    rng : numpy.random.Generator
    family : str
        A key of `MODELS`.
    order : int, optional
        Of a difference equation; drawn from 1 to 3, mostly 2, when it is not given.

    Raises
    ------
    UsageError
        If the family is unknown.

    Examples
    --------
    >>> plant = draw_plant(np.random.default_rng(0), "dc-motor")
    >>> sorted(plant.parameters), bool(np.all(np.abs(plant.poles) < 1))
    (['J', 'K', 'L', 'R', 'b'], True)
    """
    if family not in MODELS:
        raise UsageError(f"the family {family!r} is unknown; choose from {', '.join(MODELS)}.")
    if family == "difference-equation":
        return _difference_equation(rng, order or int(rng.choice([1, 2, 2, 2, 2, 3])))
    parameters = {name: rounded(value) for name, value in _parameters(rng, family).items()}
    unit = Plant(family, parameters, 1.0)
    rates = np.linalg.eigvals(unit.dynamics[0])
    dominant = float(np.abs(rates[np.abs(rates) > 1e-9]).min())
    return Plant(family, parameters, rounded(float(rng.uniform(0.12, 0.4)) / dominant))


def rounded(value: float, digits: int = 4) -> float:
    """Return a number as short as a person would write it."""
    return float(f"{value:.{digits}g}")


def _difference_equation(rng: np.random.Generator, order: int) -> Plant:
    poles: list[complex] = []
    while len(poles) < order:
        if order - len(poles) >= 2 and rng.random() < 0.6:
            pole = rng.uniform(0.6, 0.95) * np.exp(1j * rng.uniform(0.1, 1.0))
            poles += [pole, np.conj(pole)]
        else:
            poles.append(complex(rng.uniform(0.4, 0.95)))
    a = np.real(np.poly(poles))[1:]
    # A numerator whose gain at rest is not nearly zero, scaled to a gain of about one there.
    while True:
        b = rng.standard_normal(order) + 0.3
        if abs(b.sum()) > 0.5 * np.abs(b).sum():
            break
    b *= rng.uniform(0.7, 1.4) * (1.0 + a.sum()) / b.sum()
    names = [f"a{i}" for i in range(1, order + 1)] + [f"b{i}" for i in range(1, order + 1)]
    return Plant("difference-equation", dict(zip(names, map(float, [*a, *b]), strict=True)), 1.0)


def _parameters(rng: np.random.Generator, family: str) -> dict[str, float]:
    def around(value: float) -> float:
        return float(value * np.exp(rng.uniform(-0.5, 0.5)))

    if family == "dc-motor":
        return {"J": around(0.35), "b": around(0.2), "K": around(1.0), "L": around(0.1), "R": around(1.2)}
    if family == "mass-spring-damper":
        m, k = around(1.0), around(4.0)
        return {"m": m, "c": float(2.0 * rng.uniform(0.08, 0.7) * math.sqrt(k * m)), "k": k}
    if family == "two-mass":
        m1, k1, m2 = around(1.0), around(4.0), around(0.6)
        k2 = k1 * float(rng.uniform(0.8, 2.5))
        c1 = float(2.0 * rng.uniform(0.08, 0.3) * math.sqrt(k1 * m1))
        c2 = float(2.0 * rng.uniform(0.05, 0.2) * math.sqrt(k2 * m2))
        return {"m1": m1, "c1": c1, "k1": k1, "m2": m2, "c2": c2, "k2": k2}
    if family == "two-tanks":
        return {"a1": around(0.05), "a2": around(0.04), "b": around(0.05)}
    return {"M": around(1.0), "F_v": around(1.5), "gain": 1.0, "offset": 0.0}
