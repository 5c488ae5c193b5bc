"""Learn which effect a model lacks, add it, and see the error fall."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.advice import advise
from sysid.diagnosis.comparison.scores import finite
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision, Trial
from sysid.diagnosis.decide.procedure import Search
from sysid.diagnosis.decide.rungs import rungs_of
from sysid.diagnosis.decide.verdict import with_a_detail_left
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.ladder import DiagnosedModel, Rung, climb, parameters_json
from sysid.diagnosis.long_records import LONGEST, Portable, carried, rows_for_one, shortened, thinned
from sysid.diagnosis.structures.structure import WHITE, Effort, Structure, StructureFit
from sysid.errors import UsageError
from sysid.progress import progress as bars_of

if TYPE_CHECKING:
    from pathlib import Path

    from sysid.diagnosis.comparison.where import Finding
    from sysid.diagnosis.ports import PortCurve

MOST_EFFECTS = 3
ALPHA = 0.01


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What a model lacks, with the evidence.

    Attributes
    ----------
    record : Record
    structure : Structure
    decision : Decision
    accepted : tuple of str
        Effects that were added, best first.
    ladder : tuple of Rung
    noise_floor : float
        Root mean square of what no model of the input explains, in the unit of the output.
    advice : str
    seconds : float
    searched : Structure, optional
        The structure on the rows of the search, where those of a long record are not all.
    curves : tuple of PortCurve, optional
        Of the ports, where the decision needed them.
    units : str
        Says that a column seems to be in another unit than the model's; empty otherwise.
    """

    record: Record
    structure: Structure
    decision: Decision
    accepted: tuple[str, ...]
    ladder: tuple[Rung, ...]
    noise_floor: float
    advice: str
    seconds: float
    searched: Structure | None = None
    curves: "tuple[PortCurve, ...] | None" = None
    units: str = ""

    @property
    def verdict(self) -> str:
        """What was found, one of the five words of the JSON file."""
        return self.decision.verdict

    @property
    def baseline(self) -> DiagnosedModel:
        """The model without effects."""
        return self.ladder[0].model

    @property
    def final(self) -> DiagnosedModel:
        """The model with all accepted effects."""
        return self.ladder[-1].model

    @property
    def judged(self) -> str:
        """The set of rows that the sentences speak of: the first scored test set, or validation."""
        scores = self.ladder[0].scores
        return next((name for name in self.record.test_sets if name in scores), "validation")

    @cached_property
    def where(self) -> "tuple[Finding, ...]":
        """Where the error of the baseline is concentrated, the clearest first."""
        from sysid.diagnosis.shortfall import where_it_fails

        return where_it_fails(self.record, self.baseline.output, self.judged)

    @cached_property
    def ports(self) -> "tuple[PortCurve, ...]":
        """Free-form curves of what no candidate explains; none if there is no such thing."""
        from sysid.diagnosis.shortfall import curves_at_ports

        if self.curves is not None:
            return self.curves
        # The rows of the search say all that a curve shows, in a fraction of the time of all rows.
        structure = self.structure if self.searched is None else self.searched
        return curves_at_ports(structure) if self.verdict == "unexplained" else ()

    def add(self, *effects: str | Effect) -> DiagnosedModel:
        """Return the final model with further effects, to be fitted by ``.fit()``."""
        return self.final.add(*effects)

    def to_json(self) -> dict[str, Any]:
        """Return what the JSON file holds: plain values, no NaN."""
        from sysid import __version__

        record = self.record
        spread = float(np.std(record.y[record.learning, 0])) or 1.0
        return {
            "schema": 1,
            "verdict": self.verdict,
            "accepted": list(self.accepted),
            "ranked": [self._ranked(trial) for trial in self.decision.trials],
            "tie": list(self.decision.tie),
            "ladder": [rung.to_json() for rung in self.ladder],
            "noise_floor": {
                "rmse": finite(self.noise_floor),
                "nrmse": finite(self.noise_floor / spread),
                "method": "what neither the final model nor any probe of it explains",
            },
            "where": [finding.to_json() for finding in self.where],
            "ports": [port.to_json() for port in self.ports],
            "advice": self.advice,
            "search": {"complete": not self.decision.cut_short},
            "left": {
                "p_value": finite(self.decision.left_p_value),
                "share": finite(self.decision.left_share),
                "rejected": list(self.decision.rejected),
            },
            "sentences": self.sentences(),
            "seconds": self.seconds,
            "versions": {"sysid": __version__, "numpy": np.__version__},
        }

    def _ranked(self, trial: Trial) -> dict[str, Any]:
        structure = self.structure if self.searched is None else self.searched
        y = structure.record.y[structure.record.validation, 0]
        spread = float(np.std(y)) or 1.0
        fitted = None if trial.fit is None else structure.finish(trial.fit, trial.noise.polynomial)
        return {
            "effect": trial.name,
            "p_value": finite(trial.p_value),
            "delta_bic": finite(trial.gain),
            "nrmse_validation": finite(trial.validation / spread),
            "parameters": {} if fitted is None else parameters_json(fitted.parameters_of(trial.name)),
        }

    def sentences(self) -> list[str]:
        """Say what was found, the main thing first."""
        from sysid.diagnosis.pages.report_words import sentences

        return sentences(self)

    def predictions(self) -> dict[str, Floats]:
        """Return the columns of the predictions file: measured, baseline, final, one value a row."""
        return {
            "measured": self.record.y[:, 0],
            "baseline": self.baseline.output,
            "final": self.final.output,
        }

    def draft(self) -> str:
        """Return the best free-form curve as an effect in TOML, to be edited; empty if there is none."""
        from sysid.diagnosis.drafts import draft_of

        return draft_of(self.ports, self.record, self.structure)

    def write_predictions(self, path: "Path") -> None:
        """Write the predictions as CSV: k, measured, baseline, final."""
        from sysid.result_files import write_text

        columns = list(self.predictions().values())
        rows = ["k,measured,baseline,final"]
        for k, values in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            rows.append(",".join([str(k), *("" if value != value else repr(value) for value in values)]))
        write_text(path, "\n".join(rows) + "\n")

    def __repr__(self) -> str:
        return "\n".join(
            [f"Diagnosis of {self.record.name!r}: {self.verdict}", *("  " + s for s in self.sentences())]
        )


