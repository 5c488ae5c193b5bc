"""Section 7: one run of an example by the paper's method, maximum likelihood and the naive fit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from replications.lacy import setting
from replications.lacy.setting import Experiment
from sysid.errors import IdentifiabilityError
from sysid.wiener import (
    WienerFit,
    identify_wiener,
    information_bound,
    maximum_likelihood,
    naive_fit,
    score,
)
from sysid.wiener.response import frequency_response

METHODS = ("paper", "ml", "naive", "bound")
"""The bound is scored as an estimate drawn at the Cramér-Rao bound, so that medians compare."""

SCORES = (
    "rms_db",
    "max_db",
    "rms_deg",
    "max_deg",
    "relative_h2",
    "peak_db",
    "peak_frequency",
    "stable",
)
BEYOND = (2.0, 3.13)
"""Frequencies [rad a sample] above the window of the scores, next to the zero of G at -0.966."""
KEPT_SEQUENCES = 10
STARTS = 8


@dataclass(frozen=True)
class ExampleRun:
    """One run of an example: draw an experiment, identify it in every way, score the systems.

    Attributes
    ----------
    case : str
        Name of the example.
    samples : int or None
        Other than in the paper.
    noisy : bool
        With the measurement noise of (30).
    """

    case: str
    samples: int | None = None
    noisy: bool = True

    def experiment(self, rng: np.random.Generator) -> Experiment:
        """Draw the experiment of a run."""
        samples = self.samples or setting.EXAMPLES[self.case].samples
        return setting.experiment(self.case, samples, rng, self.noisy)

    def identify(self, data: Experiment) -> WienerFit:
        """Identify by the paper's method; the sequences that are kept are starts of maximum likelihood."""
        return identify_wiener(
            data.u, data.z, setting.nonlinearity(self.case), setting.ORDER, starts=STARTS, keep=KEPT_SEQUENCES
        )

    def estimates(self, data: Experiment) -> tuple[WienerFit, dict[str, np.ndarray]]:
        """Return the fit and theta by every method."""
        known = setting.nonlinearity(self.case)
        fit = self.identify(data)
        likelihood = maximum_likelihood(data.u, data.z, known, fit)
        found = {
            "paper": fit.theta,
            "ml": likelihood.theta,
            "naive": naive_fit(data.u, data.z, setting.ORDER),
        }
        return fit, found

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return parameters and scores by method, and what the solver saw."""
        data = self.experiment(rng)
        fit, found = self.estimates(data)
        values: dict[str, float] = {
            "moved": fit.moved,
            "exact": fit.exact,
            "criterion": fit.criterion,
            "mismatches": float(np.sum(~self._explains(fit, data))),
            "recovered": float(np.mean(np.abs(fit.y - data.y - data.w) < 1e-6)),
        }
        for method, theta in found.items():
            values |= self._scored(method, theta)
        beyond = score(
            found["ml"], setting.TRUE, setting.ORDER, match_gain=self.case == "sign", window=BEYOND
        )
        values["ml/beyond_db"] = beyond.rms_db
        if self.noisy:
            values |= self._at_the_bound(data, rng)
        return values

    def _explains(self, fit: WienerFit, data: Experiment) -> np.ndarray:
        """Tell for each sample whether the estimated y lies in the preimage of z, by an own check."""
        return np.abs(fit.preimage.nearest(fit.y) - fit.y) <= 1e-9 * np.maximum(1.0, np.abs(fit.y))

    def _scored(self, method: str, theta: np.ndarray) -> dict[str, float]:
        free_gain = self.case == "sign"
        found = score(theta, setting.TRUE, setting.ORDER, match_gain=free_gain).to_json()
        matched = gain_matched(theta) if free_gain else theta
        return {
            **{
                f"{method}/{name}": float(value)
                for name, value in zip(setting.PARAMETERS, matched, strict=True)
            },
            **{f"{method}/{name}": found[name] for name in SCORES},
        }

    def _at_the_bound(self, data: Experiment, rng: np.random.Generator) -> dict[str, float]:
        known = setting.nonlinearity(self.case)
        names = [*setting.PARAMETERS, *SCORES]
        undefined = {f"bound/{name}": np.nan for name in names}
        undefined |= {f"crlb/{name}": np.nan for name in setting.PARAMETERS}
        try:
            covariance = information_bound(data.u, setting.TRUE, data.noise_level, known, setting.ORDER)
        except IdentifiabilityError:
            return undefined
        drawn = rng.multivariate_normal(setting.TRUE, covariance, method="eigh")
        if self.case == "sign":
            covariance = gain_free_covariance(covariance)
        std = np.sqrt(np.diag(covariance))
        return {
            **self._scored("bound", drawn),
            **{f"crlb/{name}": float(value) for name, value in zip(setting.PARAMETERS, std, strict=True)},
        }


def gain_matched(theta: np.ndarray) -> np.ndarray:
    """Return theta with b scaled so that its Euclidean norm is the true one."""
    found = np.array(theta, dtype=float)
    size = np.linalg.norm(found[setting.ORDER :])
    found[setting.ORDER :] *= np.linalg.norm(setting.B) / size if size > 0 else 1.0
    return found


def gain_free_covariance(covariance: np.ndarray) -> np.ndarray:
    """Return the covariance of theta after `gain_matched`, to first order."""
    direction = np.zeros(setting.TRUE.size)
    direction[setting.ORDER :] = np.asarray(setting.B) / np.linalg.norm(setting.B)
    projector = np.eye(direction.size) - np.outer(direction, direction)
    return np.asarray(projector @ covariance @ projector)


@dataclass(frozen=True)
class ConsistencyRun(ExampleRun):
    """A longer run, for the error against the number of samples."""

    def identify(self, data: Experiment) -> WienerFit:
        """Identify from one start: the box of a longer record is dear to search."""
        known = setting.nonlinearity(self.case)
        return identify_wiener(data.u, data.z, known, setting.ORDER, starts=1)

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return the parameters by the paper's method and maximum likelihood, and their bound."""
        data = self.experiment(rng)
        _, found = self.estimates(data)
        known = setting.nonlinearity(self.case)
        covariance = information_bound(
            data.u, setting.TRUE, data.noise_level, known, setting.ORDER, points=100
        )
        found["crlb"] = np.sqrt(np.diag(covariance))
        return {
            f"{method}/{name}": float(value)
            for method in ("paper", "ml", "crlb")
            for name, value in zip(setting.PARAMETERS, found[method], strict=True)
        }


