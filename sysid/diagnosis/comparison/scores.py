"""Scores of a free run and of a one-step prediction, with block-bootstrap intervals."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.diagnosis.residuals import block_length
from sysid.linear.forms import Floats
from sysid.result_files import finite

CONFIDENCE = 0.95
REPLICATES = 1000


@dataclass(frozen=True)
class Score:
    """How far a prediction is from the measurement on one set of rows.

    Attributes
    ----------
    rmse : float
        Root mean square error, in the unit of the output.
    nrmse : float
        ||y - yhat|| / ||y - mean(y)||.
    fit : float
        100 (1 - nrmse) [%].
    vaf : float
        Variance accounted for, 100 (1 - var(y - yhat) / var(y)) [%].
    """

    rmse: float
    nrmse: float
    fit: float
    vaf: float

    def to_json(self) -> dict[str, float | None]:
        """Return plain values; one that is not finite becomes null."""
        return {name: finite(getattr(self, name)) for name in ("rmse", "nrmse", "fit", "vaf")}


@dataclass(frozen=True)
class SetScore:
    """Scores of a model on one set of rows.

    Attributes
    ----------
    name : str
    free_run, one_step : Score
    interval : tuple of float
        95 % interval of the free-run NRMSE.
    unit : str
        Unit of the output.
    first_row, last_row : int
        First and last scored row of the record, counted from 1.
    n_rows : int
        Scored rows.
    skip : int
        Rows left out at the beginning.
    initial_state : str
        How the initial state of the run was found.
    fitted_on : str
        Rows on which the scored model was fitted.
    """

    name: str
    free_run: Score
    one_step: Score
    interval: tuple[float, float]
    unit: str
    first_row: int
    last_row: int
    n_rows: int
    skip: int
    initial_state: str
    fitted_on: str

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file; the scores at the top are those of the free run."""
        return {
            **self.free_run.to_json(),
            "unit": self.unit,
            "interval": [finite(bound) for bound in self.interval],
            "window": {
                "first_row": self.first_row,
                "last_row": self.last_row,
                "rows": self.n_rows,
                "skip": self.skip,
            },
            "initial_state": self.initial_state,
            "fitted_on": self.fitted_on,
            "one_step": self.one_step.to_json(),
        }


def score(y: Floats, predicted: Floats) -> Score:
    """Score a prediction.

    Parameters
    ----------
    y, predicted : ndarray, shape (n_rows,)

    Examples
    --------
    >>> import numpy as np
    >>> s = score(np.array([1.0, -1.0, 1.0, -1.0]), np.array([0.9, -0.9, 0.9, -0.9]))
    >>> round(s.rmse, 6), round(s.nrmse, 6), round(s.fit, 4), round(s.vaf, 4)
    (0.1, 0.1, 90.0, 99.0)
    """
    error = y - predicted
    if np.ptp(y) == 0.0:  # the mean of equal values may differ from them by rounding
        nrmse = vaf = float("nan")
    else:
        nrmse = float(np.linalg.norm(error) / np.linalg.norm(y - y.mean()))
        vaf = 100.0 * (1.0 - float(np.var(error) / np.var(y)))
    return Score(float(np.sqrt(np.mean(error**2))), nrmse, 100.0 * (1.0 - nrmse), vaf)


def nrmse_interval(y: Floats, predicted: Floats, seed: int = 0) -> tuple[float, float]:
    """Return the 95 % interval of the NRMSE by a moving-block bootstrap.

    Blocks are as long as the squared error is correlated (twice its integrated correlation time,
    at least the cube root of the number of rows), so that they can be drawn independently.

    Source: Künsch (1989), The jackknife and the bootstrap for general stationary observations,
    Annals of Statistics 17(3).

    Parameters
    ----------
    y, predicted : ndarray, shape (n_rows,)
    seed : int
    """
    if np.ptp(y) == 0.0:
        return float("nan"), float("nan")
    squared = (y - predicted) ** 2
    length = block_length(squared)
    n_blocks = -(-y.size // length)
    starts = np.random.default_rng(seed).integers(0, y.size, size=(REPLICATES, n_blocks))
    sums = [
        _block_sums(values, length)[starts].sum(axis=1)
        for values in (squared, y - y.mean(), (y - y.mean()) ** 2)
    ]
    rows = n_blocks * length
    spread = sums[2] - sums[1] ** 2 / rows
    with np.errstate(divide="ignore", invalid="ignore"):
        replicates = np.sqrt(sums[0] / spread)
    tail = 0.5 * (1.0 - CONFIDENCE)
    replicates = replicates[np.isfinite(replicates)]
    if replicates.size == 0:
        return float("nan"), float("nan")
    low, high = np.quantile(replicates, [tail, 1.0 - tail])
    return float(low), float(high)


def _block_sums(values: Floats, length: int) -> Floats:
    """Return the sum of the block that starts at each row, wrapping around."""
    wrapped = np.concatenate([[0.0], np.cumsum(np.concatenate([values, values[: length - 1]]))])
    return np.asarray(wrapped[length:] - wrapped[:-length])