def diagnose(
    record: Record,
    model: Any = "linear",
    order: int | None = None,
    *,
    initial_state: str = "estimate",
    effects: Sequence[str | Effect] | None = None,
    max_effects: int = MOST_EFFECTS,
    alpha: float = ALPHA,
    accept: Callable[[str], bool] | str = "auto",
    add: Sequence[str | Effect] = (),
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
    seed: int = 0,
    jobs: int = 1,
    progress: bool | None = False,
    thorough: bool = False,
) -> Diagnosis:
    """Learn which physical effect a model lacks, and add it.

    Candidates are fitted on estimation rows and must hold on validation rows; their free run must not
    diverge under the input of any row.  The accepted model is refitted on both, and only then judged on
    the test rows.

    Parameters
    ----------
    record : Record
        With one output.
    model : str, Model or Structure
        ``"linear"``, the name of a physical model, a TOML file, or a model.
    order : int, optional
        Of the linear model; chosen by the validation error if not given.
    initial_state : {"estimate", "rest"}
    effects : sequence of str or Effect, optional
        Candidates; the whole catalogue by default.
    max_effects : int
        Most effects to be added.
    alpha : float
        Chance of naming an effect where none is missing.
    accept : {"auto", "none"} or callable
        Whether what was found is added; a callable is asked with each name.
    add : sequence of str or Effect
        Effects that are added whatever the evidence.
    start, fixed : mapping of str to float, optional
        Uncertain and known values of a physical model's parameters.
    seed : int
        Of the simulated null distribution.
    jobs : int
        Candidates fitted at a time; the answer is the same for any number.
    progress : bool or None
        Whether to show on standard error what is being fitted; None does so on a terminal.
    thorough : bool
        Whether to try all combinations of effects, however long the simulations of a physical model take.
        By default a search of which these have taken many steps begins no further stage; the advice says so.

    Returns
    -------
    Diagnosis

    Raises
    ------
    UsageError, ModelError
        If an argument makes no sense.
    DataError, IdentifiabilityError
        If the record cannot be fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> rng = np.random.default_rng(1)
    >>> u, y = rng.uniform(-1, 1, 800), np.zeros(800)
    >>> for k in range(1, 800):
    ...     y[k] = 0.7 * y[k - 1] + np.clip(u[k - 1], -0.5, 0.5)
    >>> y += 0.02 * rng.standard_normal(800)
    >>> found = diagnose(make_record(u, y, period=0.1), order=1, effects=["in_saturation", "in_deadzone"])
    >>> found.verdict, found.accepted
    ('missing-effect', ('in_saturation',))
    >>> round(found.final.fitted.parameters_of("in_saturation")[0].value, 1)
    0.5
    """
    begun = time.perf_counter()
    _check(record, max_effects, alpha, accept)
    if jobs < 1:
        raise UsageError(f"jobs is {jobs}: give 1 or more")
    long = int(record.learning.sum()) > LONGEST and not hasattr(model, "offered")
    count = rows_for_one(record) if long and model != "linear" else 1
    part, chosen = record, record.learning
    if long:
        part, chosen = thinned(record, count) if count > 1 else shortened(record)
    structure = structure_of(part, model, order, initial_state, start, fixed)
    candidates = find_effects(effects if effects is not None else [e.name for e in _catalogue()])
    given = find_effects(add)
    with bars_of(progress) as bars:

        def decide(structure: Structure) -> "tuple[Decision, tuple[PortCurve, ...] | None]":
            search = Search(
                structure, candidates, alpha=alpha, max_effects=max_effects, seed=seed, given=given,
                jobs=jobs, bars=bars, smooth=count > 1, thorough=thorough,
            )  # fmt: skip
            return _against_curves(structure, search.decide())

        decision, curves = decide(structure)
        if model == "linear" and order is None:
            from sysid.diagnosis.orders import with_effects

            structure, decision, curves = with_effects((structure, decision, curves), decide, alpha)
        kept = _kept(decision, accept)
        estimates = [decision.baseline, *rungs_of(structure, decision, kept)]
        whole: Structure = structure
        carries_on = long and isinstance(structure, Portable)
        with bars.task("refits on all rows", (2 if carries_on else 1) * len(estimates)) as bar:
            if long and isinstance(structure, Portable):
                whole = structure.on(record)
                for step, fit in enumerate(estimates):
                    estimates[step] = _on_all_rows(whole, fit, chosen)
                    bar.advance()
            ladder = climb(whole, decision, estimates, kept, count > 1, bar)
        if decision.verdict == "missing-effect" and _is_lost(ladder):
            decision, kept = _with_nothing_found(decision), tuple(decision.given)
            ladder = ladder[: 1 + len(kept)]
    noise = NOISE_EFFECT in decision.accepted and accept != "none"
    accepted = (*kept, *([NOISE_EFFECT] if noise else []))
    advice = advise(structure, decision, accepted)
    units = getattr(structure, "units", "")
    seconds, searched = time.perf_counter() - begun, structure if long else None
    return Diagnosis(
        record, whole, decision, accepted, ladder, decision.floor, advice, seconds, searched, curves, units
    )


