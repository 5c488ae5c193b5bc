"""The search for missing effects: on which rows, and under which course of the input."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.decide.acceptance import is_better_held_out, tied
from sysid.diagnosis.decide.allowance import allowance_of
from sysid.diagnosis.decide.attempt import Attempt
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision, Trial
from sysid.diagnosis.decide.growth import Growth
from sysid.diagnosis.decide.ranking import with_every_candidate
from sysid.diagnosis.decide.residual_evidence import LEFT_P_VALUE, Evidence, interleaved
from sysid.diagnosis.decide.settling import settled
from sysid.diagnosis.decide.trials import Trials
from sysid.diagnosis.decide.verdict import Judge, leaves_a_trace
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.structures.structure import WHITE, Effort, Structure, StructureFit
from sysid.progress import Progress

# The input's other course is worth a search if it lowers the squared error, all else refitted, to this share.
CLOSER = 0.9


@runtime_checkable
class Resampled(Protocol):
    """A structure whose input may take another course between samples."""

    def held_or_smooth(self) -> bool:
        """Take the input's other course between samples; tell whether it may have another."""


class Search:
    """The search for missing effects in one record.

    Parameters
    ----------
    structure : Structure
    effects : sequence of Effect
        Candidates; those that make no sense for the structure are left out.
    alpha : float
        Largest chance of naming an effect where none is missing.
    max_effects : int
    seed : int
        Of the simulated null distribution.
    given : sequence of Effect
        Effects that are in the model whatever the evidence.
    jobs : int
        Candidates fitted at a time, each by a thread of its own; the answer is the same.
    bars : Progress, optional
        Shows how many candidates of a round are fitted.
    smooth : bool
        Whether rows of the record stand for several of a slow motion, see `Evidence`.
    thorough : bool
        Whether the search goes on to its end however much its fits simulate.
    """

    def __init__(
        self,
        structure: Structure,
        effects: Sequence[Effect],
        *,
        alpha: float = 0.01,
        max_effects: int = 3,
        seed: int = 0,
        given: Sequence[Effect] = (),
        jobs: int = 1,
        bars: Progress | None = None,
        smooth: bool = False,
        thorough: bool = False,
    ) -> None:
        self.structure, self.alpha, self.max_effects, self.seed = structure, alpha, max_effects, seed
        self.jobs, self.bars = jobs, Progress() if bars is None else bars
        self.smooth, self.allowance = smooth, allowance_of(structure, thorough)
        self.names = [effect.name for effect in effects]
        self.given = structure.offered(given)
        already = {effect.name for effect in self.given}
        self.candidates = tuple(
            effect
            for effect in structure.offered(effects)
            if effect.port != "noise" and effect.name not in already
        )

    def decide(self) -> Decision:
        """Name what is missing."""
        record = self.structure.record
        attempt = self._attempt(record.estimation, record.validation)
        decision = attempt.decided()
        # Where rows stand for several the input was averaged, and next to everything is significant.
        looks_again = decision.left_p_value < LEFT_P_VALUE and not self.smooth
        if looks_again and isinstance(self.structure, Resampled):
            attempt, decision = self._with_other_course(self.structure, attempt, decision)
        if self._looks_at_other_rows(attempt, decision):
            other = self._attempt(*interleaved(record.learning))
            found = other.decided()
            # Where nothing explains, rows that take turns must do more than move what is left.  And a model
            # that is not reproducible on them says nothing against one that was.
            named = found.verdict != "unexplained" and not leaves_a_trace(found)
            if found.verdict != "not-identifiable" and (decision.verdict != "unexplained" or named):
                attempt, decision = other, found
        decision = replace(
            settled(attempt.trials, _amended(attempt, decision)), cut_short=self.allowance.ended
        )
        return with_every_candidate(decision, self.names, self._memory(attempt, decision))

    def _looks_at_other_rows(self, attempt: Attempt, decision: Decision) -> bool:
        """Tell whether held-out rows show what others do not, and the search may go on to them."""
        if decision.verdict == "not-identifiable" or not _held_out_rows_show_more(attempt.evidence, decision):
            return False
        return decision.verdict != "unexplained" or self.allowance.permits()

    def _with_other_course(
        self, structure: "Resampled", attempt: Attempt, decision: Decision
    ) -> tuple[Attempt, Decision]:
        """Decide once more with the input's other course between samples; return the better decision.

        An input that was sampled, not held, makes every law wrong that is tried with a held one.
        """
        if not structure.held_or_smooth():
            return attempt, decision
        fits = (decision.baseline, decision.final)
        after = self._errors(attempt.evidence, fits)
        structure.held_or_smooth()
        before = self._errors(attempt.evidence, fits)
        if not (after < CLOSER * before).any():  # neither without effects nor with them does it come closer
            return attempt, decision
        structure.held_or_smooth()
        ended = self.allowance.ended
        self.allowance.renew()
        other = self._attempt(attempt.evidence.rows, attempt.evidence.held_out)
        found = other.decided()
        if is_better_held_out(attempt.evidence, found.final, decision.final):
            return other, found
        structure.held_or_smooth()
        self.allowance.ended = ended
        return attempt, decision

    def _errors(self, evidence: Evidence, fits: Sequence[StructureFit]) -> Floats:
        """Return the squared free-run error of each fit, refitted under the input's present course."""
        learning, errors = self.structure.record.learning, []
        for fit in fits:
            again = self.structure.fit(fit.choices, evidence.rows, WHITE, fit, effort=Effort.REFIT)
            error = evidence.residual(again)[learning]
            errors.append(float(error @ error) if again.usable else np.inf)
        return np.array(errors)

    def _attempt(self, rows: Mask, held_out: Mask) -> Attempt:
        """Return the search on these rows."""
        evidence = Evidence(self.structure, rows, held_out, self.alpha, len(self.given), self.smooth)
        trials = Trials(evidence, self.candidates, self.seed, self.jobs, self.bars, self.allowance)
        given = tuple(effect.name for effect in self.given)
        judge = Judge(evidence, given, NOISE_EFFECT in self.names)
        return Attempt(evidence, trials, Growth(trials, self.given, self.max_effects), judge)

    def _memory(self, attempt: Attempt, decision: Decision) -> Trial | None:
        """Return the memory of the noise as a candidate beside the others."""
        if NOISE_EFFECT not in self.names:
            return None
        return attempt.memory(decision.baseline)


