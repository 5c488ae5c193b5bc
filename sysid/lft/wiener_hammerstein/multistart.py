"""A Wiener-Hammerstein model searched for from many starts."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from sysid.data import Record
from sysid.errors import SysidError
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.lft.wiener_hammerstein.result import WienerHammersteinFit
from sysid.lft.wiener_hammerstein.search import Found, Screening, screen
from sysid.lft.wiener_hammerstein.starts import (
    LinearApproximation,
    linear_approximation,
    ranked_starts,
    settled_segments,
)
from sysid.lft.wiener_hammerstein.uncertainty import parameter_covariance
from sysid.linear.reduction import Segment

Progress = Callable[[int, int], None]

# Up to so many rows and poles a search with given orders grows from smaller ones.
SHORT_ROWS, GROWN_POLES = 2_000, 8


class Multistart:
    """The multi-start search on one set of rows; linear approximations are fitted once."""

    def __init__(self, segments: tuple[Segment, ...], form: WienerHammerstein):
        self.segments, self.form = segments, form
        self._approximations: dict[int, LinearApproximation] = {}
        self.settled = segments
        if not form.resting:
            self.settled = settled_segments(segments, self.approximation(2))

    def approximation(self, order: int) -> LinearApproximation:
        """Return the best linear approximation of an order."""
        if order not in self._approximations:
            self._approximations[order] = linear_approximation(
                self.segments, order, self.form.delay, self.form.resting
            )
        return self._approximations[order]

    def screened(
        self,
        orders: tuple[int, int],
        progress: Progress | None = None,
        extra: tuple[WienerHammerstein, ...] = (),
    ) -> Screening:
        """Search from the best starts on few rows; ``extra`` starts come first."""
        total = sum(orders)
        approximations = [self.approximation(n) for n in (total, total - 1) if n > 0]
        starts = [*extra, *ranked_starts(self.settled, approximations, orders, self.form)]
        return screen(self.settled, starts, progress)

    def grown(self, orders: tuple[int, int], progress: Progress | None = None) -> Screening:
        """Search as `screened` does, from smaller models too where the record is short.

        A short record tells the linear approximation of high order badly, and its poles lead astray; the
        ends of searches with one pole less lie near.
        """
        rows = sum(int(segment.used.sum()) for segment in self.settled)
        if rows > SHORT_ROWS or sum(orders) > GROWN_POLES:
            return self.screened(orders, progress)
        found: dict[tuple[int, int], Screening] = {}
        total = (orders[0] + 1) * (orders[1] + 1) - 1
        for front, back in product(range(orders[0] + 1), range(orders[1] + 1)):
            if front + back == 0:
                continue
            smaller = [found[pair].model for pair in ((front - 1, back), (front, back - 1)) if pair in found]
            extra = tuple(
                replace(model, front=model.front.padded(front), back=model.back.padded(back))
                for model in smaller
            )
            try:
                found[front, back] = self.screened((front, back), None, extra)
            except SysidError:
                if (front, back) == orders:
                    raise
                continue
            if progress is not None:
                progress(len(found), total)
        return found[orders]


def fit_of(record: Record, found: Found, screening: Screening, intervals: int) -> WienerHammersteinFit:
    """Return the result of a search with its covariance, normalised."""
    point = found.minimum.point
    uncertainty = parameter_covariance(point)
    segments = found.problem.segments
    model = found.model.normalised()
    z = np.concatenate([model.map_input(s.u[:, 0])[s.used] for s in segments])
    status = found.minimum.status
    return WienerHammersteinFit(
        model=model,
        searched=found.model,
        covariance=uncertainty.covariance,
        noise=uncertainty.noise,
        noise_std=uncertainty.noise_std,
        period=record.period,
        inputs=record.inputs,
        outputs=record.outputs,
        rms=found.rms,
        output_std=float(np.std(np.concatenate([s.y[s.used] for s in segments]))),
        n_rows=found.problem.n_rows,
        intervals=intervals,
        range=(float(z.min()), float(z.max())),
        converged=status.converged,
        restarts_agree=screening.agree,
        status=f"{_ended(status.converged, found.minimum.n_evaluations)}; {_agreement(screening)}",
    )


def _ended(converged: bool, evaluations: int) -> str:
    if converged:
        return "converged: the next step is far below a standard error"
    return f"stopped after {evaluations} evaluations, still improving"


def _agreement(screening: Screening) -> str:
    if screening.n_searches == 0:
        return "refitted from the start that was given"
    if screening.n_searches == 1:
        return "one search: poles and zeros can be shared between the blocks in one way only"
    if screening.agree:
        return f"the best two of {screening.n_searches} searches from different starts agree"
    return (
        f"the best of {screening.n_searches} searches from different starts was reached once: the error has "
        "local minima, so compare other orders"
    )
