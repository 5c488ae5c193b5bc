"""Section 6: the nonlinearity from step tests, then the linear system with G(1) = 1."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from replications.lacy import setting
from sysid.linear import simulate_polynomial
from sysid.nonlinearities import PiecewiseAffine
from sysid.wiener import identify_wiener, nonlinearity_from_steps, score

AMPLITUDES = np.linspace(-8.0, 8.0, 65)
"""Evenly spaced, as in the paper; a quarter apart."""
SETTLING = 400
SAMPLES = 60
CASES = ("dead-zone", "sine")


def normalised_true() -> np.ndarray:
    """Return theta of the true system divided by its gain G(1)."""
    gain = sum(setting.B) / sum(setting.A)
    return np.array([*setting.A[1:], *(np.array(setting.B) / gain)])


def measured_nonlinearity(case: str) -> PiecewiseAffine:
    """Return the nonlinearity that step tests of the simulated system show."""
    known = setting.nonlinearity(case)
    settled = [
        known(simulate_polynomial(setting.B, setting.A, np.full(SETTLING, amplitude)))[-1]
        for amplitude in AMPLITUDES
    ]
    return nonlinearity_from_steps(AMPLITUDES, settled)


def normalisation_error() -> float:
    """Return how far G(1) by eq. (28) is from one, for arbitrary parameters."""
    rng = np.random.default_rng(28)
    a, b = rng.standard_normal((2, setting.ORDER))
    b0 = 1.0 + float(np.sum(a - b))
    return abs((b0 + float(np.sum(b))) / (1.0 + float(np.sum(a))) - 1.0)


@dataclass(frozen=True)
class StepTestRun:
    """One run with a dead zone that is known only from step tests.

    Attributes
    ----------
    noisy : bool
        With the measurement noise of (30) in the identification record.
    """

    noisy: bool = True

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return parameters and scores against the system with G(1) = 1."""
        data = setting.experiment("dead-zone", SAMPLES, rng, self.noisy)
        measured = measured_nonlinearity("dead-zone")
        fit = identify_wiener(data.u, data.z, measured, setting.ORDER, normalisation="dc-gain", starts=4)
        found = score(fit.theta, normalised_true(), setting.ORDER)
        return {
            **{name: float(value) for name, value in zip(setting.PARAMETERS, fit.theta, strict=True)},
            "rms_db": found.rms_db,
            "rms_deg": found.rms_deg,
            "relative_h2": found.relative_h2,
            "moved": fit.moved,
        }
