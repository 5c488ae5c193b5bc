"""What a diagnosis has found: plain data, before it is put into words, pages or files."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.diagnosis.decide.decision import Decision, Trial
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.ladder import DiagnosedModel, Rung, parameters_json
from sysid.diagnosis.structures.structure import Structure
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.where import Finding
    from sysid.diagnosis.effect_views import EffectView
    from sysid.diagnosis.ports import PortCurve


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a search for missing effects came to, and what follows from it.

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
        return curves_at_ports(structure, self.decision.baseline) if self.verdict == "unexplained" else ()

    @cached_property
    def views(self) -> "tuple[EffectView, ...]":
        """What each effect of the final model does; a single one beside a curve of free form."""
        from sysid.diagnosis.effect_views import effect_views, with_free_curve

        views = effect_views(self.final)
        if len(self.final.fitted.choices) > 1:
            return views
        structure = self.structure if self.searched is None else self.searched
        return tuple(with_free_curve(view, structure, self.decision.baseline) for view in views)

    def ranked(self) -> list[dict[str, Any]]:
        """Return the single candidates, best first, as the JSON file has them."""
        return [self._ranked(trial) for trial in self.decision.trials]

    def _ranked(self, trial: Trial) -> dict[str, Any]:
        structure = self.structure if self.searched is None else self.searched
        y = structure.record.y[structure.record.validation, 0]
        spread = float(np.std(y)) or 1.0
        fitted = None
        if trial.fit is not None:
            closely = trial.name in self.accepted
            fitted = structure.finish(trial.fit, trial.noise.polynomial, closely=closely)
        return {
            "effect": trial.name,
            "p_value": finite(trial.p_value),
            "delta_bic": finite(trial.gain),
            "nrmse_validation": finite(trial.validation / spread),
            "parameters": {} if fitted is None else parameters_json(fitted.parameters_of(trial.name)),
        }

    def predictions(self) -> dict[str, Floats]:
        """Return the columns of the predictions file: measured, baseline, final, one value a row."""
        return {
            "measured": self.record.y[:, 0],
            "baseline": self.baseline.output,
            "final": self.final.output,
        }
