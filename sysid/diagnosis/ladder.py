"""The ladder: the model as it grows by one effect after the other, with its free-run errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.comparison.scores import nrmse_interval, score
from sysid.diagnosis.decide.decision import Decision
from sysid.diagnosis.decide.evidence import TIED, block_separation
from sysid.diagnosis.decide.noise_colour import noise_of
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.effects.catalogue import find_effects
from sysid.diagnosis.structures.structure import (
    WHITE,
    Choice,
    Effort,
    FittedParameter,
    Structure,
    StructureFit,
    with_fine_steps,
)
from sysid.diagnosis.wording import plus_minus
from sysid.errors import UsageError
from sysid.linear.unit_root import with_unit_root
from sysid.progress import ProgressTask
from sysid.result_files import finite

# A refit on more rows that follows them so much less than the fit to some of them is another model.
COSTLY = 1.1


def check_places(structure: Structure, effects: Sequence[Effect]) -> None:
    """Raise UsageError unless effects that are to be added have a place in a model."""
    family = "linear" if getattr(structure, "plant", None) is None else "physics"
    offered = {effect.name for effect in structure.offered(effects)}
    for effect in effects:
        if effect.name in offered and effect.port != "noise":
            continue
        why = "the record cannot show it, or a parameter of the model does the same"
        if family not in effect.families:
            why = f"it is for {' and '.join(effect.families)} models only"
        elif effect.port == "noise":
            why = "a memory of the noise changes no free run, and is looked for anyway"
        raise UsageError(f"effect {effect.name!r} makes no sense for the model {structure.name!r}: {why}")


@dataclass(frozen=True, eq=False)
class DiagnosedModel:
    """A model with the effects that were added to it.

    Attributes
    ----------
    structure : Structure
    fitted : StructureFit
        On estimation and validation rows once `fit` was called.
    added : tuple of Effect
        Effects that were added and are not fitted yet.
    """

    structure: Structure
    fitted: StructureFit
    added: tuple[Effect, ...] = ()

    def add(self, *effects: str | Effect) -> "DiagnosedModel":
        """Return the model with further effects, to be fitted; a name that makes no sense is refused."""
        chosen = find_effects(effects)
        check_places(self.structure, chosen)
        return DiagnosedModel(self.structure, self.fitted, (*self.added, *chosen))

    def fit(self) -> "DiagnosedModel":
        """Return the model fitted with what was added, in the form that fits best."""
        rows = self.structure.record.learning
        current = self.structure.fit(self.fitted.choices, rows, WHITE, self.fitted, effort=Effort.REFIT)
        for effect in self.added:
            options = [
                self.structure.fit(
                    (*current.choices, Choice(effect, form)), rows, WHITE, current, effort=Effort.FINE
                )
                for form in effect.found_by
            ]
            n = rows.sum()
            current = min(options, key=lambda o: n * np.log(max(o.cost, 1e-300)) + o.n_parameters * np.log(n))
        return DiagnosedModel(self.structure, self.structure.finish(current, WHITE, closely=True))

    @property
    def parameters(self) -> tuple[FittedParameter, ...]:
        """Parameters of model and effects."""
        return self.fitted.parameters

    @property
    def output(self) -> Floats:
        """Free run over every row of the record, shape (n_samples,)."""
        return self.fitted.output

    def equation(self) -> str:
        """Return the equation with its effects."""
        return self.structure.equation(self.fitted)

    def __repr__(self) -> str:
        lines = [f"Model {self.structure.name!r} with {', '.join(self.fitted.names) or 'no effect'}"]
        lines += [
            f"  {p.name:14s} {p.value: .6g} {plus_minus(p.std_error) or '(no interval)'} {p.unit}".rstrip()
            for p in self.parameters
        ]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Rung:
    """One step of the ladder: scores of the model with the effects so far.

    Attributes
    ----------
    step : int
        0 is the baseline.
    effect : str
        What was added; empty for the baseline.
    model : DiagnosedModel
    scores : dict of str to dict
        For ``validation`` and each test set ``rmse``, ``nrmse``, and the 95 % interval of ``nrmse``.
    removed : float
        Share of the explainable validation error (mean square above the noise floor) that this step removed.
    """

    step: int
    effect: str
    model: DiagnosedModel
    scores: dict[str, dict[str, Any]]
    removed: float

    def to_json(self) -> dict[str, Any]:
        """Return the form of the JSON file."""
        return {
            "step": self.step,
            "effect": self.effect or None,
            "scores": self.scores,
            "removed_share": finite(self.removed),
            "parameters": parameters_json(self.model.parameters),
            "equation": self.model.equation(),
        }


def climb(
    structure: Structure,
    decision: Decision,
    estimates: Sequence[StructureFit],
    kept: Sequence[str],
    thin: bool,
    bar: ProgressTask,
) -> tuple[Rung, ...]:
    """Refit each rung on estimation and validation rows, score it on validation and test rows.

    The noise's memory from row to row is another where rows stood for several in the search: then the
    free-run error itself is minimised.  So it is where something is left unexplained: that is no noise, and
    weighed by its colour the model would follow its fast part alone.
    """
    record = structure.record
    plain = thin or decision.verdict == "unexplained"
    noise = WHITE if plain else _weighting(structure, estimates[-1], decision.noise.polynomial)
    plain = plain or noise.size < decision.noise.polynomial.size
    finals = []
    for fit in estimates:
        finals.append(_refitted(structure, fit, noise, plain))
        bar.advance()
    floor = decision.floor
    y = record.y[record.validation, 0]
    errors = [float(np.mean((y - fit.output[record.validation]) ** 2)) for fit in estimates]
    explainable = max(errors[0] - floor**2, 1e-300)
    rungs = []
    for step, (estimate, final) in enumerate(zip(estimates, finals, strict=True)):
        scores = {"validation": _score(record, record.validation, estimate.output)}
        for name in record.test_sets:
            rows = record.scored_rows(name)
            if rows.any():
                scores[name] = _score(record, rows, final.output)
        effect = "" if step == 0 else kept[step - 1]
        removed = 0.0 if step == 0 else (errors[step - 1] - errors[step]) / explainable
        rungs.append(Rung(step, effect, DiagnosedModel(structure, final), scores, removed))
    return tuple(rungs)


def _refitted(structure: Structure, fit: StructureFit, noise: Floats, plain: bool) -> StructureFit:
    """Return a fit on estimation and validation rows, weighed by a colour unless plain, with its errors.

    Weighed it may end elsewhere, where what is left is likelier as noise and the free run far off.
    """
    record, rows = structure.record, structure.record.learning

    def error(of: StructureFit) -> float:
        return float(np.mean((record.y[:, 0] - of.output)[rows] ** 2))

    final = structure.fit(fit.choices, rows, noise, fit, effort=Effort.REFIT)
    if noise.size > 1 and error(final) > COSTLY * error(fit):
        noise, plain = WHITE, True
        final = structure.fit(fit.choices, rows, noise, fit, effort=Effort.REFIT)
    if not final.usable:  # under rows that neither fit has seen
        final = fit
    final = with_fine_steps(structure, final, noise)
    return structure.finish(final, _memory(record, final) if plain else noise, plain=plain, closely=True)


def _memory(record: Record, fit: StructureFit) -> Floats:
    """Return D(q) of what is left by a fit to the learning rows."""
    residual = record.y[:, 0] - fit.output
    noise = noise_of(residual, record.learning).polynomial
    parts = [residual[part][record.learning[part]] for part in record.slices]
    return with_unit_root(parts, noise)


def _weighting(structure: Structure, fit: StructureFit, noise: Floats) -> Floats:
    """Return the colour under which the last refit is made: none where plain errors foretell more.

    What is left of a measured record is often no noise.  Then a fit that weighs it by a colour leaves some
    free-run error, which held-out rows tell beyond chance.
    """
    if noise.size == 1:
        return noise
    record = structure.record
    residuals = []
    for colour in (WHITE, noise):
        again = structure.fit(fit.choices, record.estimation, colour, fit, effort=Effort.REFIT)
        residuals.append((record.y[:, 0] - again.output)[record.validation])
    if not np.isfinite(residuals[0]).all():
        return noise
    worse = not np.isfinite(residuals[1]).all() or block_separation(*residuals) > TIED
    return WHITE if worse else noise


def _score(record: Record, rows: Any, output: Floats) -> dict[str, Any]:
    y = record.y[rows, 0]
    if not np.isfinite(output[rows]).all():
        return {"rmse": None, "nrmse": None, "interval": [None, None]}
    found, interval = score(y, output[rows]), nrmse_interval(y, output[rows])
    return {
        "rmse": finite(found.rmse),
        "nrmse": finite(found.nrmse),
        "interval": [finite(bound) for bound in interval],
    }


def parameters_json(parameters: Sequence[FittedParameter]) -> dict[str, dict[str, Any]]:
    """Return parameters as the JSON file holds them."""
    return {
        (f"{p.owner}.{p.name}" if any(q.name == p.name and q is not p for q in parameters) else p.name): {
            "value": finite(p.value),
            "std_error": finite(p.std_error),
            "unit": p.unit,
        }
        for p in parameters
    }