def shown_run(case: str, rng: np.random.Generator) -> dict[str, object]:
    """Return what the two figures of an example show, for one experiment."""
    run = ExampleRun(case)
    data = run.experiment(rng)
    fit, found = run.estimates(data)
    omega = np.linspace(0.01, np.pi, 400)
    thetas = {"true": setting.TRUE, **found}
    if case == "sign":
        thetas = {name: _matched_in_window(theta) for name, theta in thetas.items()}
    responses = {name: frequency_response(theta, setting.ORDER, omega) for name, theta in thetas.items()}
    reach = 1.1 * float(np.max(np.abs(np.concatenate([data.y + data.w, fit.y]))))
    axis = np.linspace(-reach, reach, 801)
    return {
        "y": data.y + data.w,
        "z": data.z,
        "y_hat": fit.y,
        "z_hat": setting.nonlinearity(case)(fit.y),
        "curve_y": axis,
        "curve_z": setting.nonlinearity(case)(axis),
        "omega": omega,
        "magnitude_db": {name: 20 * np.log10(np.abs(value)) for name, value in responses.items()},
        "phase_deg": {name: np.degrees(np.unwrap(np.angle(value))) for name, value in responses.items()},
        "status": fit.status,
        "identifiability": fit.identifiability.sentence,
        "recovered": float(np.mean(np.abs(fit.y - data.y - data.w) < 1e-6)),
    }


def _matched_in_window(theta: np.ndarray) -> np.ndarray:
    """Return theta with the gain that the scores use: equal mean magnitude in dB over the window."""
    omega = np.linspace(0.01, 2.0, 400)
    level = np.abs(frequency_response(theta, setting.ORDER, omega))
    wanted = np.abs(frequency_response(setting.TRUE, setting.ORDER, omega))
    found = np.array(theta, dtype=float)
    found[setting.ORDER :] *= np.exp(np.mean(np.log(wanted) - np.log(level)))
    return found
