"""Learn which effect a model lacks, add it, and see the error fall."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.advice import advise
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.decide.rungs import rungs_of
from sysid.diagnosis.decide.search import Search
from sysid.diagnosis.decide.verdict import with_a_detail_left
from sysid.diagnosis.diagnosis import Diagnosis
from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.ladder import Rung, check_places, climb
from sysid.diagnosis.long_records import LONGEST, Portable, carried, rows_for_one, shortened, thinned
from sysid.diagnosis.models.unit_check import in_units_of_model
from sysid.diagnosis.structures.structure import WHITE, Effort, Structure, StructureFit
from sysid.errors import UsageError
from sysid.progress import progress as bars_of

if TYPE_CHECKING:
    from sysid.diagnosis.ports import PortCurve

MOST_EFFECTS = 3
ALPHA = 0.01


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
    model : str, Model, SavedModel, SavedPhysicalModel or Structure
        ``"linear"``, the name of a physical model, a TOML file, a model, or a saved one: its effects are
        added and all of it is fitted anew, a physical model from its values.
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
        Whether to try all combinations of effects, however long the simulations take.  By default a search of
        which these have taken many steps begins no further stage; the advice says so.

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
    from threadpoolctl import threadpool_limits

    begun = time.perf_counter()
    _check(record, max_effects, alpha, accept)
    if jobs < 1:
        raise UsageError(f"jobs is {jobs}: give 1 or more")
    asked = find_effects(add)
    model, order, add = taken_up(record, model, order, asked)
    long = int(record.learning.sum()) > LONGEST and not hasattr(model, "offered")
    count = rows_for_one(record) if long and model != "linear" else 1
    part, chosen = record, record.learning
    if long:
        part, chosen = thinned(record, count) if count > 1 else shortened(record)
    structure = structure_of(part, model, order, initial_state, start, fixed)
    candidates = find_effects(effects if effects is not None else [e.name for e in _catalogue()])
    given = find_effects(add)
    check_places(structure, asked)
    # Blocks are small: further threads of the linear algebra only wait for one another.
    with threadpool_limits(1), bars_of(progress) as bars:

        def decide(structure: Structure) -> "tuple[Decision, tuple[PortCurve, ...] | None]":
            search = Search(
                structure, candidates, alpha=alpha, max_effects=max_effects, seed=seed, given=given,
                jobs=jobs, bars=bars, smooth=count > 1, thorough=thorough,
            )  # fmt: skip
            return _against_curves(structure, search.decide(), count > 1)

        if model == "linear" and order is None:
            from sysid.diagnosis.linear.structure import LinearStructure
            from sysid.diagnosis.orders import decided_with_order

            assert isinstance(structure, LinearStructure)
            structure, decision, curves = decided_with_order(structure, decide, alpha)
        else:
            decision, curves = decide(structure)
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
    seconds, searched = time.perf_counter() - begun, structure if long else None
    return Diagnosis(
        in_units_of_model(record, whole),
        whole,
        decision,
        accepted,
        ladder,
        decision.floor,
        advice,
        seconds,
        searched,
        curves,
    )


def _against_curves(
    structure: Structure, decision: Decision, smooth: bool
) -> "tuple[Decision, tuple[PortCurve, ...] | None]":
    """Weigh names that may only resemble what is missing against one free-form curve at a time.

    If a curve outdoes them they are left out.  Otherwise what they leave beside something unexplained may be
    a detail.  Of a ``smooth`` record, where next to everything is significant, a curve finds details, too.
    """
    from sysid.diagnosis.shortfall import curves_at_ports, each_counts, is_doubtful, outdone, resembled

    if decision.verdict == "missing-effect" and is_doubtful(decision) and not smooth:
        curves = curves_at_ports(structure, decision.baseline)
        better = resembled(structure.record, decision, curves)
        if better is not None:
            return replace(_with_nothing_found(decision), resembled_at=better.port), curves
        return decision, None
    if decision.verdict != "unexplained" or len(decision.fits) == len(decision.given):
        return decision, None
    curves = curves_at_ports(structure, decision.baseline)
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
        ties=(),
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


def taken_up(
    record: Record, model: Any, order: int | None, add: Sequence[str | Effect]
) -> tuple[Any, int | None, Sequence[str | Effect]]:
    """Return a saved model as one to be fitted, its effects among those to be added; others as they are."""
    from sysid.diagnosis.models.resolution import known_model

    known = known_model(model)
    if known is None:
        return model, order, add
    from sysid.diagnosis.export.saved_linear import SavedModel
    from sysid.diagnosis.models.known_model import at_period

    saved = at_period(known.saved, record)
    effects = [*(effect.effect for effect in saved.effects), *add]
    return ("linear", saved.order, effects) if isinstance(saved, SavedModel) else (saved.model, None, effects)


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
