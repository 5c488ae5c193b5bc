"""The decision: which effects a model lacks, on evidence that all must agree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.decision import Decision, Trial
from sysid.diagnosis.effects.base import Effect, Floats
from sysid.diagnosis.evidence import block_separation
from sysid.diagnosis.noise_colour import Noise
from sysid.diagnosis.ranking import with_every_candidate
from sysid.diagnosis.residual_evidence import LEFT_P_VALUE, WHITE, interleaved
from sysid.diagnosis.structures import Structure, StructureFit, filtered
from sysid.diagnosis.trials import POLISHED, Trials
from sysid.progress import Progress

NOISE_EFFECT = "coloured_noise"
# How many are tried in the place of one that was accepted before.
EXCHANGED = 6
# How often a fit and the colour of its residual are brought to agree.
SETTLINGS = 2
# How many runners-up are tried before a record counts as unexplained, and how many beside each.
RUNNERS_UP, BESIDE_RUNNER_UP = 2, 4
# Two candidates are tied when their errors differ by less than so many standard errors.
TIED = 2.0
# A further effect must explain this share of what all effects explain, or it is a detail of the first.
LEAST_SHARE = 0.01
# Noise that is coloured beside an effect is a trace of something else if the probes find this.
SUSPECT_P_VALUE = 3e-3
# Something is left when the probes find this share of the explainable.
LEFT_SHARE, SUSPECT_SHARE = 0.01, 0.004
# Effects stay accepted beside something unexplained if they leave at most this share of the explainable.
LEAST_EXPLAINED = 0.9


class Search(Trials):
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
    given : sequence of Effect
        Effects that are in the model whatever the evidence.
    jobs : int
        Candidates fitted at a time, each by a thread of its own; the answer is the same.
    bars : Progress, optional
        Shows how many candidates of a round are fitted.
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
    ) -> None:
        super().__init__(structure, effects, alpha=alpha, seed=seed, given=given, jobs=jobs, bars=bars)
        self.max_effects = max_effects
        self.names = [effect.name for effect in effects]

    def decide(self) -> Decision:
        """Name what is missing."""
        decision = self._decided()
        final = decision.fits[-1] if decision.fits else decision.baseline
        if decision.verdict not in ("unexplained", "not-identifiable") and self._rows_disagree(final):
            self.rows, self.held_out = interleaved(self.structure.record.learning)
            decision = self._decided()
        leading = [self._settled(trial) for trial in decision.trials[:POLISHED]]
        decision = replace(decision, trials=(*leading, *decision.trials[POLISHED:]))
        return with_every_candidate(decision, self.names, self._memory(decision.baseline))

    def _settled(self, trial: Trial) -> Trial:
        """Refit a candidate under the colour of its own residual.

        It was weighted by the colour of what is left without it: no minimum of its own likelihood, so that
        its parameters would be off by more than their standard errors.
        """
        settled = trial
        for _ in range(SETTLINGS if trial.fit is not None else 0):
            assert settled.fit is not None
            noise = self._noise(settled.fit)
            fit = self.structure.fit(settled.fit.choices, self.rows, noise.polynomial, settled.fit, effort=0)
            if not fit.usable:
                break
            settled = replace(settled, fit=fit, noise=noise)
        return settled

    def _memory(self, baseline: StructureFit) -> Trial | None:
        """Return the memory of the noise as a candidate beside the others."""
        if NOISE_EFFECT not in self.names:
            return None
        noise, free_run = self._noise(baseline), self._held_out_error(baseline, WHITE)
        innovation = self._held_out_error(baseline, noise.polynomial)
        criterion = self._own_criterion(baseline)
        p_value = self._memory_p_value(noise)
        return Trial(NOISE_EFFECT, None, noise, criterion, noise.gain, p_value, free_run, innovation)

    def _decided(self) -> Decision:
        baseline = self.structure.baseline(self.rows)
        if not baseline.restarts_agree:
            unknown = float("nan")
            return Decision(
                "not-identifiable", baseline, (), (), (), (), self._noise(baseline), 1.0, 0.0, unknown
            )
        given = self._given_fits(baseline)
        fits, trials, tie = self._grown(baseline, given, len(given))
        decision = self._verdict(baseline, fits, trials, tie)
        for trial in self._replacing(decision):
            assert trial.fit is not None
            others, _, _ = self._grown(baseline, [*given, trial.fit], len(given))
            found = (trial, *(other for other in trials if other is not trial))
            decision = min(decision, self._verdict(baseline, others, found, ()), key=lambda d: d.left_share)
        if decision.verdict == "unexplained" and self.max_effects > 1:
            return self._otherwise(decision, trials)
        return decision

    def _replacing(self, decision: Decision) -> list[Trial]:
        """Return laws of flow that are worth a search of their own where nothing explains.

        They replace a law of the model, so they need not show beside an effect that was taken for them.
        """
        if decision.verdict != "unexplained" or decision.left_share <= 1.0 - LEAST_EXPLAINED:
            return []
        flows = {effect.name for effect in self.candidates if effect.port == "flow"}
        return [
            trial
            for trial in decision.trials
            if trial.name in flows - set(decision.rejected)
            and trial.fit is not None
            and self._accepted(trial, decision.baseline, decision.baseline, False)
        ]

    def _grown(
        self, baseline: StructureFit, fits: list[StructureFit], n_given: int
    ) -> tuple[list[StructureFit], tuple[Trial, ...], tuple[str, ...]]:
        """Add effects while all evidence agrees; return the fits, the single candidates, and a tie."""
        trials: tuple[Trial, ...] = ()
        tie: tuple[str, ...] = ()
        while len(fits) < self.max_effects + n_given:
            current = fits[-1] if fits else baseline
            further = len(fits) > n_given
            found = self._round(current, further)
            if not further:
                trials = found
            best = found[0] if found else None
            if best is None or best.fit is None:
                break
            chosen = self._first_accepted(found, current, baseline, further)
            if chosen is not None and chosen.fit is not None:
                grown = chosen.fit
                found = (chosen, *(trial for trial in found if trial is not chosen))
                trials = trials if further else found
            else:
                pair = self._with_another(best, current, baseline, len(fits))
                if pair is None:
                    break
                grown = pair
            if not further:
                tie = self._tied(found)
            if len(grown.choices) > n_given + 1:
                grown = self._pruned(self._exchanged(grown, n_given), n_given)
            no_larger = len(grown.choices) <= len(current.choices)
            if no_larger and self._own_criterion(grown) >= self._own_criterion(current):
                break
            fits = self._rungs(grown, baseline, n_given)
        return fits, trials, tie

    def _otherwise(self, decision: Decision, trials: tuple[Trial, ...]) -> Decision:
        """Start again from the runners-up where the leader leads to nothing that explains all.

        Alone, a look-alike can explain more than either of two effects that together explain everything.
        """
        final = decision.fits[-1] if decision.fits else decision.baseline
        for trial in trials[1 : 1 + RUNNERS_UP]:
            if trial.fit is None or trial.p_value >= self.alpha or trial.gain <= 0.0:
                continue
            found = self._round(trial.fit, True, BESIDE_RUNNER_UP)
            if not found or found[0].fit is None or not found[0].gain > 0.0:
                continue
            pair = found[0].fit
            if not self._better_held_out(pair, final):
                continue
            other = self._verdict(
                decision.baseline, self._rungs(pair, decision.baseline, len(self.given)), trials, ()
            )
            # Found at a second attempt it must leave not even a trace.
            trace = other.left_p_value < SUSPECT_P_VALUE and other.left_share > SUSPECT_SHARE
            if other.verdict != "unexplained" and not trace:
                return other
        return decision

    def _better_held_out(self, fit: StructureFit, other: StructureFit) -> bool:
        """Tell whether a fit is better by its criterion and by its free run on held-out rows."""
        return self._own_criterion(fit) < self._own_criterion(other) and self._held_out_error(
            fit, WHITE
        ) < self._held_out_error(other, WHITE)

    def _given_fits(self, baseline: StructureFit) -> list[StructureFit]:
        fits: list[StructureFit] = []
        for effect in self.given:
            white = Noise(WHITE, 0.0, 0.0)
            trial = self._fitted(fits[-1] if fits else baseline, effect, effect.forms, white, 2)
            if trial.fit is not None:
                fits.append(trial.fit)
        return fits

    def _accepted(self, trial: Trial, current: StructureFit, baseline: StructureFit, further: bool) -> bool:
        """Tell whether all evidence agrees that an effect is there."""
        assert trial.fit is not None
        agreed = (
            trial.p_value < self.alpha
            and trial.gain > 0.0
            and self._own_criterion(trial.fit) < self._own_criterion(current)
            and self._holds(trial, current)
        )
        if not agreed or not further:
            return agreed
        whole = self._cost(baseline, Noise(WHITE, 0.0, 0.0)) - self._cost(trial.fit, Noise(WHITE, 0.0, 0.0))
        step = self._cost(current, Noise(WHITE, 0.0, 0.0)) - self._cost(trial.fit, Noise(WHITE, 0.0, 0.0))
        return step > LEAST_SHARE * whole

    def _first_accepted(
        self, trials: Sequence[Trial], current: StructureFit, baseline: StructureFit, further: bool
    ) -> Trial | None:
        """Return the best of the leading candidates on which all evidence agrees.

        Where the best by the criterion does not hold on held-out rows, one that predicts them better may.
        """
        for trial in trials[:POLISHED]:
            leads = trial is trials[0] or trial.validation < trials[0].validation
            if trial.fit is not None and leads and self._accepted(trial, current, baseline, further):
                return trial
        return None

    def _with_another(
        self, best: Trial, current: StructureFit, baseline: StructureFit, n_before: int
    ) -> StructureFit | None:
        """Return a pair of effects that holds on held-out rows where the better one alone does not."""
        significant = best.p_value < self.alpha and best.gain > 0.0
        if not significant or best.fit is None or n_before + 2 > self.max_effects + len(self.given):
            return None
        found = self._round(best.fit, True)
        if not found or found[0].fit is None:
            return None
        # The first was fitted without the second: search it again beside it.
        pair = self._exchanged(found[0].fit, len(self.given))
        second = replace(
            found[0], fit=pair, noise=self._noise(pair), validation=self._held_out_error(pair, WHITE)
        )
        return pair if self._accepted(second, current, baseline, n_before > 0) else None

    def _holds(self, trial: Trial, current: StructureFit) -> bool:
        """Tell whether an effect holds on held-out rows.

        The free-run error must fall and the innovations not rise by more than chance.  Under coloured
        noise the free-run error of a small effect is a matter of luck: then the innovations must fall
        and the free-run error not rise by more than chance.
        """
        assert trial.fit is not None
        after = self._residual(trial.fit)

        def errors(noise: Floats, before: StructureFit) -> tuple[float, float]:
            first = filtered(self._residual(before), self.held_out, noise)
            second = filtered(after, self.held_out, noise)
            return float(second @ second - first @ first), block_separation(first, second)

        innovations = errors(trial.noise.polynomial, self._refitted(current, trial.noise))
        free_run = errors(WHITE, current)
        if free_run[0] < 0.0:
            return innovations[1] < TIED
        return trial.noise.order > 0 and innovations[0] < 0.0 and free_run[1] < TIED

    def _exchanged(self, fit: StructureFit, n_given: int) -> StructureFit:
        """Try to replace each earlier effect by another: the first was chosen before the others."""
        for position in range(n_given, len(fit.choices) - 1):
            others = tuple(c for i, c in enumerate(fit.choices) if i != position)
            noise = self._colour(fit)
            without = self.structure.fit(others, self.rows, noise.polynomial, fit, effort=0)
            if not without.usable:
                continue
            options = [e for e in self.candidates if e.name not in without.names]
            statistics = self._screen(without, options, noise).statistics
            options.sort(key=lambda e: -statistics[e.name])
            trials = self._trials(without, options[:EXCHANGED], noise)
            if (
                trials
                and trials[0].fit is not None
                and trials[0].criterion < self._criterion(fit, noise) - 1e-6
            ):
                fit = trials[0].fit
        return fit

    def _pruned(self, fit: StructureFit, n_given: int) -> StructureFit:
        """Leave out effects that the information criterion does not want any more."""
        while len(fit.choices) > max(n_given, 1):
            noise = self._colour(fit)
            smaller = [
                self.structure.fit(
                    tuple(c for c in fit.choices if c is not left), self.rows, noise.polynomial, fit, effort=0
                )
                for left in fit.choices[n_given:]
            ]
            criteria = [self._criterion(other, noise) if other.usable else np.inf for other in smaller]
            best = smaller[int(np.argmin(criteria))]
            if min(criteria) > self._criterion(fit, noise):
                break
            fit = best
        return fit

    def _rungs(self, fit: StructureFit, baseline: StructureFit, n_given: int) -> list[StructureFit]:
        """Return fits with one, two, ... of the effects, the one that explains most first."""
        chosen, rest = list(fit.choices[:n_given]), list(fit.choices[n_given:])
        rungs: list[StructureFit] = []
        for count in range(1, n_given + 1):
            rungs.append(self.structure.fit(chosen[:count], self.rows, WHITE, baseline, effort=1))
        while len(rest) > 1:
            start = rungs[-1] if rungs else baseline
            options = [
                self.structure.fit((*chosen, choice), self.rows, WHITE, start, effort=1) for choice in rest
            ]
            best = int(np.argmin([option.cost for option in options]))
            chosen.append(rest.pop(best))
            rungs.append(options[best])
        return [*rungs, fit] if rest else rungs

    def rungs_of(self, decision: Decision, kept: Sequence[str]) -> list[StructureFit]:
        """Return the fits with one, two, ... of the kept effects."""
        if not decision.fits or not kept:
            return []
        if len(kept) == len(decision.fits):
            return list(decision.fits)
        choices = [c for c in decision.fits[-1].choices if c.name in kept]
        fits, current = [], decision.baseline
        for count in range(1, len(choices) + 1):
            current = self.structure.fit(choices[:count], self.rows, WHITE, current, effort=2)
            fits.append(current)
        return fits

    def _tied(self, trials: Sequence[Trial]) -> tuple[str, ...]:
        """Return the first candidate with those that a paired block test cannot tell from it."""
        best = trials[0]
        assert best.fit is not None
        noise, rows = best.noise.polynomial, self.structure.record.learning
        own = filtered(self._residual(best.fit), rows, noise)
        equals = [
            trial.name
            for trial in trials[1:]
            if trial.fit is not None
            and trial.p_value < self.alpha
            and trial.gain > 0.0
            and block_separation(own, filtered(self._residual(trial.fit), rows, noise)) < TIED
        ]
        return (best.name, *equals) if equals else ()

    def _verdict(
        self,
        baseline: StructureFit,
        fits: Sequence[StructureFit],
        trials: tuple[Trial, ...],
        tie: tuple[str, ...],
    ) -> Decision:
        fits = self._polished(fits)
        final = fits[-1] if fits else baseline
        noise, given = self._noise(final), tuple(effect.name for effect in self.given)
        left_p, left_share, floor = self._left(baseline, final, self.rows)
        accepted = self._order(fits)
        suspect = bool(fits) and noise.order > 0 and self._noise_accepted(final, noise)
        chance, share = LEFT_P_VALUE, LEFT_SHARE
        if suspect:
            # All rows that may be learnt from: a trace is weaker than what the search stopped at.
            left_p, left_share, floor = self._left(baseline, final, self.structure.record.learning)
            chance, share = SUSPECT_P_VALUE, SUSPECT_SHARE
        if left_p < chance and left_share > share:
            useful = left_share <= 1.0 - LEAST_EXPLAINED
            rungs = tuple(fits if useful else fits[: len(given)])
            return Decision(
                "unexplained", baseline, rungs, tuple(accepted) if useful else given, trials, (), noise,
                left_p, left_share, floor, tuple(accepted), given,
            )  # fmt: skip
        if NOISE_EFFECT in self.names and noise.order and self._noise_accepted(final, noise):
            accepted.append(NOISE_EFFECT)
        verdict = "missing-effect" if fits else ("coloured-noise" if accepted else "nothing-missing")
        return Decision(
            verdict, baseline, tuple(fits), tuple(accepted), trials, tie, noise, left_p, left_share, floor,
            (), given,
        )  # fmt: skip

    def _order(self, fits: Sequence[StructureFit]) -> list[str]:
        """Return the accepted effects in the order of the rungs."""
        names: list[str] = []
        for fit in fits:
            names += [name for name in fit.names if name not in names]
        return names

    def _polished(self, fits: Sequence[StructureFit]) -> Sequence[StructureFit]:
        """Refit the last model by its plain error where the noise seems to have a memory.

        What was fitted under a colour leaves some error where that colour has weight.  If the memory
        goes with the refit it was not the noise's.
        """
        if not fits or not self._noise_accepted(fits[-1], self._noise(fits[-1])):
            return fits
        plain = self.structure.fit(fits[-1].choices, self.rows, WHITE, fits[-1], effort=0)
        remains = not plain.usable or self._noise_accepted(plain, self._noise(plain))
        return fits if remains else [*fits[:-1], plain]
