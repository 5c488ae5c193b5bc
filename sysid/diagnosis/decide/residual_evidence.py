"""What the residuals of one record say: errors, criteria, the colour of the noise, what is left."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.decide.evidence import excess_in_blocks, remainder
from sysid.diagnosis.decide.noise_colour import LARGEST_ORDER, Noise, noise_beside, noise_of
from sysid.diagnosis.decide.remains import chance_by_likelihood, clearest, leading
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.probe_functions import families
from sysid.diagnosis.structures.projection import orthonormal
from sysid.diagnosis.structures.structure import WHITE, Effort, Structure, StructureFit, filtered

# Without an effect something counts as seen under the residual's own colour with a chance below this.
SEEN_P_VALUE = 1e-2
# The colour beside the probes is settled so often: what is slow and nobody listed is theirs, not the noise's.
COLOUR_ROUNDS = 2
# Something is left when the probes, or held-out rows, find it with a chance below this.
LEFT_P_VALUE = 1e-5
# Held-out innovations larger than those of the search by this factor, beyond chance, show something else.
DISAGREEMENT = 1.3
# A free run that errs by so much more, in mean square, has lost the plant there.
RUN_AWAY = 9.0
# It shows in more than one place when blocks of them exceed those of the search by so many standard errors.
EXCESS = 2.0
# Then learning rows are cut into so many blocks, of which every third is held out: short ones, for what
# happens within a block that is held out, such as a step of the gain, cannot be placed in it.
INTERLEAVED = 30
# A controller that hands on the noise moves the input in at least this share of the rows.
MOST_MOVES = 0.5
# How often a fit and the colour of its own residual are brought to agree.
ROUNDS = 3
# A better model lowers the criterion by more than the rounding of a search that ends at the same place.
SAME_CRITERION = 1e-6


@runtime_checkable
class Causal(Protocol):
    """A structure whose output does not depend on the input of the same row."""

    def earlier_probes(self, fit: StructureFit) -> Floats:
        """Return directions that hold the input of earlier rows only, as an effect of the plant does."""


def interleaved(learning: Mask) -> tuple[Mask, Mask]:
    """Return rows to search on and to hold out that take turns, so that each knows what the others show."""
    place = np.cumsum(learning) - 1
    block = place * INTERLEAVED // max(int(learning.sum()), 1)
    held_out = learning & (block % 3 == 1)
    return learning & ~held_out, held_out


@dataclass(frozen=True, eq=False)
class Evidence:
    """Judges fits of a structure by their residuals on one record.

    Attributes
    ----------
    structure : Structure
    rows, held_out : ndarray of bool, shape (n_samples,)
        Rows to search on, and rows that a candidate must predict without having seen them.
    alpha : float
        Largest chance of taking white noise for noise with a memory.
    n_given : int
        Effects that are in the model whatever the evidence.
    smooth : bool
        Whether the record is long and its rows follow a motion far slower than they are.  Then next to
        everything is significant, for no model is exact to the last micrometre: an effect must matter, too.
    """

    structure: Structure
    rows: Mask
    held_out: Mask
    alpha: float
    n_given: int = 0
    smooth: bool = False

    def left(self, baseline: StructureFit, final: StructureFit, rows: Mask) -> tuple[float, float, float]:
        """Return whether anything is left to explain, what share of the explainable it is, and the floor."""
        tangent, kinds, probes = self._directions(final, rows)
        noise = self.colour(final, tangent, probes, rows)
        weighted = self.refitted(final, noise)
        if weighted is not final and weighted.usable:
            # Far from the best fit under this colour, what its parameters could follow seems to be left.
            final = weighted
            tangent, kinds, probes = self._directions(final, rows)
            noise = self.colour(final, tangent, probes, rows)
        residual, colour = self.residual(final), noise.polynomial
        found = remainder(*(filtered(part, rows, colour) for part in (residual, tangent, probes)))
        p_value = found.p_value
        # What the probes follow may be slow noise: under the residual's own colour it must show, too.
        plain = noise_of(residual, rows).polynomial
        again = remainder(*(filtered(part, rows, plain) for part in (residual, tangent, probes)))
        # Several effects and still a memory: more likely that of what they leave, which its own hides.
        several = len(final.choices) > self.n_given + 1 and plain.size > 1
        if not several and (final.choices or again.p_value >= SEEN_P_VALUE):
            p_value = max(p_value, again.p_value)
        if plain.size > 1:
            p_value = min(p_value, chance_by_likelihood(residual, tangent, probes, rows))
        # One kind of effect alone shows more clearly by its own probes.
        whitened = [filtered(part, rows, plain) for part in (residual, tangent, kinds)]
        by_kind, most = clearest(whitened[0], whitened[1], whitened[2], families(kinds.shape[1]))
        share = self._share_left(baseline, final, rows, colour, found.explained)
        if by_kind < p_value:
            p_value = by_kind
            share = max(share, self._share_left(baseline, final, rows, plain, most.explained))
        if final.choices and colour.size > 1:
            # A colour lifts what is faint in the free run: what is next to nothing there is not missing.
            plainly = remainder(residual[rows], tangent[rows], probes[rows])
            share = min(share, self._share_left(baseline, final, rows, WHITE, plainly.explained))
        whole = filtered(residual, rows, colour)
        noise_share = max(1.0 - found.explained / max(float(whole @ whole), 1e-300), 0.0)
        return p_value, share, float(np.sqrt(np.mean(residual[rows] ** 2) * noise_share))

    def only_at_once(self, fit: StructureFit) -> bool:
        """Tell whether all that is left goes with the input of the same row alone.

        The plant answers later, but a controller at once: it hands the noise on to the input.  Then
        the input is no cause of the noise that it goes with, and only what follows earlier rows tells of the
        plant, by a fit under the colour of the noise, which a loop leaves unbiased.  An input that stands
        still in most rows is not moved by noise that comes with each of them.

        References
        ----------
        Ljung (1999), System Identification, sections 13.4 and 16.6.
        """
        structure, rows = self.structure, self.structure.record.learning
        moves = np.diff(structure.record.u[rows], axis=0).any(axis=1)
        if not isinstance(structure, Causal) or not moves.any() or moves.mean() < MOST_MOVES:
            return False
        for _ in range(ROUNDS):
            settled = self.refitted(fit, self.noise(fit))
            if settled is fit or not settled.usable:
                break
            fit = settled
        noise, residual = self.noise(fit).polynomial, self.residual(fit)
        tangent = structure.tangent(fit)

        def chance(probes: Floats, known: Floats = tangent) -> float:
            parts = (filtered(part, rows, noise) for part in (residual, known, probes))
            return remainder(*parts).p_value

        earlier = structure.earlier_probes(fit)
        # Most of a smooth input is known from earlier rows: what is new in a row shows the loop.
        news = chance(structure.record.u, np.hstack([tangent, earlier]))
        at_once = min(news, chance(structure.probes(fit)))
        if not chance(earlier) > LEFT_P_VALUE > at_once:
            return False
        # An autoregression foresees any motion of few frequencies, so that its own colour hides every effect.
        return chance_by_likelihood(residual, tangent, earlier, rows) > LEFT_P_VALUE

    def _share_left(
        self, baseline: StructureFit, final: StructureFit, rows: Mask, colour: Floats, left: float
    ) -> float:
        """Return what is left as a share of itself and of what the effects have explained."""
        before, after = (filtered(self.residual(fit), rows, colour) for fit in (baseline, final))
        gained = max(float(before @ before) - float(after @ after), 0.0)
        return left / max(left + gained, 1e-300)

    def rows_disagree(self, fit: StructureFit) -> bool:
        """Tell whether held-out rows show what the rows of the search do not.

        A change of the gain after the last of these, or a limit that they do not reach, is no matter of
        chance on held-out rows, and no search on the others finds it.
        """
        from scipy.special import fdtrc

        noise, residual = self.noise(fit).polynomial, self.residual(fit)
        inside, outside = (filtered(residual, rows, noise) for rows in (self.rows, self.held_out))
        if not inside.size or not outside.size:
            return False
        if self._runs_away(residual):
            return True
        ratio = float(np.mean(outside**2)) / max(float(np.mean(inside**2)), 1e-300)
        by_chance = float(fdtrc(outside.size, inside.size, ratio))
        return (
            ratio > DISAGREEMENT and by_chance < LEFT_P_VALUE and excess_in_blocks(inside, outside) > EXCESS
        )

    def _runs_away(self, residual: Floats) -> bool:
        """Tell whether a free run that follows the rows of the search has lost the plant on the others.

        What follows a change of the gain slowly seems to have a long memory, whose innovations show the
        change in a few rows only, and by which errors of any size are to be expected.
        """
        inside, outside = (float(np.mean(residual[rows] ** 2)) for rows in (self.rows, self.held_out))
        moves = float(np.nanvar(self.structure.record.y[self.held_out, 0]))
        return outside > max(moves, RUN_AWAY * inside)

    def noise_accepted(self, fit: StructureFit, noise: Noise) -> bool:
        """Tell whether the residual's memory is real: on held-out rows it must lower the innovations."""
        plain = self.held_out_error(fit, WHITE)
        return (
            self.memory_p_value(noise) < self.alpha
            and noise.gain > 0
            and self.held_out_error(fit, noise.polynomial) < plain
        )

    def memory_p_value(self, noise: Noise) -> float:
        """Return the chance that white noise seems to have as much memory, at any order."""
        from scipy.special import gammaincc

        if noise.order == 0:
            return 1.0
        ratio = max(noise.gain + noise.order * np.log(self.rows.sum()), 0.0)
        return min(LARGEST_ORDER * float(gammaincc(0.5 * noise.order, 0.5 * ratio)), 1.0)

    def colour(
        self,
        fit: StructureFit,
        tangent: Floats | None = None,
        probes: Floats | None = None,
        rows: Mask | None = None,
    ) -> Noise:
        """Return the colour of what the probes leave of a residual.

        The residual's own autoregression would swallow a drift or a periodic remainder.
        """
        rows, residual = self.rows if rows is None else rows, self.residual(fit)
        if tangent is None or probes is None:
            tangent, _, probes = self._directions(fit, rows)
        columns = orthonormal(np.hstack([tangent[rows], probes[rows]]))
        return noise_beside(residual, columns, rows, COLOUR_ROUNDS)[0]

    def _directions(self, fit: StructureFit, rows: Mask) -> tuple[Floats, Floats, Floats]:
        """Return what the model can follow, all probes, and as many of their directions as rows allow."""
        tangent, probes = self.structure.tangent(fit), self.structure.probes(fit)
        return tangent, probes, leading(tangent, probes, rows)

    def refitted(self, fit: StructureFit, noise: Noise) -> StructureFit:
        """Return a fit on the rows of the search, moved to where it is best under a colour of the noise."""
        if noise.order == 0:
            return fit
        return self.structure.fit(fit.choices, self.rows, noise.polynomial, fit, effort=Effort.REFIT)

    def settled(self, fit: StructureFit) -> StructureFit:
        """Return a fit moved to where it is best under the colour of its own residual.

        It was searched for under the colour of what was left without it: far from its minimum, whatever gives
        it more freedom seems to explain something.
        """
        noise = self.noise(fit)
        if noise.order > 0:  # coloured as it was searched for, or by what is still missing
            return fit
        moved = self.structure.fit(fit.choices, self.rows, noise.polynomial, fit, effort=Effort.REFIT)
        better = moved.usable and self.criterion(moved, noise) < self.criterion(fit, noise)
        return moved if better else fit

    def residual(self, fit: StructureFit) -> Floats:
        """Return measurement less free run, shape (n_samples,); zero where either is missing."""
        y = self.structure.record.y[:, 0]
        with np.errstate(invalid="ignore"):
            return np.where(np.isfinite(y) & np.isfinite(fit.output), y - fit.output, 0.0)

    def noise(self, fit: StructureFit) -> Noise:
        """Return the colour of a fit's residual as it is."""
        return noise_of(self.residual(fit), self.rows)

    def cost(self, fit: StructureFit, noise: Noise) -> float:
        """Return the sum of squares of a fit's residual under a colour of the noise."""
        error = filtered(self.residual(fit), self.rows, noise.polynomial)
        return float(error @ error)

    def criterion(self, fit: StructureFit, noise: Noise) -> float:
        """Return the information criterion of a fit under a given colour of the noise."""
        n = int(self.rows.sum())
        return float(n * np.log(max(self.cost(fit, noise) / n, 1e-300)) + fit.n_parameters * np.log(n))

    def better_of(self, fit: StructureFit, others: Sequence[StructureFit], noise: Noise) -> StructureFit:
        """Return the best of some fits, or a given one where none is better."""
        usable = [other for other in others if other.usable]
        best = min(usable, key=lambda other: self.criterion(other, noise), default=fit)
        return best if self.criterion(best, noise) < self.criterion(fit, noise) - SAME_CRITERION else fit

    def own_criterion(self, fit: StructureFit) -> float:
        """Return the information criterion of a fit with the noise model of its own residual."""
        noise, n = self.noise(fit), int(self.rows.sum())
        count = fit.n_parameters + noise.order
        return float(n * np.log(max(noise.variance, 1e-300)) + count * np.log(n))

    def held_out_error(self, fit: StructureFit, noise: Floats) -> float:
        """Return the root mean square of the residual on held-out rows, filtered by D(q)."""
        error = filtered(self.residual(fit), self.held_out, noise)
        return float(np.sqrt(np.mean(error**2))) if error.size else np.inf
