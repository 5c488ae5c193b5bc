"""The verdict on a model with the effects that were found: is anything left that nothing explains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision, Trial
from sysid.diagnosis.decide.innovations import Foreseen, foreseen, uneven
from sysid.diagnosis.decide.modes import MODE
from sysid.diagnosis.decide.noise_colour import Noise
from sysid.diagnosis.decide.residual_evidence import LEFT_P_VALUE, Evidence
from sysid.diagnosis.decide.stand_ins import stand_in
from sysid.diagnosis.structures.structure import WHITE, Effort, StructureFit, with_fine_steps

# Noise that is coloured beside an effect is a trace of something else if the probes find this.
SUSPECT_P_VALUE = 3e-3
# Something is left when the probes find this share of the explainable.
LEFT_SHARE, SUSPECT_SHARE = 0.01, 0.004
# Beside true effects white noise is left alone; those that only resemble what is missing leave a trace.  Of
# two or more, which can resemble a third together, less of a proof is asked for.
TRACE_P_VALUE, TRACE_SHARE = 1e-4, 0.001
# What is found at a second attempt must leave less.
LEAST_TRACE = 0.0005
# Where everything is significant, effects explain a record unless they leave more than they explain.
MOST_LEFT = 0.5
# Effects stay accepted beside something unexplained if they leave at most this share of the explainable.
LEAST_EXPLAINED = 0.9
# What is left beside effects that stand is a detail of its own up to this share of the explainable, but not
# beside so many: these can follow anything, and leave what they cannot.
DETAIL_SHARE, MANY = 0.03, 3


@dataclass(frozen=True, eq=False)
class Judge:
    """Gives the verdict on fits with effects.

    Attributes
    ----------
    evidence : Evidence
    given : tuple of str
        Effects that are in the model whatever the evidence.
    memory_asked : bool
        Whether the memory of the noise is a candidate.
    """

    evidence: Evidence
    given: tuple[str, ...]
    memory_asked: bool

    def verdict(
        self,
        baseline: StructureFit,
        fits: Sequence[StructureFit],
        trials: tuple[Trial, ...],
        ties: tuple[tuple[Trial, ...], ...],
        fed_back: bool = False,
    ) -> Decision:
        """Judge the last of the fits, which has all effects, by what it leaves.

        Parameters
        ----------
        baseline : StructureFit
        fits : sequence of StructureFit
            With one, two, ... effects.
        trials : tuple of Trial
            All single candidates.
        ties : tuple of tuple of Trial
            Accepted effects, each with the candidates that cannot be told from it.
        fed_back : bool
            Whether what is left is known to be noise that a controller handed on to the input.
        """
        evidence = self.evidence
        if fits:  # what coarse steps do wrong is left, too, but not missing
            fits = [*fits[:-1], with_fine_steps(evidence.structure, fits[-1], WHITE)]
        fits = self._polished(fits)
        final = fits[-1] if fits else baseline
        noise = evidence.noise(final)
        coloured = evidence.noise_accepted(final, noise)
        accepted = _in_order(fits)
        composed = len(final.choices) > len(self.given) + 1
        # All rows that may be learnt from: a trace is weaker than what the search stopped at, and what varies
        # in time shows better, or only, in more of it.
        rows = evidence.structure.record.learning
        chance, share = self._something_left(bool(fits), composed, coloured)
        left_p, left_share, floor = evidence.left(baseline, self._on_all(final, rows), rows)
        stands_in = bool(fits) and not evidence.smooth and stand_in(evidence, final, composed, coloured)
        if fed_back:
            left_p, left_share, floor = 1.0, 0.0, float(np.sqrt(np.mean(evidence.residual(final)[rows] ** 2)))
        lost = bool(fits) and self._lost(baseline, final)
        if lost or (not fed_back and (stands_in or (left_p < chance and left_share > share))):
            useful = explains_most(left_share) and not lost
            rungs = tuple(fits if useful else fits[: len(self.given)])
            return Decision(
                "unexplained", baseline, rungs, tuple(accepted) if useful else self.given, trials, (), noise,
                left_p, left_share, floor, tuple(accepted), self.given, stands_in=stands_in,
            )  # fmt: skip
        told = None if fits or fed_back else self._foretold(final, noise, coloured)
        if told is not None:
            return Decision(
                "unexplained", baseline, (), self.given, trials, (), noise, told.p_value, 1.0, floor,
                (), self.given, size_foretold=told.of_size,
            )  # fmt: skip
        if self.memory_asked and coloured:
            accepted.append(NOISE_EFFECT)
        verdict = "missing-effect" if fits else ("coloured-noise" if accepted else "nothing-missing")
        return Decision(
            verdict, baseline, tuple(fits), tuple(accepted), trials, ties, noise, left_p, left_share, floor,
            (), self.given, fed_back,
        )  # fmt: skip

    def _foretold(self, final: StructureFit, noise: Noise, coloured: bool) -> Foreseen | None:
        """Return what foretells innovations that are none, or their size; None where it is noise.

        It is asked without effects only.  Beside true ones a measured record holds details, which every
        innovation follows, and a size goes with the signals wherever a kink lies not quite in its place.
        """
        record, rows = self.evidence.structure.record, self.evidence.structure.record.learning
        # A plant fitted by plain errors gives way to a disturbance, and is wrong wherever the input steps.
        moved = self.evidence.refitted(final, noise)
        told = [uneven(record, rows, self.evidence.residual(moved), noise.polynomial)]
        if coloured:
            told.append(foreseen(record, rows, self.evidence.residual(final), noise.polynomial))
        return next((one for one in told if one.plainly), None)

    def _lost(self, baseline: StructureFit, final: StructureFit) -> bool:
        """Tell whether effects have brought nothing: the plant is lost on held-out rows as without them."""
        evidence = self.evidence
        y = evidence.structure.record.y[evidence.held_out, 0]
        before, after = (evidence.held_out_error(fit, WHITE) for fit in (baseline, final))
        return after > max(before, float(np.nanstd(y)))

    def _on_all(self, fit: StructureFit, rows: Mask) -> StructureFit:
        """Return a fit with effects as it is on all rows that may be learnt from.

        The rows of a search tell a threshold of the input only to lie between two of their inputs, and a side
        of a law that they hardly reach next to not at all: what others tell of it is not missing.
        """
        if not fit.choices:
            return fit
        moved = self.evidence.structure.fit(fit.choices, rows, WHITE, fit, effort=Effort.REFIT)
        return moved if moved.usable else fit

    def _something_left(self, effects: bool, composed: bool, coloured: bool) -> tuple[float, float]:
        """Return below which chance and above which share of the explainable something is left.

        Of a model with ``effects`` or without, of two or more that are ``composed``, with noise that is
        ``coloured``.
        """
        if not effects:
            return LEFT_P_VALUE, LEFT_SHARE
        chance = SUSPECT_P_VALUE if composed or coloured else TRACE_P_VALUE
        if self.evidence.smooth:
            return chance, MOST_LEFT
        return chance, SUSPECT_SHARE if coloured and not composed else TRACE_SHARE

    def _polished(self, fits: Sequence[StructureFit]) -> Sequence[StructureFit]:
        """Refit the last model by its plain error where the noise seems to have a memory.

        What was fitted under a colour leaves some error where that colour has weight.  If the memory
        goes with the refit it was not the noise's.
        """
        evidence = self.evidence
        if not fits or not evidence.noise_accepted(fits[-1], evidence.noise(fits[-1])):
            return fits
        plain = evidence.structure.fit(fits[-1].choices, evidence.rows, WHITE, fits[-1], effort=Effort.REFIT)
        remains = not plain.usable or evidence.noise_accepted(plain, evidence.noise(plain))
        return fits if remains else [*fits[:-1], plain]


def explains_most(left_share: float) -> bool:
    """Tell whether effects that leave this share of the explainable are worth keeping."""
    return left_share <= 1.0 - LEAST_EXPLAINED


def with_a_detail_left(decision: Decision) -> Decision:
    """Return the verdict on effects each of which counts and which no free-form curve outdoes.

    A true effect beside a small one that nobody listed leaves as much as a look-alike does: some per cent, of
    which a long or quiet record is sure.  What tells them apart is that one curve explains what look-alikes
    share out among them.  Where the cause has a memory no curve does; then a mode among the effects gives it
    away, for in parallel it takes up what any memory does.
    """
    if len(decision.fits) >= len(decision.given) + MANY:
        return decision
    if decision.stands_in or MODE in decision.final.names or decision.left_share > DETAIL_SHARE:
        return decision
    return replace(decision, verdict="missing-effect", rejected=())


def leaves_a_trace(decision: Decision) -> bool:
    """Tell whether a model that seems to explain all still leaves more than nothing."""
    return decision.left_p_value < SUSPECT_P_VALUE and decision.left_share > LEAST_TRACE


def _in_order(fits: Sequence[StructureFit]) -> list[str]:
    """Return the effects in the order of the rungs."""
    names: list[str] = []
    for fit in fits:
        names += [name for name in fit.names if name not in names]
    return names
