"""A search with one choice of the rows that are held out: grow a model, judge it, start otherwise."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.decide.acceptance import (
    is_accepted,
    is_accepted_at,
    is_better_held_out,
    is_significant,
)
from sysid.diagnosis.decide.allowance import PROMISING
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision, Trial
from sysid.diagnosis.decide.foresight import most_promising
from sysid.diagnosis.decide.growth import Grown, Growth
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE
from sysid.diagnosis.decide.refinement import refined, with_sides
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.decide.revision import exchanged, freed, reordered, without_idle
from sysid.diagnosis.decide.rungs import rungs_to
from sysid.diagnosis.decide.trials import POLISHED, Trials
from sysid.diagnosis.decide.verdict import Judge, explains_most, leaves_a_trace
from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.residuals import EXACT
from sysid.diagnosis.structures.cells import QUANTISER, are_steps
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort, StructureFit
from sysid.diagnosis.structures.thresholds import DEAD_ZONE, JUMP, RELAY

ZERO = "out_offset"
# How many runners-up are tried before a record counts as unexplained, and how many beside each.
RUNNERS_UP, BESIDE_RUNNER_UP = 2, 4
# A zero of the sensor comes before all else if it alone lowers the squared error to this share.
SHIFTED = 0.5
# To how many of the others the one that leaves the least is added with care.
PAIRED = 3
# How many pairs are fitted that promise most by the slopes of one beside the other.
FORESEEN = 6


@dataclass(frozen=True, eq=False)
class Attempt:
    """A search with one choice of the rows that are held out.

    Attributes
    ----------
    evidence : Evidence
    trials : Trials
    growth : Growth
    judge : Judge
    """

    evidence: Evidence
    trials: Trials
    growth: Growth
    judge: Judge

    def decided(self) -> Decision:
        """Grow a model from the baseline and judge it; start otherwise where that leaves something."""
        with self.trials.bars.task("the model without effects, from several starts", None):
            baseline = self.evidence.structure.baseline(self.evidence.rows)
        if not baseline.restarts_agree:
            return self._at_the_bottom(baseline)
        if not self.growth.given and (left := self._rounding(baseline)) is not None:
            noise = self.evidence.noise(baseline)
            return Decision("nothing-missing", baseline, (), (), (), (), noise, 1.0, 0.0, left)
        given = self.growth.given_fits(baseline)
        grown = self.growth.grown(baseline, given, len(given))
        decision = self._in_a_loop(self._judged(baseline, grown), given, grown.fits)
        for trial in self._replacing(decision):
            if not self.trials.allowance.permits(PROMISING):
                break
            decision = min(decision, self._from_replaced(decision, given, grown, trial), key=_burden)
        if decision.verdict == "unexplained" and self.growth.max_effects > 1:
            decision = self._otherwise(decision, grown.trials)
        if self.growth.max_effects > 1 and self._unread(decision):
            decision = self._otherwise(decision, grown.trials, self._behind_quantiser(grown.trials))
        return self._in_a_loop(decision, given, decision.fits)

    def _at_the_bottom(self, baseline: StructureFit) -> Decision:
        """Refuse to say what a model lacks whose searches disagree, unless effects leave white noise alone.

        Nothing leaves less: theirs is the end that counts, and what was missing had led the others astray.
        """
        given = self.growth.given_fits(baseline)
        grown = self.growth.grown(baseline, given, len(given))
        decision = self._judged(baseline, grown)
        if decision.verdict == "missing-effect" and NOISE_EFFECT not in decision.accepted:
            return decision
        unknown, noise = float("nan"), self.evidence.noise(baseline)
        return Decision("not-identifiable", baseline, (), (), (), (), noise, 1.0, 0.0, unknown)

    def _in_a_loop(self, decision: Decision, *found: Sequence[StructureFit]) -> Decision:
        """Judge what nothing explains once more: a controller may have put it into the input.

        Before more is tried, for two effects that answer at once can follow a noise that the input goes with.
        """
        if decision.verdict != "unexplained":
            return decision
        for fits in found:
            final = fits[-1] if fits else decision.baseline
            if self.evidence.only_at_once(final):
                return self.judge.verdict(decision.baseline, fits, decision.trials, (), fed_back=True)
        return decision

    def _rounding(self, baseline: StructureFit) -> float | None:
        """Return the error of a model that misses nothing but rounding, as that of a computed output."""
        measured = self.evidence.structure.record.y[:, 0]
        left, size = (
            np.concatenate([signal[rows] for rows in (self.evidence.rows, self.evidence.held_out)])
            for signal in (measured - baseline.output, measured)
        )
        error = float(np.sqrt(np.mean(left**2)))
        return error if error < EXACT * float(np.std(size)) else None

    def _judged(self, baseline: StructureFit, grown: Grown) -> Decision:
        """Judge a grown model; where it leaves something, finer laws of its effects may explain more."""
        decision = self.judge.verdict(baseline, *grown)
        n_given = len(self.growth.given)
        if decision.verdict != "unexplained":
            return decision
        finer = refined(self.evidence, grown.fits, n_given)
        if finer is None and grown.fits:
            finer = with_sides(self.evidence, grown.fits[-1], n_given)
        if finer is None:
            return decision
        rungs = rungs_to(self.evidence.structure, self.evidence.rows, finer, baseline, n_given)
        return min(decision, self.judge.verdict(baseline, rungs, grown.trials, ()), key=_burden)

    def _replacing(self, decision: Decision) -> list[Trial]:
        """Return what is worth a search of its own where nothing explains: what all other laws build on.

        Laws of flow replace a law of the model, so they need not show beside an effect that was taken for
        them; and from a wrong zero of the sensor every law depends on the wrong values, so that what else is
        missing may leave a drift in which the zero alone is lost.
        """
        if decision.verdict != "unexplained":
            return []
        flows = {effect.name for effect in self.trials.candidates if effect.port == "flow"}
        baseline = decision.baseline
        return [
            trial
            for trial in decision.trials
            if trial.name not in decision.rejected
            and trial.fit is not None
            and (
                is_accepted(self.evidence, trial, baseline, baseline, False)
                if trial.name in flows
                else trial.name == ZERO and self._shifts(trial.fit, baseline)
            )
        ]

    def _shifts(self, fit: StructureFit, baseline: StructureFit) -> bool:
        """Tell whether a zero of the sensor is plainly off."""
        shifted, as_it_was = (
            (self.evidence.cost(other, WHITE_NOISE), self.evidence.held_out_error(other, WHITE))
            for other in (fit, baseline)
        )
        return shifted[0] < SHIFTED * as_it_was[0] and shifted[1] < as_it_was[1]

    def _from_replaced(
        self, decision: Decision, given: list[StructureFit], grown: Grown, trial: Trial
    ) -> Decision:
        """Decide once more with what the other laws build on as the first effect.

        It stays: the effects that were taken for it do better for as long as not all are there.
        """
        assert trial.fit is not None
        fits = [*given, trial.fit]
        further = self.growth.grown(decision.baseline, fits, len(given), n_kept=len(fits))
        trials = (trial, *(other for other in grown.trials if other is not trial))
        return self._judged(decision.baseline, further._replace(trials=trials))

    def _unread(self, decision: Decision) -> bool:
        """Tell whether readings stand plainly in steps, and no quantiser was found.

        Behind a quantiser a model that lacks something else misses whole steps, so that it explains the rows
        less well with than without it: which is no sign that there is none.
        """
        record = self.evidence.structure.record
        asked = any(effect.name == QUANTISER for effect in self.trials.candidates)
        return asked and QUANTISER not in decision.accepted and are_steps(record.y[record.learning, 0])

    def _behind_quantiser(self, trials: tuple[Trial, ...]) -> Iterator[StructureFit]:
        """Yield the best pair of a quantiser and one other effect."""
        fits = [trial.fit for trial in trials if trial.fit is not None and trial.name != QUANTISER]
        pair = self._best_with(QUANTISER, fits) if fits else None
        if pair is not None:
            yield pair

    def _otherwise(
        self, decision: Decision, trials: tuple[Trial, ...], pairs: Iterable[StructureFit] | None = None
    ) -> Decision:
        """Start again elsewhere where the leader leads to nothing that explains all.

        Alone, a look-alike can explain more than either of two effects that together explain everything.
        """
        for found in self._pairs(trials) if pairs is None else pairs:
            n_given = len(self.growth.given)
            pair = freed(self.evidence, reordered(self.evidence, found, n_given), n_given)
            pair = without_idle(self.evidence, pair, n_given)
            if len(pair.choices) == n_given + 1 and not self._stands_alone(pair, decision, trials):
                continue
            if not is_better_held_out(self.evidence, pair, decision.final):
                continue
            other = self._judged_pair(decision, pair, trials)
            close = other.verdict == "unexplained" and explains_most(other.left_share)
            if close and self.trials.allowance.permits(PROMISING):
                # The first was fitted without the second: search it again beside it.
                again = reordered(self.evidence, exchanged(self.trials, pair, n_given), n_given)
                other = self._judged_pair(decision, again, trials) if again is not pair else other
            # Found at a second attempt it must leave not even a trace.
            if other.verdict != "unexplained" and not leaves_a_trace(other):
                return other
        return decision

    def _stands_alone(self, fit: StructureFit, decision: Decision, trials: tuple[Trial, ...]) -> bool:
        """Tell whether all evidence agrees on the one effect of a pair beside which the other did nothing.

        It is a single candidate like those that growing has asked, be its minimum another one.
        """
        n_given, baseline = len(self.growth.given), decision.baseline
        before = decision.fits[n_given - 1] if n_given else baseline
        return any(
            is_accepted_at(self.evidence, trial, fit, before, baseline, False)
            for trial in trials
            if trial.name == fit.choices[-1].name
        )

    def _judged_pair(self, decision: Decision, pair: StructureFit, trials: tuple[Trial, ...]) -> Decision:
        evidence, baseline = self.evidence, decision.baseline
        rungs = rungs_to(evidence.structure, evidence.rows, pair, baseline, len(self.growth.given))
        return self.judge.verdict(baseline, rungs, trials, ())

    def _pairs(self, trials: tuple[Trial, ...]) -> Iterator[StructureFit]:
        """Yield pairs of effects to which the leader does not lead, the quickly found ones first.

        First those that the slopes beside single effects promise.  Then those that leave the least are added
        to each of the others: beside what is nearly right an effect is fitted as itself, where alone it
        stands in for something else, as do others beside it.  Then the runners-up, each with what is best
        beside it.
        """
        evidence = self.evidence
        fits = {trial.name: trial.fit for trial in trials if trial.fit is not None}
        yield from self._jump_at_edges(trials)
        foreseen = self._foreseen(trials) if self.trials.allowance.permits(PROMISING) else None
        if foreseen is not None:
            yield foreseen
        if len(fits) > 1:
            by_noise = min(fits, key=lambda name: evidence.own_criterion(fits[name]))
            by_error = min(fits, key=lambda name: evidence.cost(fits[name], WHITE_NOISE))
            for name in dict.fromkeys((by_noise, by_error)):
                if not self.trials.allowance.permits(PROMISING):
                    return
                pair = self._best_with(name, [fit for other, fit in fits.items() if other != name])
                if pair is not None:
                    yield pair
        for trial in trials[1 : 1 + RUNNERS_UP]:
            if trial.fit is None or not is_significant(evidence, trial):
                continue
            if not self.trials.allowance.permits():
                return
            found = self.trials.beside(trial.fit, True, BESIDE_RUNNER_UP)
            if found and found[0].fit is not None and found[0].gain > 0.0:
                yield found[0].fit

    def _jump_at_edges(self, trials: tuple[Trial, ...]) -> Iterator[StructureFit]:
        """Yield a dead zone before a jump where one of these leads, or a relay: both of them but for a slope.

        Each of the two alone hides the other: a dead zone that is too narrow has part of the jump in it.
        """
        pair = [e for name in (DEAD_ZONE, JUMP) for e in self.trials.candidates if e.name == name]
        near = [t for t in trials[:POLISHED] if t.name in (RELAY, DEAD_ZONE, JUMP) and t.fit is not None]
        if len(pair) < 2 or not near or near[0].fit is None or not is_significant(self.evidence, near[0]):
            return
        rows, found = self.evidence.rows, []
        for forms in zip(*(effect.found_by for effect in pair), strict=True):
            choices = [Choice(effect, form) for effect, form in zip(pair, forms, strict=True)]
            found.append(self.evidence.structure.fit(choices, rows, WHITE, near[0].fit, effort=Effort.FINE))
        yield from sorted(filter(lambda fit: fit.usable, found), key=self.evidence.own_criterion)[:1]

    def _foreseen(self, trials: tuple[Trial, ...]) -> StructureFit | None:
        """Return the best of those pairs that promise most."""
        fits = [t.fit for t in trials if t.fit is not None and is_significant(self.evidence, t)]
        return self._best_of(most_promising(self.evidence, fits, self.trials.candidates, FORESEEN))

    def _best_with(self, name: str, fits: Sequence[StructureFit]) -> StructureFit | None:
        """Return the best of some fits with one more effect."""
        (effect,) = (effect for effect in self.trials.candidates if effect.name == name)
        return self._best_of([(fit, effect) for fit in fits])

    def _best_of(self, pairs: Sequence[tuple[StructureFit, Effect]]) -> StructureFit | None:
        """Return the best fit with another effect beside it, the leading ones searched with more care."""

        def added(pair: tuple[StructureFit, Effect], effort: Effort) -> StructureFit | None:
            fit, effect = pair
            forms = effect.found_by if effort is Effort.FINE else effect.found_by[:1]
            return self.trials.best_form(fit, effect, forms, WHITE_NOISE, effort).fit

        def left(fit: StructureFit | None) -> float:
            return np.inf if fit is None else self.evidence.own_criterion(fit)

        leading = sorted(pairs, key=lambda pair: left(added(pair, Effort.COARSE)))[:PAIRED]
        return min((added(pair, Effort.FINE) for pair in leading), key=left, default=None)

    def memory(self, baseline: StructureFit) -> Trial:
        """Return the memory of the noise as a candidate beside the effects."""
        evidence, noise = self.evidence, self.evidence.noise(baseline)
        return Trial(
            NOISE_EFFECT,
            None,
            noise,
            criterion=evidence.own_criterion(baseline),
            gain=noise.gain,
            p_value=evidence.memory_p_value(noise),
            validation=evidence.held_out_error(baseline, WHITE),
        )


def _burden(decision: Decision) -> tuple[bool, float]:
    """Return by what decisions on the same record are compared: the smallest is the best.

    Beside something unexplained a name counts only if it at least halves what is left: more and more effects
    that are not there can follow one that is.
    """
    unexplained = decision.verdict == "unexplained"
    return unexplained, decision.left_share * 2.0 ** len(decision.rejected if unexplained else ())
