"""Candidates beside the effects of a model: screened, fitted with growing care, judged."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from sysid.diagnosis.decide.allowance import PROMISING, Allowance
from sysid.diagnosis.decide.decision import Trial
from sysid.diagnosis.decide.evidence import ScoreScreen, score_screen
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE, Noise
from sysid.diagnosis.decide.paths import begun_elsewhere
from sysid.diagnosis.decide.residual_evidence import Evidence
from sysid.diagnosis.effects.base import Effect, Floats, Form
from sysid.diagnosis.structures.pointwise import MEMORY
from sysid.diagnosis.structures.structure import (
    WHITE,
    Choice,
    Effort,
    StructureFit,
    filtered,
    with_fine_steps,
)
from sysid.diagnosis.structures.thresholds import is_switched_by_input
from sysid.progress import Progress

# How many candidates are fitted at all, in all their forms, and with the finest search.
SCREENED, REFINED, POLISHED = 12, 6, 3
# How many are fitted beside effects that were accepted before or in a search that spares, in all forms, and
# finest.
FURTHER, REFINED_BESIDE, POLISHED_BESIDE = 8, 4, 2
# How many are fitted beside others once the search has taken more work than its later stages may begin with.
FURTHER_LATE = 5
# Of the criterion: beneath it two fits are one; beneath this they cannot be told apart (Kass & Raftery 1995,
# Journal of the American Statistical Association 90: "not worth more than a bare mention").
SAME_RUN, BARE_MENTION = 0.1, 2.0
# A model that leaves this share of the squared deviations has lost its plant.
MOST_LOST = 0.7

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Trials:
    """Tries effects one at a time in a model of one record.

    Attributes
    ----------
    evidence : Evidence
        By which they are judged.
    candidates : tuple of Effect
    seed : int
        Of the simulated null distribution.
    jobs : int
        Candidates fitted at a time, each by a thread of its own; the answer is the same.
    bars : Progress
        Shows how many candidates of a round are fitted.
    allowance : Allowance, optional
        How far the search may go; to its end by default.
    """

    evidence: Evidence
    candidates: tuple[Effect, ...]
    seed: int
    jobs: int
    bars: Progress
    allowance: Allowance = field(default_factory=Allowance)

    def beside(self, current: StructureFit, further: bool, most: int = FURTHER) -> tuple[Trial, ...]:
        """Try every candidate beside the effects of a fit; return them best first."""
        candidates = [e for e in self.candidates if e.name not in current.names]
        if not candidates:
            return ()
        colour = self.evidence.colour(current)
        # Scores are those of the best fit only under the colour by which they are weighted.
        screen = self.screen(self.evidence.refitted(current, colour), candidates, colour)
        if further and self._nothing_left(current, candidates, screen):
            return ()
        if further and not self.allowance.permits_beside(len(current.choices) - self.evidence.n_given):
            return ()
        ranking = sorted(candidates, key=lambda e: -screen.statistics[e.name])
        # A family whose fits are cheap may ask for more of them than the screen would let through.
        count: int = getattr(self.evidence.structure, "screened", SCREENED)
        if further or self.allowance.spares:
            count = min(count, most if self.allowance.permits(PROMISING) else FURTHER_LATE)
        lost = self._lost(current) and (not further or self.allowance.permits())
        chosen = [
            e
            for i, e in enumerate(ranking)
            if i < count
            or (lost and may_hold(e))
            or (not further and may_be_uneven(e))
            or self._without_slope(e, current)
        ]
        trials = self.ranked(current, chosen, colour)
        left = [Trial(e.name, None, WHITE_NOISE, np.inf, -np.inf) for e in ranking if e not in chosen]
        return self._judged(current, [*trials, *left], screen, colour)

    def _nothing_left(self, current: StructureFit, candidates: Sequence[Effect], screen: ScoreScreen) -> bool:
        """Tell whether the residual holds no structure any more, but for what coarse steps do wrong."""

        def is_chance(screen: ScoreScreen) -> bool:
            return screen.p_value(max(screen.statistics.values())) >= self.evidence.alpha

        if is_chance(screen):
            return True
        fine = with_fine_steps(self.evidence.structure, current, WHITE)
        if fine is current:
            return False
        colour = self.evidence.colour(fine)
        return colour.order == 0 and is_chance(self.screen(fine, candidates, colour))

    def _lost(self, current: StructureFit) -> bool:
        """Tell whether a model follows next to nothing, so that slopes along its run say nothing of a force.

        A body without its spring drifts away from all that is measured: how the spring would act there is no
        matter of small changes.
        """
        y = self.evidence.structure.record.y[self.evidence.rows, 0]
        return self.evidence.cost(current, WHITE_NOISE) > MOST_LOST * float(np.sum((y - np.mean(y)) ** 2))

    def _without_slope(self, effect: Effect, current: StructureFit) -> bool:
        """Tell whether a score says nothing of an effect that the measured output allows.

        A map without parameters, such as a rectifier, cannot be small: where it folds the signal over, the
        model without it follows nothing, and the slope there is blind.
        """
        left = self.evidence.cost(current, WHITE_NOISE)
        y = self.evidence.structure.record.y[self.evidence.rows, 0]
        return any(
            not form.parameters and float(np.sum(np.minimum(y - form.lowest, 0.0) ** 2)) < left
            for form in effect.forms
            if np.isfinite(form.lowest)
        )

    def ranked(self, current: StructureFit, candidates: Sequence[Effect], noise: Noise) -> list[Trial]:
        """Fit the candidates, the better ones with more care; return them best first."""
        first = len(current.choices) == self.evidence.n_given and not self.allowance.spares
        refined, polished = (REFINED, POLISHED) if first else (REFINED_BESIDE, POLISHED_BESIDE)

        def simply(effect: Effect) -> Trial:
            # Half-wave and full-wave are different effects, as are a rim and a cascade of tanks, or a contact
            # that hardens and one that yields; a two-sided form is a refinement.
            size = len(effect.forms[0].parameters)
            whole = effect.port == "flow" or any(form.state for form in effect.forms)
            simple = [form for form in effect.found_by if whole or len(form.parameters) <= size]
            return self.best_form(current, effect, simple, noise, Effort.COARSE)

        lost = self._lost(current) and (not current.choices or self.allowance.permits())
        blind = {e.name for e in candidates if may_hold(e)} if lost else set()
        uneven = {e.name for e in candidates if first and may_be_uneven(e)}
        beside = f" beside {' and '.join(current.names)}" if current.choices else ""
        tried = self._each(f"candidates{beside}", simply, candidates)
        found = {trial.name: trial for trial in tried}
        for effort, count in ((Effort.COARSE, refined), (Effort.FINE, polished)):
            order = sorted(found.values(), key=lambda t: t.criterion)
            # From a run that is lost a coarse search says no more of a force than its slope, and from a limit
            # that is the same on both sides one no more that is reached on one side only.
            also = blind if effort is Effort.FINE else uneven
            leaders = [t for i, t in enumerate(order) if i < count or t.name in also]

            def carefully(trial: Trial, effort: Effort = effort) -> Trial:
                effect = next(e for e in candidates if e.name == trial.name)
                forms = effect.found_by[1:] if effort is Effort.COARSE else effect.found_by
                return self.best_form(current, effect, forms, noise, effort)

            for trial in self._each(f"leaders{beside}", carefully, leaders):
                if trial.criterion < found[trial.name].criterion:
                    found[trial.name] = trial
        base = self.evidence.criterion(self.evidence.refitted(current, noise), noise)
        trials = [replace(t, gain=base - t.criterion) for t in found.values()]
        return _switch_first(_without_memory_first(sorted(trials, key=lambda t: t.criterion)))

    def amended(
        self, current: StructureFit, trials: tuple[Trial, ...], fit: StructureFit
    ) -> tuple[Trial, ...]:
        """Return trials among which one effect stands as a longer search found it, beside others since left.

        Parameters
        ----------
        current : StructureFit
            The model beside which the candidates were tried.
        trials : tuple of Trial
            Best first.
        fit : StructureFit
            With one effect more than ``current``.

        Returns
        -------
        tuple of Trial
            Best first; the same where the effect stands no better.
        """
        evidence, name = self.evidence, fit.choices[-1].name
        colour = evidence.colour(current)
        before, after = (evidence.refitted(each, colour) for each in (current, fit))
        fit = min((f for f in (fit, after) if f.usable), key=lambda f: evidence.criterion(f, colour))
        criterion = evidence.criterion(fit, colour)
        if any(trial.name == name and trial.criterion - criterion < SAME_RUN for trial in trials):
            return trials
        found = Trial(name, fit, colour, criterion, evidence.criterion(before, colour) - criterion)
        others = [trial for trial in trials if trial.name != name]
        place = sum(trial.criterion < criterion for trial in others)
        names = {trial.name for trial in trials}
        screen = self.screen(before, [e for e in self.candidates if e.name in names], colour)
        (judged,) = self._judged(current, [found], screen, colour)
        return (*others[:place], judged, *others[place:])

    def _each(self, what: str, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """Apply a function to each item, several at a time if so many jobs may run, results in order."""
        work = list(items)
        with self.bars.task(what, len(work)) as bar:

            def counted(item: Item) -> Result:
                result = function(item)
                bar.advance()
                return result

            if self.jobs == 1 or len(work) < 2:
                return [counted(item) for item in work]
            from joblib import Parallel, delayed

            # The simulations run without the interpreter's lock, so threads do, and nothing is copied.
            return list(Parallel(n_jobs=self.jobs, prefer="threads")(delayed(counted)(item) for item in work))

    def best_form(
        self, current: StructureFit, effect: Effect, forms: Sequence[Form], noise: Noise, effort: Effort
    ) -> Trial:
        """Fit an effect in some of its forms; return the best."""
        best = Trial(effect.name, None, WHITE_NOISE, np.inf)
        for form in effect.forms:
            if form not in forms:
                continue
            fit = self._beside(current, Choice(effect, form), noise, effort)
            if not fit.usable:
                continue
            if effort is Effort.FINE:
                fit = begun_elsewhere(self.evidence, fit, noise, self.evidence.n_given)
            criterion = self.evidence.criterion(fit, noise)
            if criterion < best.criterion:
                best = Trial(effect.name, fit, noise, criterion)
        return best

    def _beside(self, current: StructureFit, new: Choice, noise: Noise, effort: Effort) -> StructureFit:
        """Fit an effect behind those that are there, and what jumps also before the maps at its port.

        What a sensor adds behind its counts moves all of them: taken off before, it leaves none to be seen.
        """
        structure, rows = self.evidence.structure, self.evidence.rows
        there = current.choices
        orders = [(*there, new)]
        before = [i for i, choice in enumerate(there) if choice.effect.port == new.effect.port]
        if new.form.jumps and before and before[0] >= self.evidence.n_given:
            orders.append((*there[: before[0]], new, *there[before[0] :]))
        # The colour without it is that of its steps: by it these are the wildest of innovations.
        colours = [noise.polynomial, *([WHITE] if new.form.jumps and noise.order > 0 else [])]
        fits = [
            structure.fit(choices, rows, colour, current, effort=effort)
            for choices in orders
            for colour in colours
        ]
        if len(fits) == 1:
            return fits[0]
        return min(fits, key=lambda one: self.evidence.cost(one, WHITE_NOISE) if one.usable else np.inf)

    def _judged(
        self, current: StructureFit, trials: Sequence[Trial], screen: ScoreScreen, colour: Noise
    ) -> tuple[Trial, ...]:
        """Add p-values and held-out errors to the trials."""
        evidence = self.evidence
        base = evidence.cost(evidence.refitted(current, colour), colour)
        costs = [evidence.cost(trial.fit, colour) for trial in trials if trial.fit is not None]
        variance = min([base, *costs]) / max(int(evidence.rows.sum()) - current.n_parameters, 1)
        variance = max(variance, self._rounding())
        found = []
        for trial in trials:
            statistic = screen.statistics[trial.name]
            if trial.fit is None:
                found.append(replace(trial, p_value=screen.p_value(statistic)))
                continue
            ratio = (base - evidence.cost(trial.fit, colour)) / variance
            by_fit = screen.fitted_p_value(ratio, trial.fit.n_parameters - current.n_parameters)
            found.append(
                replace(
                    trial,
                    noise=evidence.noise(trial.fit),
                    p_value=min(screen.p_value(statistic), by_fit),
                    validation=evidence.held_out_error(trial.fit, WHITE),
                    looks=screen.n_points,
                )
            )
        return tuple(found)

    def _rounding(self) -> float:
        """Return the variance below which a residual is the rounding of the arithmetic."""
        measured = self.evidence.structure.record.y[self.evidence.rows, 0]
        return float(np.finfo(float).eps * np.max(np.abs(measured))) ** 2

    def screen(self, current: StructureFit, candidates: Sequence[Effect], noise: Noise) -> ScoreScreen:
        """Score each candidate by the directions in which it would change the free run of a fit."""

        def white(columns: Floats) -> Floats:
            # A direction in which the run diverges says nothing.
            known = columns if np.isfinite(columns).all() else np.zeros_like(columns)
            return filtered(known, self.evidence.rows, noise.polynomial)

        directions = {
            effect.name: [white(block) for block in self.evidence.structure.directions(current, effect)]
            for effect in candidates
        }
        tangent = white(self.evidence.structure.tangent(current))
        rng = np.random.default_rng([self.seed, len(current.choices)])
        variance = max(noise.variance, self._rounding())
        return score_screen(white(self.evidence.residual(current)), tangent, directions, variance, rng)


def may_hold(effect: Effect) -> bool:
    """Tell whether an effect is a force that could keep a body where it was measured: friction does not."""
    return effect.port == "force" and not effect.dry and not any(form.state for form in effect.forms)


def may_be_uneven(effect: Effect) -> bool:
    """Tell whether an effect is looked for with one value for both sides and with sides of their own."""
    return len({len(form.parameters) for form in effect.found_by if form.smooth}) > 1


def _switch_first(trials: list[Trial]) -> list[Trial]:
    """Put a switch before smooth maps that do the same: they do so only at their own degenerate end.

    A limit below all that comes in is a relay, whose level is the model's gain; so is a jump beside which the
    slope is lost, and its last bit of freedom follows the noise.
    """
    same = [trial for trial in trials if trial.criterion - trials[0].criterion < BARE_MENTION]
    if len(same) < 2 or trials[0].gain <= 0.0:
        return trials
    return [*sorted(same, key=lambda trial: not _switches(trial)), *trials[len(same) :]]


def _without_memory_first(trials: list[Trial]) -> list[Trial]:
    """Put a switch before one with a memory that does the same: its two thresholds are then one."""
    order = list(trials)
    for i, (first, second) in enumerate(pairwise(trials)):
        same = second.criterion - first.criterion < SAME_RUN and _switches(first) and _switches(second)
        if same and first.name in MEMORY and second.name not in MEMORY:
            order[i : i + 2] = second, first
    return order


def _switches(trial: Trial) -> bool:
    return trial.fit is not None and is_switched_by_input(trial.fit.choices, len(trial.fit.choices) - 1)
