"""Wiener-Hammerstein fit by the simulation error: poles on both sides of a static map."""

from dataclasses import replace

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.lft.between_samples import interpolation_taps
from sysid.lft.wiener_hammerstein.checks import check_enough, checked_form, checked_intervals, checked_orders
from sysid.lft.wiener_hammerstein.choice import choose_wiener_hammerstein
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.lft.wiener_hammerstein.multistart import Multistart, Progress, fit_of
from sysid.lft.wiener_hammerstein.result import WienerHammersteinFit
from sysid.lft.wiener_hammerstein.search import Screening, refine
from sysid.linear.output_error import make_segments
from sysid.nonlinearities.spline import Extrapolation


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