def _against_curves(
    structure: Structure, decision: Decision
) -> "tuple[Decision, tuple[PortCurve, ...] | None]":
    """Weigh the names beside something unexplained against one free-form curve at a time.

    If a curve outdoes them they only resemble what is missing, and are left out; otherwise what they leave
    may be a detail.
    """
    if decision.verdict != "unexplained" or len(decision.fits) == len(decision.given):
        return decision, None
    from sysid.diagnosis.shortfall import curves_at_ports, each_counts, outdone

    curves = curves_at_ports(structure)
    if not outdone(structure.record, decision, curves):
        if curves and each_counts(structure.record, decision):
            decision = with_a_detail_left(decision)
        return decision, curves if decision.verdict == "unexplained" else None
    kept = len(decision.given)
    return replace(decision, fits=decision.fits[:kept], accepted=decision.given), curves


def _is_lost(ladder: Sequence[Rung]) -> bool:
    """Tell whether the refits with effects follow less than their mean does, and less than without them."""
    first, last = (rung.scores.get("validation", {}).get("nrmse") for rung in (ladder[0], ladder[-1]))
    return first is not None and last is not None and last > max(first, 1.0)


def _with_nothing_found(decision: Decision) -> Decision:
    """Return the decision that what was found does not explain the record after all."""
    kept = len(decision.given)
    return replace(
        decision,
        verdict="unexplained",
        fits=decision.fits[:kept],
        accepted=decision.given,
        tie=(),
        rejected=tuple(name for name in decision.accepted if name != NOISE_EFFECT),
        left_share=1.0,
    )


