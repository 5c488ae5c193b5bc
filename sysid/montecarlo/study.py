"""What a Monte-Carlo study found: the table of its runs and their statistics."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.errors import UsageError
from sysid.montecarlo.checkpoints import read_header, read_rows
from sysid.montecarlo.runs import spawn_key
from sysid.statistics import FloatArray, Moments, fold, quantiles


@dataclass(frozen=True)
class Failure:
    """A run that raised, with what it takes to repeat it.

    Parameters
    ----------
    run : int
        Number of the run.
    seed : int
        Seed of the study.
    spawn_key : (int, int)
        The run's numbers come from ``SeedSequence(seed, spawn_key=spawn_key)``.
    message : str
        Kind and text of the exception.
    """

    run: int
    seed: int
    spawn_key: tuple[int, int]
    message: str


@dataclass(frozen=True, eq=False)
class Study:
    """The finished runs of one case; made by `Runner.run`.

    Failed runs are counted and listed, but no statistic uses them. A value NaN in a run that went well
    means "not defined": it is left out of that column's statistics and counted by `undefined`.

    Parameters
    ----------
    case : str
        Id of the case.
    seed : int
        Seed of the study.
    n_runs, failed : int
        Number of all runs, and of those that failed.
    columns : tuple of str
        Names of the values of a run.
    moments : Moments
        Count, mean and covariance of the columns, in their order.
    path : Path
        Parquet file with one row a run: run, failed, message and the values. It may hold more runs than
        `n_runs` when it was finished by an earlier, longer study.
    """

    case: str
    seed: int
    n_runs: int
    failed: int
    columns: tuple[str, ...]
    moments: Moments = field(repr=False)
    path: Path

    @classmethod
    def load(cls, path: Path, n_runs: int | None = None) -> "Study":
        """Read the first `n_runs` (default: all) runs of a finished case."""
        identity, names, n_rows = read_header(path)
        n_runs = n_rows if n_runs is None else n_runs
        failed = 0

        def rows() -> Iterator[FloatArray]:
            nonlocal failed
            for batch in read_rows(path, ["failed", *names], n_runs):
                failed += int(np.count_nonzero(batch.column("failed")))
                yield np.column_stack([batch.column(name) for name in names] or [np.empty((len(batch), 0))])

        moments = fold(rows(), len(names))
        return cls(identity.case, identity.seed, n_runs, failed, names, moments, path)

    def mean(self) -> dict[str, float]:
        """Mean of each column."""
        return self._by_name(self.moments.mean)

    def std(self) -> dict[str, float]:
        """Sample standard deviation of each column, divisor n - 1."""
        return self._by_name(self.moments.std)

    def standard_error(self) -> dict[str, float]:
        """Error of the mean of each column, one standard deviation."""
        return self._by_name(self.moments.standard_error)

    def undefined(self) -> dict[str, int]:
        """How many runs that went well left each column undefined (NaN)."""
        good = self.n_runs - self.failed
        return {name: good - int(n) for name, n in zip(self.columns, self.moments.count, strict=True)}

    def covariance(self, names: Sequence[str] | None = None) -> FloatArray:
        """Sample covariance of the named columns (default: all), (n_names, n_names).

        Each entry uses the runs where both columns are defined.
        """
        index = [self._index(name) for name in (self.columns if names is None else names)]
        return self.moments.covariance[np.ix_(index, index)]

    def quantile(self, name: str, probabilities: Sequence[float]) -> FloatArray:
        """Exact quantiles of a column (NumPy's "linear" method), in bounded memory."""
        self._index(name)
        return quantiles(
            lambda: (batch.column(name).to_numpy() for batch in read_rows(self.path, [name], self.n_runs)),
            probabilities,
        )

    def column(self, name: str) -> FloatArray:
        """Values of a column in all runs that went well, in the order of the runs."""
        self._index(name)
        parts = [
            np.asarray(batch.column(name))[~np.asarray(batch.column("failed"))]
            for batch in read_rows(self.path, ["failed", name], self.n_runs)
        ]
        return np.concatenate(parts)

    def failures(self) -> Iterator[Failure]:
        """Yield the failed runs in their order; repeat one with `Runner.replay`."""
        for batch in read_rows(self.path, ["run", "failed", "message"], self.n_runs):
            for row in batch.filter(batch.column("failed")).to_pylist():
                run = row["run"]
                yield Failure(run, self.seed, spawn_key(self.case, run), row["message"])

    def summary(
        self, true: Mapping[str, float], crlb: Mapping[str, float] | None = None
    ) -> dict[str, dict[str, float | None]]:
        """Quality of the estimates of parameters whose true values are known.

        Parameters
        ----------
        true : mapping
            Column name -> true value.
        crlb : mapping, optional
            Column name -> standard deviation at the Cramér-Rao bound.

        Returns
        -------
        dict
            Column name -> true, mean, bias, bias_std_error, std (divisor n - 1), rmse, q025, q975, crlb_std
            and efficiency = (crlb_std / std)^2; None where a figure is not defined, never NaN.

        Raises
        ------
        UsageError
            When a name is not a column.
        """
        for name in crlb or {}:
            self._index(name)
        return {name: self._quality(name, value, (crlb or {}).get(name)) for name, value in true.items()}

    def _quality(self, name: str, true: float, bound: float | None) -> dict[str, float | None]:
        index = self._index(name)
        mean, std = float(self.moments.mean[index]), float(self.moments.std[index])
        low, high = self.quantile(name, [0.025, 0.975])
        reference = np.full(len(self.columns), true)
        quality = {
            "true": true,
            "mean": mean,
            "bias": mean - true,
            "bias_std_error": self.moments.standard_error[index],
            "std": std,
            "rmse": math.sqrt(self.moments.mean_square_about(reference)[index]),
            "q025": low,
            "q975": high,
            "crlb_std": math.nan if bound is None else bound,
            "efficiency": math.nan if bound is None or std == 0.0 else (bound / std) ** 2,
        }
        return {key: float(value) if math.isfinite(value) else None for key, value in quality.items()}

    def _index(self, name: str) -> int:
        if name not in self.columns:
            known = ", ".join(self.columns) or "none, as every run failed"
            raise UsageError(f"case {self.case!r} has no column {name!r}; its columns are: {known}")
        return self.columns.index(name)

    def _by_name(self, values: NDArray[np.float64]) -> dict[str, float]:
        return {name: float(value) for name, value in zip(self.columns, values, strict=True)}
