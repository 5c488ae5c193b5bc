"""Example 2: saturation by correlation analysis, in every reading the paper leaves open."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from replications.bai import setting
from sysid import moment_ratios
from sysid.distributions import Uniform
from sysid.hammerstein import (
    CorrelationEstimate,
    correlation_method,
    equation_error_response,
    moment_ratio,
    search_method,
)
from sysid.nonlinearities import SATURATION

LAGS = (4, 8, 16)
"""Values of m; the paper asks for m >= 2n = 4 and does not say which it used."""

RATIOS = {"averaged": None, "single": 0}
"""c from the mean over j of the ratios of beta_j, or from beta_1 alone."""

INPUTS = ("independent", "shared")
"""The second input is drawn anew, or is the first one scaled."""

PRINTED = (1.005, -0.8390, -0.1555, 1.09, 1.08)
"""Eq. (3.20): a, alpha1, alpha2, beta1, beta2."""

PRINTED_DECIMALS = (3, 4, 4, 2, 2)


def variants() -> tuple[str, ...]:
    """Return the names of all variants of the correlation method."""
    return tuple(f"m{m}-{ratio}-{inputs}" for m, ratio, inputs in product(LAGS, RATIOS, INPUTS))


@dataclass(frozen=True)
class Example2:
    """One run of Example 2: two experiments, identified by every variant and by least squares.

    All variants of one run see the same data; ``independent`` and ``shared`` have the first experiment
    in common.
    """

    n_samples: int = setting.EXAMPLE_2_SAMPLES

    def experiments(self, rng: np.random.Generator) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
        """Return for both readings of the inputs the two experiments (u, y)."""
        total = self.n_samples + max(LAGS)
        first, second = (rng.uniform(-1.0, 1.0, total) for _ in range(2))
        noises = [rng.uniform(-setting.EXAMPLE_2_NOISE, setting.EXAMPLE_2_NOISE, total) for _ in range(2)]
        b1, b2 = setting.EXAMPLE_2_INPUTS
        start = _response(b1 * first, noises[0])
        return {
            "independent": [start, _response(b2 * second, noises[1])],
            "shared": [start, _response(b2 * first, noises[1])],
        }

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return the estimates of all variants, keyed ``<variant>/<parameter>``."""
        values: dict[str, float] = {}
        experiments = self.experiments(rng)
        for m in LAGS:
            for inputs, records in experiments.items():
                linear = [correlation_method(u, y, setting.ORDER, m) for u, y in records]
                for ratio, column in RATIOS.items():
                    name = f"m{m}-{ratio}-{inputs}"
                    parameters, regular = correlation_estimate(linear, column)
                    values |= {f"{name}/{key}": value for key, value in parameters.items()}
                    values[f"{name}/regular"] = float(regular)
        values |= {
            f"separable/{key}": value for key, value in separable_estimate(experiments["independent"]).items()
        }
        return values


def _response(u: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = SATURATION(u, setting.THRESHOLD)
    return u, equation_error_response(x, setting.ALPHA, setting.BETA, noise)


def correlation_estimate(
    linear: list[CorrelationEstimate], column: int | None
) -> tuple[dict[str, float], bool]:
    """Carry out steps 3 to 5 of the algorithm: a from the ratio of moments (3.14), then beta (3.19)."""
    b1, b2 = setting.EXAMPLE_2_INPUTS
    solution = moment_ratios.saturation(moment_ratio(linear[0], linear[1], column), b1, b2)
    a = float(solution.parameters[0])
    moment = SATURATION.moment(Uniform(-b1, b1), a)
    beta = linear[0].scaled_beta / moment
    return dict(zip(setting.PARAMETERS, [a, *linear[0].alpha, *beta], strict=True)), solution.regular


def separable_estimate(records: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, float]:
    """Separable least squares on both experiments together."""
    u, y = (np.concatenate(signals) for signals in zip(*records, strict=True))
    fitted = search_method(
        u,
        y,
        SATURATION,
        setting.ORDER,
        upper=setting.SEARCH_UPPER,
        starts=[0, records[0][0].size],
    )
    return dict(zip(setting.PARAMETERS, [*fitted.eta, *fitted.theta], strict=True))
