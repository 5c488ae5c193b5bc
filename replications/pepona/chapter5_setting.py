"""What the examples of Chapter 5 are made of: systems, signals, starts, and how their tables name them."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from replications.paper import claims_of
from sysid.claims import read
from sysid.lft import PiecewiseLft, PiecewiseStructure
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap

Floats = NDArray[np.float64]

THRESHOLD = 1e-3
"""The stopping threshold gamma of every example."""


@dataclass(frozen=True)
class Example:
    """One example of Section 5.4.

    Attributes
    ----------
    case : str
        Its number in the text.
    title : str
    structure : PiecewiseStructure
    linear : tuple of float
        True a, b, g; the signs of the text are those of ``A(q) = 1 + a1 q^-1``.
    theta : tuple of tuple of float
        True submodels; the first one holds where h' (z, 1) <= 0.
    h : tuple of float
        The true boundary, its last entry 1 (for a scalar z: ``(1, -tau)``).
    samples : int
    input, noise : float
        Half widths of the uniform input and noise.
    start : tuple of float or None
        Start of the linear part; None for the linear model with a constant, (5.27).
    deltas : tuple of float
        Bounds of the map stage in iteration 1, 2, ...; the last one stays.
    """

    case: str
    title: str
    structure: PiecewiseStructure
    linear: tuple[float, ...]
    theta: tuple[tuple[float, ...], ...]
    h: tuple[float, ...]
    samples: int
    input: float
    noise: float
    start: tuple[float, ...] | None
    deltas: tuple[float, ...]

    @cached_property
    def model(self) -> PiecewiseLft:
        """The true system."""
        separators = np.vstack([np.zeros(len(self.h)), self.h])
        return PiecewiseLft.of(
            self.structure, self.linear, PiecewiseAffineMap(np.array(self.theta), separators)
        )

    @cached_property
    def true(self) -> Mapping[str, float]:
        """True values by the names of the tables."""
        return parameters(self, self.model)

    @property
    def noise_std(self) -> float:
        """Standard deviation of the noise."""
        return float(self.noise / np.sqrt(3.0))


EXAMPLES: Mapping[str, Example] = {
    "5.1": Example(
        "5.1", "Hammerstein system with a kink", PiecewiseStructure(1, (), 0, (("u", 0),)),
        (-0.8,), ((-0.5, 0.0), (1.0, 0.0)), (1.0, 0.0), 100, 2.0, 0.2, (-0.5,), (1.0, 0.6, 0.4),
    ),
    "5.2": Example(
        "5.2", "LFT with a jump", PiecewiseStructure(1, (1,), 1, (("y", 2), ("u", 2))),
        (-0.4, 1.2, -0.5), ((0.5, 1.0, -0.25), (-0.7, 1.5, 0.0)), (1.5, -0.5, 1.0),
        1000, 1.0, 0.25, None, (0.6, 0.3),
    ),
    "5.3": Example(
        "5.3", "LFT with finite impulse response", PiecewiseStructure(0, (), 4, (("y", 1), ("u", 1))),
        tuple((-0.9) ** i for i in range(1, 5)), ((0.2, -0.8, -2.2), (-0.5, 0.2, 0.0)), (1.0, 0.0, 1.0),
        1000, 1.0, 0.2, (0.0, 0.0, 0.0, 0.0), (1.0, 0.7, 0.4),
    ),
}  # fmt: skip

BOUNDARY = {"5.1": ("tau",), "5.2": ("h1", "h2"), "5.3": ("h1", "h2")}
"""Names of the parameters of the boundary, for which the bound of a known partition says nothing."""


def experiment(
    example: Example, rng: np.random.Generator, samples: int | None = None
) -> tuple[Floats, Floats]:
    """Draw input and output of an experiment from rest."""
    n = example.samples if samples is None else samples
    u = rng.uniform(-example.input, example.input, n)
    return u, example.model.simulate(u, rng.uniform(-example.noise, example.noise, n))


def parameters(example: Example, model: PiecewiseLft) -> dict[str, float]:
    """Return the parameters of a model by the names of the tables, NaN where it has not two modes.

    Boundaries are scaled so that their last entry is 1, and the first mode holds where h' (z, 1) <= 0.
    """
    names = example.structure.linear_names()
    found = dict(zip(names, model.linear.tolist(), strict=True))
    map_ = model.map
    whole = map_.modes == 2 and map_.regions == 2
    if example.case == "5.1":
        left, right = map_.theta[:, 0] if whole else (np.nan, np.nan)
        tau = float(map_.tau[0]) if whole and map_.tau.size else np.nan
        return found | {"alpha1": float(right), "alpha2": float(left), "tau": tau}
    theta, h = sorted_modes(map_) if whole else (np.full((2, 3), np.nan), np.full(3, np.nan))
    for i, row in enumerate(theta, 1):
        found |= {f"theta{i}_{j}": float(value) for j, value in enumerate(row, 1)}
    return found | {"h1": float(h[0]), "h2": float(h[1])}


def sorted_modes(map_: PiecewiseAffineMap) -> tuple[Floats, Floats]:
    """Return submodels and boundary as in Table 5.2: h ends with 1 and is not positive in mode 1."""
    h = map_.hyperplane
    theta = map_.theta[map_.owners]
    return (theta if h[-1] > 0 else theta[::-1]), h / h[-1]


def printed_results() -> Mapping[str, tuple[str, str, float]]:
    """Return the printed results of single experiments: case and column of our runs, and the value."""
    found = {}
    for claim in read(claims_of("pepona")):
        if claim.id.startswith("5.") and claim.tolerance["type"] == "monte-carlo-band":
            found[claim.id] = (*_cut(claim.number), float(claim.printed))
    return found


def _cut(number: str) -> tuple[str, str]:
    """Return case and column of a number."""
    case, _, column = number.partition("/")
    stage, _, rest = column.partition("/")
    return (f"{case}/{stage}", rest) if stage == "bounded-error" else (case, column)


PRINTED = printed_results()

PRINTED_COUNTS: Mapping[str, tuple[str, str]] = {
    "5.1/iterations": ("5.1/bounded-error", "iterations"),
    "5.2/iterations": ("5.2/bounded-error", "iterations"),
    "5.3/iterations": ("5.3", "iterations"),
    "5.3/visited": ("5.3", "visited"),
    "5.3/enough": ("5.3", "enough"),
}
"""Printed counts of single experiments: case and column of our runs."""