def _amended(attempt: Attempt, decision: Decision) -> Decision:
    """Return a decision with the candidates and the tie of the one effect that was found, where it is one.

    It may have come to stand alone after another, beside which it was found, had been left out.
    """
    if len(decision.fits) != len(decision.given) + 1:
        return decision
    before = decision.fits[-2] if decision.given else decision.baseline
    trials = attempt.trials.amended(before, decision.trials, decision.final)
    if trials is decision.trials or trials[0].name != decision.final.choices[-1].name:
        return replace(decision, trials=trials)
    tie = tied(attempt.evidence, trials)
    return replace(decision, trials=trials, ties=(tie,) if tie else ())


def _held_out_rows_show_more(evidence: Evidence, decision: Decision) -> bool:
    """Tell whether held-out rows show something that the rows of the search do not.

    Nothing is accepted that does not hold on them, were it all that the rows of the search lack.
    """
    if evidence.rows_disagree(decision.final):
        return True
    if decision.verdict != "unexplained" or len(decision.final.choices) > len(decision.given):
        return False

    def is_explained(fit: StructureFit) -> bool:
        return evidence.left(decision.baseline, fit, evidence.rows)[0] >= LEFT_P_VALUE

    if decision.left_p_value < LEFT_P_VALUE and is_explained(decision.final):
        return True
    leader = decision.trials[0].fit if decision.trials else None
    return leader is not None and evidence.rows_disagree(leader) and is_explained(leader)