def _on_all_rows(whole: Structure, fit: StructureFit, chosen: Mask) -> StructureFit:
    """Return a fit to part of a record refitted on all its estimation rows."""
    return whole.fit(fit.choices, whole.record.estimation, WHITE, carried(fit, chosen), effort=Effort.REFIT)


def structure_of(
    record: Record,
    model: Any,
    order: int | None,
    initial_state: str,
    start: Mapping[str, float] | None = None,
    fixed: Mapping[str, float] | None = None,
) -> Structure:
    """Return the structure of a model for a record."""
    if model == "linear":
        from sysid.diagnosis.linear.structure import LinearStructure

        if start or fixed:
            name = next(iter({**(start or {}), **(fixed or {})}))
            raise UsageError(
                f"the linear model has no parameter {name!r}: give a physical model with --model"
            )
        return LinearStructure(record, order, initial_state=initial_state)
    if hasattr(model, "offered"):
        checked: Structure = model
        return checked
    from sysid.diagnosis.models.unit_check import in_units_of
    from sysid.diagnosis.physics.structure import PhysicsStructure
    from sysid.physics import load_model
    from sysid.physics.model import Model

    if order is not None:
        raise UsageError("--order is for the linear model: a physical model has its own")
    loaded = model if isinstance(model, Model) else load_model(model)
    read, units = in_units_of(record, loaded.with_parameters(start, fixed))
    return PhysicsStructure(record, read, initial_state, units)


def _catalogue() -> tuple[Effect, ...]:
    from sysid.diagnosis.effects.catalogue import catalogue

    return catalogue()


def _check(record: Record, max_effects: int, alpha: float, accept: Any) -> None:
    if not isinstance(record, Record):
        raise UsageError(f"record is of type {type(record).__name__}: make one with sysid.data.make_record")
    if max_effects < 0:
        raise UsageError(f"max_effects is {max_effects}: give 0 or more")
    if not 0.0 < alpha < 1.0:
        raise UsageError(f"alpha is {alpha:g}: give a chance between 0 and 1")
    if not callable(accept) and accept not in ("auto", "none"):
        raise UsageError(f"accept is {accept!r}: choose auto or none")


def _kept(decision: Decision, accept: Callable[[str], bool] | str) -> tuple[str, ...]:
    """Return the effects that are added, in the order in which they were found."""
    names = [name for name in decision.accepted if name != NOISE_EFFECT]
    given = set(decision.given)
    if callable(accept):
        return tuple(name for name in names if name in given or accept(name))
    return tuple(names) if accept == "auto" else tuple(name for name in names if name in given)
