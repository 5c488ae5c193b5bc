"""What the chapters share: the entry of a study in the results, exponents, and the gates of the protocol."""

from collections.abc import Mapping, Sequence

import numpy as np

from sysid import gates as gate
from sysid.claims import Claim
from sysid.gates import Gate
from sysid.montecarlo import Study


def entry(
    study: Study, true: Mapping[str, float], bound: Mapping[str, float] | None = None, prefix: str = ""
) -> dict[str, object]:
    """Return the Monte-Carlo entry of a case for ``results.json``.

    Parameters
    ----------
    study : Study
    true : mapping
        True values by parameter.
    bound : mapping, optional
        Standard deviations at the Cramér-Rao bound by parameter.
    prefix : str
        What stands before the parameters in the names of the columns.
    """

    def columns(values: Mapping[str, float]) -> dict[str, float]:
        return {prefix + name: value for name, value in values.items()}

    summary = study.summary(columns(true), None if bound is None else columns(bound))
    parameters = {name.removeprefix(prefix): quality for name, quality in summary.items()}
    return {"n_runs": study.n_runs, "failed": study.failed, "parameters": parameters}


def parameters_of(case: Mapping[str, object]) -> Mapping[str, Mapping[str, float]]:
    """Return the parameters of an entry."""
    parameters = case["parameters"]
    assert isinstance(parameters, Mapping)
    return parameters


def slope_std_error(sizes: Sequence[int], n_runs: Sequence[int]) -> float:
    """Return the standard error of a fitted exponent; log RMSE over n runs has the variance 1/(2n)."""
    x = np.log(sizes) - np.mean(np.log(sizes))
    return float(np.sqrt(np.sum(x**2 / (2 * np.asarray(n_runs)))) / np.sum(x**2))


def protocol_gates(studies: Mapping[str, Study], claims: Sequence[Claim]) -> list[Gate]:
    """Require that no run failed and that every claim has its verdict."""
    disagreeing = sum(not claim.passed for claim in claims)
    reason = "every printed value has the verdict its claims file states"
    return [
        gate.exact("failed-runs", sum(s.failed for s in studies.values()), 0, "no run may fail"),
        gate.exact("claims", disagreeing, 0, reason),
    ]
