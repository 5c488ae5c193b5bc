"""Structure of an LFT model, chosen by the free run on validation rows."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.record import Mask, Record
from sysid.errors import IdentifiabilityError, SysidError
from sysid.lft.estimate import Jacobian, fit_lft
from sysid.lft.model import LftFit
from sysid.lft.signals import signals_of
from sysid.lft.structure import Lag, LftStructure

Floats = NDArray[np.float64]

ORDERS = (1, 2, 3, 4)
FIRST_KNOTS, FURTHER_KNOTS = 5, (3, 8, 13)
LEADING = 2
# Structures are compared by fits to so many rows at most.
SCREENED_ROWS = 10_000
# A structure with fewer parameters is taken if its error is within this share of the best one's.
PRACTICAL_SHARE = 0.01
LARGEST_DELAY = 10
# A delay of one sample is taken unless another one lowers the error by more than this share.
CLEARLY_BETTER = 0.02


@dataclass(frozen=True)
class Trial:
    """One structure that was tried.

    Attributes
    ----------
    structure : LftStructure
    validation_rms : float
        Free-run error on the validation rows of a fit to estimation rows; infinite if it diverged
        or could not be fitted.
    problem : str
        Why it could not be fitted, or empty.
    """

    structure: LftStructure
    validation_rms: float
    problem: str = ""


@dataclass(frozen=True)
class LftChoice:
    """The accepted model and how its structure was chosen.

    Attributes
    ----------
    fit : LftFit
        Fitted to estimation and validation rows.
    accepted : LftFit
        The same structure fitted to estimation rows only: its validation error is an honest one.
    trials : tuple of Trial
        Best first; a single one if nothing was left to choose.
    reason : str
        One sentence.
    """

    fit: LftFit
    accepted: LftFit
    trials: tuple[Trial, ...]
    reason: str


def choose_lft(
    record: Record,
    given: Mapping[str, Any] | None = None,
    *,
    initial_state: str = "estimate",
    jacobian: Jacobian = "exact",
    starts: int = 3,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> LftChoice:
    """Choose what is not given of the structure by the free-run error on validation rows, then fit.

    Hammerstein, Wiener and Wiener-Hammerstein models, and maps fed by the output or by both, of
    orders 1 to 4 are fitted to estimation rows with 5 knots; the best two then with fewer and more.

    Parameters
    ----------
    record : Record
        With one output.
    given : mapping, optional
        Fields of `LftStructure` that are fixed.
    initial_state : {"estimate", "rest"}
        Whether free runs start from measured lags or from zero.
    jacobian, starts, seed
        See `fit_lft`.
    progress : callable, optional
        Called with the number of fits done and to do.

    Returns
    -------
    LftChoice

    Raises
    ------
    SysidError
        If no structure can be fitted; the reason is that of the simplest one.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> rng = np.random.default_rng(0)
    >>> u, y = rng.uniform(-2, 2, 900), np.zeros(900)
    >>> for k in range(1, 900):
    ...     y[k] = 0.7 * y[k - 1] + np.tanh(2 * u[k - 1]) + 0.05 * rng.standard_normal()
    >>> found = choose_lft(make_record(u, y, period=0.1), {"knots": 6})
    >>> found.fit.structure.kind, found.fit.structure.n_a
    ('Hammerstein', 1)
    """
    fixed = dict(given or {})
    simulation = "rest" if initial_state == "rest" else "available"
    first = _structures(record, fixed)
    trials: list[Trial] = []
    n_to_do = len(first) + LEADING * len(FURTHER_KNOTS) + 2

    def advance(done: int) -> None:
        if progress is not None:
            progress(done, n_to_do)

    if len(first) > 1:
        if not record.validation.any():
            raise IdentifiabilityError(
                "the record has no validation rows to choose a structure by: give the order of A and the "
                "lags of z, or more rows"
            )
        screened = _screened_rows(record)
        for structure in first:
            trials.append(_tried(record, structure, screened, simulation, jacobian))
            advance(len(trials))
        if "knots" not in fixed:
            leading = sorted(trials, key=lambda trial: trial.validation_rms)[:LEADING]
            for trial in leading:
                for knots in FURTHER_KNOTS:
                    further = replace(trial.structure, knots=knots)
                    trials.append(_tried(record, further, screened, simulation, jacobian))
                    advance(len(trials))
        trials.sort(key=lambda trial: (trial.validation_rms, trial.structure.n_parameters))
        structure = _simplest(trials)
    else:
        structure = first[0]
    accepted = fit_lft(record, structure, rows=record.estimation, jacobian=jacobian, starts=starts, seed=seed)
    advance(n_to_do - 1)
    fit = fit_lft(record, structure, start=accepted, jacobian=jacobian)
    advance(n_to_do)
    return LftChoice(fit, accepted, tuple(trials) or (Trial(structure, np.nan),), _reason(trials, structure))


def _structures(record: Record, fixed: Mapping[str, Any]) -> list[LftStructure]:
    """Return the structures to be tried, each once, the simpler ones first."""
    delay = 1 if {"z_lags", "b_lags"} <= fixed.keys() else likely_delay(record)

    def inputs(*delays: int) -> tuple[Lag, ...]:
        return tuple((name, delay + i) for i in delays for name in record.inputs)

    output: tuple[Lag, ...] = (("y", 1),)
    families: list[dict[str, Any]] = []
    for n in ORDERS:
        families += [
            *({"n_a": n, "n_g": m, "z_lags": inputs(0)} for m in (n - 1, n)),
            *({"n_a": n, "n_g": m, "z_lags": inputs(0, 1)} for m in (n - 1, n)),
            {"z_lags": inputs(*range(n + 1))},
            {"n_a": n, "b_lags": inputs(*range(n)), "z_lags": output},
            {"n_a": n, "n_g": n - 1, "b_lags": inputs(*range(n)), "z_lags": (*inputs(0), *output)},
        ]
    if {"n_a", "z_lags"} <= fixed.keys():  # what is left open then is simply absent
        families = [{}]
    defaults: dict[str, Any] = {"knots": FIRST_KNOTS, "overlap": "keep"}
    found: list[LftStructure] = []
    for family in families:
        structure = LftStructure(**{**defaults, **family, **fixed})
        if structure not in found:
            found.append(structure)
    return found


def likely_delay(record: Record) -> int:
    """Return the delay [samples] of the linear regression that predicts best one step ahead.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> u = np.random.default_rng(0).standard_normal(300)
    >>> y = np.convolve(u, [0.0, 0.0, 0.0, 1.0, 0.8])[:300]
    >>> likely_delay(make_record(u, y, period=1.0))
    3
    """
    signals = signals_of(record)
    times = np.flatnonzero(_screened_rows(record) & (signals.age() >= LARGEST_DELAY + 2)).astype(np.int64)
    if times.size < 20:
        return 1
    past = signals.lagged([("y", 1), ("y", 2)], times)
    ones, y = np.ones((times.size, 1)), signals.y[times]
    errors = []
    for delay in range(LARGEST_DELAY + 1):
        taps = signals.lagged([(name, delay + i) for name in record.inputs for i in (0, 1)], times)
        columns = np.column_stack([past, taps, ones])
        errors.append(float(np.sum((y - columns @ np.linalg.lstsq(columns, y)[0]) ** 2)))
    best = int(np.argmin(errors))
    return best if errors[best] < (1.0 - CLEARLY_BETTER) * errors[1] else 1


def _screened_rows(record: Record) -> Mask:
    rows = np.zeros(record.n_samples, dtype=bool)
    rows[np.flatnonzero(record.estimation)[:SCREENED_ROWS]] = True
    return rows


def _tried(
    record: Record, structure: LftStructure, rows: Mask, initial_state: str, jacobian: Jacobian
) -> Trial:
    try:
        fit = fit_lft(record, structure, rows=rows, jacobian=jacobian, tolerance=1e-6)
    except SysidError as problem:
        return Trial(structure, np.inf, str(problem))
    run = fit.simulate(record, initial_state=initial_state, diverged="nan")
    error = record.y[record.validation, 0] - run[record.validation]
    rms = float(np.sqrt(np.mean(error**2)))
    return Trial(structure, rms if np.isfinite(rms) else np.inf, "" if np.isfinite(rms) else "it diverges")


def _simplest(trials: list[Trial]) -> LftStructure:
    best = trials[0].validation_rms
    if not np.isfinite(best):
        simplest = min(trials, key=lambda trial: trial.structure.n_parameters)
        raise IdentifiabilityError(
            f"none of {len(trials)} structures could be fitted and run on the validation rows; the simplest: "
            f"{simplest.problem}"
        )
    near = [trial for trial in trials if trial.validation_rms <= (1.0 + PRACTICAL_SHARE) * best]
    return min(near, key=lambda trial: trial.structure.n_parameters).structure


def _reason(trials: list[Trial], structure: LftStructure) -> str:
    if not trials:
        return "The structure was given."
    return (
        f"The structure is the simplest within {100 * PRACTICAL_SHARE:.0f} % of the best of {len(trials)} "
        f"by the free-run error on the validation rows: {structure.words}."
    )
