"""The worked nonlinearities of section 3 and the even one of Remark 3.2, identified from data."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from replications.bai import setting
from sysid import moment_ratios
from sysid.distributions import Distribution, PiecewiseUniform, Uniform
from sysid.hammerstein import (
    CorrelationEstimate,
    correlation_method,
    equation_error_response,
    moment_ratio,
)
from sysid.moment_ratios import Solution
from sysid.nonlinearities import NONLINEARITIES, StaticMap

SAMPLES = 20_000
"""Samples of each experiment; the paper gives none for these examples."""

_LAGS = 2 * setting.ORDER
_B1, _B2, _B3 = 2.0, 6.0, 3.0
_D1, _D2 = 2.0, 4.0
_E1, _E2 = 1.5, 4.5
_RELAY = (0.6, 1.4)
_PRELOAD = (0.5, 1.5)
_EVEN = (1.0,)

Solver = Callable[[list[CorrelationEstimate], list[float]], Solution]


@dataclass(frozen=True)
class Worked:
    """A worked nonlinearity: its true parameters, its input distributions and its solution.

    Attributes
    ----------
    map_name : str
        Name of the nonlinearity.
    parameters : tuple of float
        True parameters.
    inputs : tuple of Distribution
        f1, f2, ...; drawn from the same random numbers, which keeps the ratios far less noisy than
        independent draws.
    solve : callable
        From the linear parts and output means to the parameters.
    where : str
        Place in the paper.
    """

    map_name: str
    parameters: tuple[float, ...]
    inputs: tuple[Distribution, ...]
    solve: Solver
    where: str


def _saturation(linear: list[CorrelationEstimate], means: list[float]) -> Solution:
    return moment_ratios.saturation(moment_ratio(linear[0], linear[1]), *setting.EXAMPLE_2_INPUTS)


def _dead_zone(linear: list[CorrelationEstimate], means: list[float]) -> Solution:
    return moment_ratios.dead_zone(moment_ratio(linear[0], linear[1]), _B1, _B2)


def _relay(linear: list[CorrelationEstimate], means: list[float]) -> Solution:
    c1, c2 = moment_ratio(linear[0], linear[1]), moment_ratio(linear[0], linear[2])
    return moment_ratios.two_sided_relay(c1, c2, _B1, _B2, _D1, _D2)


def _preload(linear: list[CorrelationEstimate], means: list[float]) -> Solution:
    c1 = moment_ratio(linear[0], linear[1])
    return moment_ratios.preload_from_offset(c1, _B1, _B2, linear[0].alpha, linear[0].scaled_beta, means[0])


def _preload_as_printed(linear: list[CorrelationEstimate], means: list[float]) -> Solution:
    c1, c2 = moment_ratio(linear[0], linear[1]), moment_ratio(linear[0], linear[2])
    return moment_ratios.two_sided_preload(c1, c2, _B1, _B2, _B3)


def _even(linear: list[CorrelationEstimate], means: list[float]) -> Solution:
    even = static_map("even-dead-zone")
    moments = [lambda a, f=f: even.moment(f, float(a[0])) for f in WORKED["even-dead-zone"].inputs]
    return moment_ratios.any_map(moments, [moment_ratio(linear[0], linear[1])], [0.0], [_E1])


def static_map(name: str) -> StaticMap:
    """Return a map without memory."""
    found = NONLINEARITIES[name]
    assert isinstance(found, StaticMap)
    return found


_TWO_UNIFORM = (Uniform.symmetric(_B1), Uniform.symmetric(_B2))

WORKED: Mapping[str, Worked] = {
    "saturation": Worked(
        "saturation",
        (setting.THRESHOLD,),
        tuple(Uniform.symmetric(b) for b in setting.EXAMPLE_2_INPUTS),
        _saturation,
        "(3.13), (3.14)",
    ),
    "dead-zone": Worked("dead-zone", (setting.THRESHOLD,), _TWO_UNIFORM, _dead_zone, "(3.15), (3.16)"),
    "two-sided-relay": Worked(
        "two-sided-relay",
        _RELAY,
        (*_TWO_UNIFORM, PiecewiseUniform.zero_mean(_D1, _D2)),
        _relay,
        "(3.6)-(3.8), corrected",
    ),
    "two-sided-preload": Worked(
        "two-sided-preload", _PRELOAD, _TWO_UNIFORM, _preload, "(3.9)-(3.12), a2 - a1 from the offset"
    ),
    "two-sided-preload-as-printed": Worked(
        "two-sided-preload",
        _PRELOAD,
        (*_TWO_UNIFORM, PiecewiseUniform.mass_and_uniform(_B3)),
        _preload_as_printed,
        "(3.9)-(3.12) with the input (3.10)",
    ),
    "even-dead-zone": Worked(
        "even-dead-zone",
        _EVEN,
        tuple(PiecewiseUniform.zero_mean(scale * _E1, scale * _E2) for scale in (1.0, 2.0)),
        _even,
        "Remark 3.2",
    ),
}


@dataclass(frozen=True)
class WorkedRun:
    """One run: as many experiments as there are distributions, one estimate."""

    name: str
    n_samples: int = SAMPLES

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return the estimated parameters and whether the ratios allowed them."""
        worked = WORKED[self.name]
        nonlinearity = static_map(worked.map_name)
        input_seed = int(rng.integers(2**63))
        linear, means = [], []
        for distribution in worked.inputs:
            # The inputs share their random numbers; the noise of every experiment is its own.
            u = distribution.sample(np.random.default_rng(input_seed), self.n_samples)
            noise = rng.uniform(-setting.EXAMPLE_2_NOISE, setting.EXAMPLE_2_NOISE, self.n_samples)
            y = equation_error_response(
                nonlinearity(u, *worked.parameters), setting.ALPHA, setting.BETA, noise
            )
            linear.append(correlation_method(u, y, setting.ORDER, _LAGS))
            means.append(float(y.mean()))
        solution = worked.solve(linear, means)
        names = [f"a{i + 1}" if len(worked.parameters) > 1 else "a" for i in range(len(worked.parameters))]
        return {**dict(zip(names, solution.parameters, strict=True)), "regular": float(solution.regular)}


def true_parameters(name: str) -> dict[str, float]:
    """Return the true parameters of a worked nonlinearity by name."""
    values = WORKED[name].parameters
    return {f"a{i + 1}" if len(values) > 1 else "a": value for i, value in enumerate(values)}
