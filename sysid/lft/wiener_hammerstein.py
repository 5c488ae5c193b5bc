"""Wiener-Hammerstein fit by the simulation error: poles on both sides of a static map."""

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import IdentifiabilityError, SysidError, UsageError
from sysid.lft.between_samples import interpolation_taps
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein_fit import WienerHammersteinFit
from sysid.lft.wiener_hammerstein_model import WienerHammerstein
from sysid.lft.wiener_hammerstein_search import Found, Screening, refine, screen
from sysid.lft.wiener_hammerstein_starts import (
    LinearApproximation,
    linear_approximation,
    ranked_starts,
    settled_segments,
)
from sysid.lft.wiener_hammerstein_uncertainty import parameter_covariance
from sysid.linear.output_error import INITIAL_STATES, make_segments, whole_number
from sysid.linear.reduction import Segment
from sysid.nonlinearities.spline import Extrapolation, Spline

Progress = Callable[[int, int], None]

LARGEST_ORDER = 10
# Up to so many rows and poles a search with given orders grows from smaller ones.
SHORT_ROWS, GROWN_POLES = 2_000, 8
LARGEST_INTERVALS = 200
ROWS_PER_PARAMETER = 4


def fit_wiener_hammerstein(
    record: Record,
    *,
    orders: tuple[int, int] | None = None,
    knots: int | None = None,
    oversampling: int | None = None,
    delay: int = 0,
    degree: int = 3,
    extrapolation: Extrapolation = "linear",
    initial_state: str = "estimate",
    rows: Mask | None = None,
    start: WienerHammerstein | None = None,
    progress: Progress | None = None,
) -> WienerHammersteinFit:
    """Fit y = G2 f(G1 u) by its simulation error, from many starts.

    The poles and zeros of the best linear approximation are shared between the two blocks in all ways; the
    map, a spline, is eliminated linearly, and the best starts are followed by Levenberg-Marquardt steps with
    exact derivatives, on few rows first.  An even map leaves no linear approximation to start from.  Wiener
    and Hammerstein models are those of orders (n, 0) and (0, n).

    Parameters
    ----------
    record : Record
        With one input and one output.
    orders : (int, int), optional
        Of the front and the back block; chosen on the validation rows by default.
    knots : int, optional
        Of the map, equally spaced over the range of its input; those that leave an interval too few points
        are left out.  Chosen on the validation rows by default.
    oversampling : int, optional
        1: the map acts on samples.  R > 1: it acts in continuous time, between the samples of a band-limited
        input, and is found at R points in a sampling period.  Chosen on the validation rows by default, 1 or
        2.
    delay : int
        Samples by which the input is late.
    degree : int
        Of the spline.
    extrapolation : {"linear", "constant"}
        How the map goes on outside its knots.
    initial_state : {"estimate", "rest"}
        "rest": the input was zero before each experiment.  "estimate": it was not; the run starts from the
        steady state of the first input, and the rows in which the true past still shows are left out.
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    start : WienerHammerstein, optional
        A model to be refitted: the only start.
    progress : callable, optional
        Called with the number of searches done and to do.

    Returns
    -------
    WienerHammersteinFit

    Raises
    ------
    UsageError
        If an option makes no sense.
    DataError, IdentifiabilityError
        If the record has too few rows, several outputs or missing outputs.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> from sysid.linear import simulate_polynomial
    >>> u = np.random.default_rng(0).standard_normal(1500)
    >>> z = simulate_polynomial([0.4, 0.0], [1.0, -0.6], u)
    >>> y = simulate_polynomial([0.2, 0.0], [1.0, -0.8], np.tanh(z))
    >>> fit = fit_wiener_hammerstein(make_record(u, y, period=1.0), orders=(1, 1), knots=10, oversampling=1)
    >>> [round(float(block.a[1]), 3) for block in (fit.front, fit.back)]
    [-0.6, -0.8]
    """
    check_record(record)
    form = checked_form(record, delay, degree, extrapolation, initial_state)
    if start is not None:
        if orders is None:
            orders = start.orders
        knots = start.map.knots.size if knots is None else knots
        oversampling = start.oversampling if oversampling is None else oversampling
    if orders is None or knots is None or oversampling is None:
        from sysid.lft.wiener_hammerstein_choice import choose_wiener_hammerstein

        choice = choose_wiener_hammerstein(
            record,
            orders=orders,
            knots=knots,
            oversampling=oversampling,
            delay=delay,
            degree=degree,
            extrapolation=extrapolation,
            initial_state=initial_state,
            rows=rows,
            progress=progress,
        )
        return choice.fit
    orders, intervals = checked_orders(orders), checked_intervals(knots)
    interpolation_taps(oversampling)
    search = Multistart(make_segments(record, rows), form)
    check_enough(search.segments, orders, intervals + degree)
    screening = search.grown(orders, progress) if start is None else Screening(start, 0, True)
    found = refine(search.settled, replace(screening.model, oversampling=oversampling), intervals)
    return fit_of(record, found, screening, intervals)


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


def checked_form(
    record: Record, delay: int, degree: int, extrapolation: Extrapolation, initial_state: str
) -> WienerHammerstein:
    """Return a model without blocks that holds what is not searched; an error if it makes no sense."""
    if record.u.shape[1] != 1:
        raise UsageError(
            f"the record has {record.u.shape[1]} inputs ({', '.join(record.inputs)}): choose one "
            "for this model"
        )
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    delay = whole_number("delay", delay)
    if not 0 <= delay < record.n_samples:
        raise UsageError(f"delay is {delay} samples: give 0 or more, and less than the record's length")
    gain = LinearBlock(np.zeros(0), np.ones(1))
    degree = whole_number("degree", degree)
    spline = Spline(np.array([-1.0, 1.0]), np.zeros(1 + max(degree, 0)), degree, extrapolation)
    return WienerHammerstein(gain, spline, gain, delay=delay, resting=initial_state == "rest")


def checked_orders(orders: tuple[int, int]) -> tuple[int, int]:
    """Return the orders of both blocks; UsageError if they make no sense."""
    try:
        front, back = (whole_number("order", order) for order in orders)
    except TypeError:
        raise UsageError(f"orders is {orders!r}: give two, of the front and the back block") from None
    except ValueError:
        raise UsageError(
            f"orders is {orders!r}: give two whole numbers, of the front and the back block"
        ) from None
    if min(front, back) < 0 or max(front, back) > LARGEST_ORDER or front + back == 0:
        raise UsageError(
            f"orders are {front} and {back}: give numbers from 0 to {LARGEST_ORDER}, at least one "
            "of them above 0"
        )
    return front, back


def checked_intervals(knots: int) -> int:
    """Return the number of intervals between so many knots; UsageError if it makes no sense."""
    intervals = whole_number("knots", knots) - 1
    if not 1 <= intervals <= LARGEST_INTERVALS:
        raise UsageError(f"knots is {knots}: give a number from 2 to {LARGEST_INTERVALS + 1}")
    return intervals


def check_enough(segments: tuple[Segment, ...], orders: tuple[int, int], n_basis: int) -> None:
    """Raise IdentifiabilityError if there are too few rows for the parameters."""
    n_rows = sum(int(s.used.sum()) for s in segments)
    unknowns = 2 * sum(orders) + n_basis
    if n_rows < ROWS_PER_PARAMETER * unknowns:
        raise IdentifiabilityError(
            f"{n_rows} rows cannot determine {unknowns} parameters (orders {orders[0]} and {orders[1]}, a "
            f"map of {n_basis} coefficients): at least {ROWS_PER_PARAMETER * unknowns} rows are needed; "
            "lower orders or knots"
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
