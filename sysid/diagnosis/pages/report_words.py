"""A diagnosis in words."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.diagnosis.drafts import law_in_words
from sysid.diagnosis.effects.catalogue import catalogue
from sysid.diagnosis.pages.mechanism_words import mechanism
from sysid.diagnosis.residuals import EXACT
from sysid.diagnosis.wording import NORMAL_95, all_of, percent, plus_minus, quantity, value_beside

if TYPE_CHECKING:
    from sysid.diagnosis.effects.base import Effect
    from sysid.diagnosis.ladder import Rung
    from sysid.diagnosis.outcome import Outcome
    from sysid.diagnosis.structures.structure import FittedParameter

# The error grows if its rank correlation with time is so many standard deviations, and by this factor.
BLOCKS, ROWS_OF_BLOCK = 24, 8
LEAST_TREND, LEAST_GROWTH = 3.3, 1.5
# A model follows next to nothing of the output if its error has this share of its deviation.
UNRELATED = 0.98
# Half an interval of a coefficient of the denominator that leaves poles open: they lie within a unit circle.
LOOSE_POLES = 0.5
# A Runge-Kutta step of fourth order is stable up to this product with the rate of a decay.
RUNGE_KUTTA_STABLE = 2.78
# A free run within this factor of the floor is down to it: both are estimates, from different rows.
AT_FLOOR = 1.1


def sentences(diagnosis: "Outcome") -> list[str]:
    """Return what was found, the main thing first."""
    record, ladder = diagnosis.record, diagnosis.ladder
    unit = record.unit(record.outputs[0])
    judged = diagnosis.judged
    found = [_headline(diagnosis), *filter(None, [getattr(diagnosis.structure, "units", "")])]
    found += [f"{effect.name}: {mechanism(effect, diagnosis)}" for effect in _effects(diagnosis)]
    for rung, before in zip(ladder, (None, *ladder), strict=False):
        found.append(_rung(rung, before, judged, unit))
    found += _noise_floor(diagnosis, judged, unit)
    for rung in ladder[1:]:
        for p in ladder[-1].model.fitted.parameters_of(rung.effect):
            found.append(f"{rung.effect}: {_with_spread(p)}")
    found += _loose(diagnosis) + _unrelated(diagnosis) + _own_constant(diagnosis) + _too_fast(diagnosis)
    found += _growing(diagnosis, judged, unit)
    for port in diagnosis.ports[:1]:
        found += [port.sentence, *filter(None, [law_in_words(port)])]
    if diagnosis.advice:
        found.append(diagnosis.advice)
    return found


def _noise_floor(diagnosis: "Outcome", judged: str, unit: str) -> list[str]:
    """Tell the floor, and whether the final model has come down to it.

    Where something is left that nothing explains, a quiet test set may still lie below the floor of the rows
    that the model was fitted to: that does not make it noise.
    """
    floor, left = diagnosis.noise_floor, diagnosis.ladder[-1].scores[judged]["rmse"]
    if not np.isfinite(floor):
        return []
    reached = left is not None and left <= AT_FLOOR * floor
    unexplained = diagnosis.verdict == "unexplained"
    rest = "what is left is noise" if reached else "what lies above it is the model's"
    return [f"Noise floor: {quantity(floor, unit)} RMSE{'' if reached and unexplained else f'; {rest}'}."]


def _loose(diagnosis: "Outcome") -> list[str]:
    """Name the parameters of a model that the record leaves open."""
    if getattr(diagnosis.structure, "plant", None) is None:
        return _loose_poles(diagnosis)
    # A force that was found has the model's scale; one that was given may be small because it is not there.
    found = [effect for effect in _effects(diagnosis) if effect.name not in diagnosis.decision.given]
    forces = {effect.name for effect in found if effect.port == "force"}
    shared = [p for p in diagnosis.final.parameters if not p.owner or p.owner in forces]
    vague = [p for p in shared if not NORMAL_95 * p.std_error < abs(p.value)]
    loose = [p.name for p in vague]
    if len(loose) < 2 or all(p.owner for p in vague):
        return []
    return [
        f"The record determines {', '.join(loose[:-1])} and {loose[-1]} only together, each by itself less "
        "well than its own size: the free run does not suffer, but to read them fix one with --fix."
    ]


def _loose_poles(diagnosis: "Outcome") -> list[str]:
    """Say so where a record leaves the denominator of a linear model, and so its poles, open."""
    poles = [p for p in diagnosis.final.parameters if not p.owner and p.name.startswith("a")]
    if len(poles) < 2 or all(NORMAL_95 * p.std_error < LOOSE_POLES for p in poles):
        return []
    return [
        f"The record does not tell all {len(poles)} poles: {poles[0].name} to {poles[-1].name} and the "
        "coefficients of the input are known only together, each by itself within its wide interval. The "
        "free run does not suffer; to read them, try a lower --order or an input of more frequencies."
    ]


def _effects(diagnosis: "Outcome") -> "list[Effect]":
    return [choice.effect for choice in diagnosis.final.fitted.choices]


def _headline(diagnosis: "Outcome") -> str:
    names, they = all_of(diagnosis.accepted), "them" if len(diagnosis.accepted) > 1 else "it"
    best = next((t for t in diagnosis.decision.trials if t.fit is not None), None)
    return {
        "missing-effect": _beside_given(diagnosis)
        or f"Missing in the model: {names or (best.name if best else '')}.",
        "nothing-missing": "Nothing is missing in the model.",
        "coloured-noise": "Nothing is missing in the model but a memory of the noise.",
        "unexplained": f"Missing in the model: {names}, or what resembles {they}, and something that "
        "no candidate explains."
        if names
        else "Something is missing in the model that no candidate explains.",
        "not-identifiable": "The model's parameters cannot be told from this record.",
    }[diagnosis.verdict]


def _beside_given(diagnosis: "Outcome") -> str:
    """Return what is missing beside effects that were added whatever the evidence; empty without any."""
    given = diagnosis.decision.given
    if not given:
        return ""
    found = all_of([name for name in diagnosis.accepted if name not in given])
    beside = all_of(given)
    if found:
        return f"Missing in the model with {beside}: {found}."
    return f"With {beside}, which {'was' if len(given) == 1 else 'were'} given, nothing further is missing."


def _unrelated(diagnosis: "Outcome") -> list[str]:
    """Say so where the final model follows next to nothing of the output that it was fitted to."""
    record = diagnosis.record
    rows = record.learning
    y, output = record.y[rows, 0], diagnosis.final.output[rows]
    if not np.isfinite(output).all() or float(np.std(y - output)) < UNRELATED * float(np.std(y)):
        return []
    return [
        f"The model follows next to nothing of {record.outputs[0]!r}, even where it was fitted: "
        f"{record.inputs[0]!r} may not drive it, or not be aligned with it in time."
    ]


def _own_constant(diagnosis: "Outcome") -> list[str]:
    """Say that a constant force needs no effect where the model has one."""
    plant = getattr(diagnosis.structure, "plant", None)
    name = plant.port.constant if plant is not None else ""
    asked = any(trial.name == "constant_force" for trial in diagnosis.decision.trials)
    own = [p for p in diagnosis.final.parameters if p.name == name and not p.owner]
    if not asked or not own:
        return []
    return [f"constant_force: a constant force is part of the model already, {_with_spread(own[0])}."]


def _too_fast(diagnosis: "Outcome") -> list[str]:
    """Name the candidates inside a model that no step in a sample is short enough for."""
    from sysid.physics.forced import MOST_SUBSTEPS, ForcedPlant

    structure = diagnosis.structure
    plant = getattr(structure, "plant", None)
    if not isinstance(plant, ForcedPlant):
        return []
    values = structure.setting.values_of(diagnosis.decision.baseline.point)  # type: ignore[attr-defined]
    rate = float(np.abs(plant.poles(values)).max(initial=0.0))
    untried = {trial.name for trial in diagnosis.decision.trials if trial.fit is None}
    inside = [e.name for e in catalogue() if e.name in untried and e.port in ("force", "gain", "flow")]
    if rate <= RUNGE_KUTTA_STABLE * MOST_SUBSTEPS or not inside:
        return []
    shortest, period = quantity(plant.period / rate, "s"), quantity(plant.period, "s")
    return [
        f"{all_of(inside)} could not be tried: the model has a motion of {shortest}, too short to be "
        f"simulated step by step over a sampling period of {period}. Fix the parameter behind it (an "
        "inductance or a mass that is next to nothing) at a larger value: as long as the motion stays far "
        "below the period, the record hardly shows it."
    ]


def _with_spread(parameter: "FittedParameter") -> str:
    """Return name, value, half the 95 % interval and unit of a parameter."""
    value = value_beside(parameter.value, parameter.std_error)
    words = (value, plus_minus(parameter.std_error), parameter.unit)
    if parameter.unit.startswith("%") and words[1]:  # the interval is no share of the value
        words = (f"({value}", f"{words[1]})", parameter.unit)
    return f"{parameter.name} = {' '.join(word for word in words if word)}"


def _growing(diagnosis: "Outcome", judged: str, unit: str) -> list[str]:
    """Say so where the final model's error grows along a test set beyond chance."""
    record = diagnosis.record
    if judged == "validation":
        return []
    rows = record.scored_rows(judged)
    squares = (record.y[rows, 0] - diagnosis.final.output[rows]) ** 2
    if squares.size < BLOCKS * ROWS_OF_BLOCK or not np.isfinite(squares).all():
        return []
    if np.sqrt(squares.max()) < EXACT * np.max(np.abs(record.y[rows, 0])):
        return []
    blocks = np.sqrt([part.mean() for part in np.array_split(squares, BLOCKS)])
    first, last = (
        float(np.sqrt(np.mean(part**2))) for part in (blocks[: BLOCKS // 3], blocks[-BLOCKS // 3 :])
    )
    ranks = np.argsort(np.argsort(blocks))
    trend = float(np.corrcoef(ranks, np.arange(BLOCKS))[0, 1]) * np.sqrt(BLOCKS - 1)
    if trend < LEAST_TREND or last < LEAST_GROWTH * first:
        return []
    return [
        f"The error grows along {judged}, from {quantity(first, unit)} in its first third to "
        f"{quantity(last, unit)} in its last: the plant may have changed after the rows of the fit "
        "(time_variation, out_drift), the motion may have grown, or small errors add up."
    ]


def _rung(rung: "Rung", before: "Rung | None", judged: str, unit: str) -> str:
    entry = rung.scores[judged]
    what = f"With {rung.effect}" if rung.effect else "Baseline"
    if entry["rmse"] is None:
        return f"{what}: the free run on {judged} diverges."
    share = f", {percent(entry['nrmse'])} of the signal" if entry["nrmse"] is not None else ""
    removed = f"; {_removed(rung.removed)}" if rung.step else ""
    if (
        before is not None
        and rung.removed > 0.0
        and entry["rmse"] > (before.scores[judged]["rmse"] or np.inf)
    ):
        removed += f" on the validation rows, none on {judged}"
    return f"{what}: free-run error {quantity(entry['rmse'], unit)} RMSE on {judged}{share}{removed}."


def _removed(share: float) -> str:
    """Say which share of the explainable error a step removed.

    Examples
    --------
    >>> _removed(0.97), _removed(-3.4)
    ('97 % of the explainable error removed', 'by itself it removes none of the explainable error')
    """
    if share <= 0.0:
        return "by itself it removes none of the explainable error"
    return f"{percent(min(share, 1.0))} of the explainable error removed"
