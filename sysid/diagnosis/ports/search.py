"""A spline in the loop with a linear plant, both fitted on the free-run error from several starts."""

from dataclasses import dataclass, replace

import numpy as np

from sysid.diagnosis.ports.kernels import OUTPUT, RATE, STATE
from sysid.diagnosis.ports.lines import loop_without_lines
from sysid.diagnosis.ports.loop import DEGREE, Loop, Stretch
from sysid.diagnosis.ports.plants import Plant, Port
from sysid.linear.forms import Floats
from sysid.nonlinearities.spline import Spline, spline_basis, supported_knots
from sysid.separable.descent import Minimum, Residual

# Intervals of the map: doubled as long as the information criterion falls, and once more.
INTERVALS = (6, 12, 24, 48)
# The finest ones take too long on many rows.
MANY_ROWS, MOST_OF_MANY = 4_500, 24
FEWEST_POINTS = 8
FEWEST_ROWS_PER_UNKNOWN = 3
# A start is searched this far, the best one then goes on.
FIRST_EVALUATIONS = 15
EVALUATIONS = 40
LEADING = 2
HALF_WIDTH = 3  # rows on each side from which a rate of change is measured


@dataclass(frozen=True)
class PortFit:
    """A map fitted at a port.

    Attributes
    ----------
    loop : Loop
    point : ndarray
    z : ndarray
        What the map is fed with on the fitted rows.
    lines : ndarray, shape (2, n_lines)
        Straight lines that the linear part absorbs: weights on 1 and z.
    converged : bool
    """

    loop: Loop
    point: Floats
    z: Floats
    lines: Floats
    converged: bool


def enough_rows(plant: Plant, stretches: tuple[Stretch, ...]) -> bool:
    """Tell whether there are several rows for each unknown of a map on the coarsest knots."""
    unknowns = plant.start.size + plant.order * len(stretches) + INTERVALS[0] + DEGREE
    return sum(int(s.fitted.sum()) for s in stretches) >= FEWEST_ROWS_PER_UNKNOWN * unknowns


def fit_baseline(
    plant: Plant, port: Port, stretches: tuple[Stretch, ...], known: Floats | None = None
) -> tuple[Loop, Floats]:
    """Fit the plant alone to the stretches: what a port's error is compared with.

    Without a map all ports are alike, so the point that was found at another one is ``known``.
    """
    fed = tuple(np.zeros(s.y.size) for s in stretches)
    nothing = np.zeros((DEGREE + 1, 0))
    loop = Loop(plant, port.known(), stretches, np.array([0.0, 1.0]), nothing, np.zeros((0, 0)), fed)
    if known is not None:
        return loop, known
    n_starts = sum(plant.order for s in stretches if s.free and s.fitted.any())
    start = loop.with_best_starts(np.concatenate([plant.start, np.zeros(n_starts)]))
    minimum = loop.descend(start, EVALUATIONS)
    return loop, start if minimum is None else minimum.x


def fit_port(port: Port, baseline: tuple[Loop, Floats]) -> list[PortFit]:
    """Fit a map at a port, together with the plant, on finer and finer knots.

    The knots are refined as long as the information criterion falls, and once more: one step finer
    than needed, the band covers what coarser knots leave out.

    Parameters
    ----------
    port : Port
    baseline : tuple of Loop and ndarray
        The plant alone, fitted, and its point.

    Returns
    -------
    list of PortFit
        The one to be shown first, then the other ones; empty if the map's input does not vary or
        the run diverges from every start.
    """
    leaders: list[PortFit] = []
    for other in _origins(baseline):
        ends = _coarse(port, other)
        if ends and (not leaders or _error(ends[0]) < _error(leaders[0])):
            leaders, baseline = ends[:LEADING], other
    leaders = [_refined(fit, baseline, INTERVALS[0]) or fit for fit in leaders]
    found = list(leaders)
    many = baseline[0].map_inputs(baseline[1]).size > MANY_ROWS
    for n_intervals in INTERVALS[1:]:
        if many and n_intervals > MOST_OF_MANY:
            break
        finer = [fit for fit in (_refined(old, baseline, n_intervals) for old in leaders) if fit]
        if not finer:
            break
        found += finer
        better = min(map(_information, finer)) < min(map(_information, leaders))
        leaders = [min(finer, key=_error)]
        if not better:
            break
    if not leaders:
        return []
    shown = min(leaders, key=_error)
    return [shown, *(fit for fit in found if fit is not shown)]


def _origins(baseline: tuple[Loop, Floats]) -> list[tuple[Loop, Floats]]:
    """Return the plant alone, fitted, and as it is at other parameters, where a search may begin there.

    A parameter of the fitted plant may have run off beyond all numbers.
    """
    loop, point = baseline
    others = [np.concatenate([origin, point[loop.n_plant :]]) for origin in loop.plant.origins[1:]]
    found = [(loop, loop.with_best_starts(other)) for other in others if loop.runs(other)]
    return [baseline, *found] if loop.runs(point) else found


def _error(fit: PortFit) -> float:
    return fit.loop.error(fit.point)


def _coarse(port: Port, baseline: tuple[Loop, Floats]) -> list[PortFit]:
    """Return the ends of the searches from all starts, on the coarsest knots, the best first.

    A feedback loop is first opened: the map is fed with what was measured, or with the free run of
    the plant alone, so that nothing can diverge; then it is closed.  It is also searched closed at once.
    """
    feeds = _feeds(port, baseline)
    if any(np.ptp(_on_fitted_rows(baseline[0], feed)) == 0.0 for feed in feeds):
        return []
    feedback = port.mode in (OUTPUT, STATE, RATE)
    starts = [(port.known() if feedback else port, feed) for feed in feeds]
    if feedback:
        starts.append((port, ()))
    error = baseline[0].error(baseline[1])
    ends: list[PortFit] = []
    for fed_port, feed in starts:
        z = _on_fitted_rows(baseline[0], feed or feeds[0])
        knots = supported_knots(z, INTERVALS[0], FEWEST_POINTS)
        loop, lines = loop_without_lines(fed_port, baseline, knots, z, feed, error)
        end = loop.descend(_carried(loop, baseline[1], 0), FIRST_EVALUATIONS)
        if end is not None and fed_port is not port:
            loop = replace(loop, port=port, fed=())
            end = loop.descend(end.x, FIRST_EVALUATIONS)
        if end is not None:
            ends.append(_as_fit(loop, end, lines))
    return sorted(ends, key=_error)


def _refined(fit: PortFit, baseline: tuple[Loop, Floats], n_intervals: int) -> PortFit | None:
    """Go on with so many intervals over the range that the map's input has now."""
    old, z = fit.loop, fit.z
    if np.ptp(z) == 0.0:
        return None
    knots = supported_knots(z, n_intervals, FEWEST_POINTS)
    if n_intervals != INTERVALS[0] and knots.size <= old.knots.size:
        return None
    loop, lines = loop_without_lines(old.port, baseline, knots, z, old.fed, old.error(fit.point))
    before = Spline(old.knots, old.coefficients(fit.point), DEGREE)
    end = loop.descend(_carried(loop, fit.point, old.n_weights, before), EVALUATIONS)
    return None if end is None else _as_fit(loop, end, lines)


def _as_fit(loop: Loop, end: Minimum[Residual], lines: Floats) -> PortFit:
    return PortFit(loop, end.x, loop.map_inputs(end.x), lines, end.status.converged)


def _information(fit: PortFit) -> float:
    """Return the Bayesian information criterion of the map's weights."""
    z = fit.z
    return float(
        z.size * np.log(max(fit.loop.error(fit.point), 1e-300) / z.size) + fit.loop.n_weights * np.log(z.size)
    )


def _carried(loop: Loop, point: Floats, n_old: int, spline: Spline | None = None) -> Floats:
    """Return a point for other knots: the old plant and states, the map as near to the old one as may be."""
    weights: Floats = np.zeros(loop.n_weights)
    if spline is not None:
        grid = np.linspace(loop.knots[0], loop.knots[-1], 20 * loop.knots.size)
        columns = spline_basis(grid, loop.knots, degree=DEGREE) @ loop.directions
        weights = np.asarray(np.linalg.lstsq(columns, spline(grid), rcond=1e-10)[0], dtype=np.float64)
    return np.concatenate([point[: loop.n_plant], weights, point[loop.n_plant + n_old :]])


def _on_fitted_rows(alone: Loop, signals: tuple[Floats, ...]) -> Floats:
    return np.concatenate([x[s.fitted] for x, s in zip(signals, alone.stretches, strict=True)])


def _feeds(port: Port, baseline: tuple[Loop, Floats]) -> list[tuple[Floats, ...]]:
    """Return known signals with which the map can be fed, the measured one first."""
    alone, base_point = baseline
    plant, stretches = alone.plant, alone.stretches
    if port.kind == "input":
        return [tuple(plant.map_input(s.u, port.channel) for s in stretches)]
    runs = alone.run(base_point)
    outputs = tuple(np.where(np.isfinite(y), y, s.y) for s, (y, _) in zip(stretches, runs, strict=True))
    if port.kind == "output":
        return [outputs]
    measured = tuple(s.y for s in stretches)
    if port.seen:
        return [measured, outputs]
    return [tuple(rate_of_change(y, plant.period) for y in signals) for signals in (measured, outputs)]


def rate_of_change(y: Floats, period: float) -> Floats:
    """Return the slope of the line through the rows around each row.

    Examples
    --------
    >>> import numpy as np
    >>> rate_of_change(np.arange(10.0) ** 2, 0.5)[4:6].round(9)
    array([16., 20.])
    """
    steps = np.arange(-HALF_WIDTH, HALF_WIDTH + 1)
    padded = np.concatenate(
        [
            2.0 * y[0] - y[HALF_WIDTH:0:-1],
            y,
            2.0 * y[-1] - y[-2 : -HALF_WIDTH - 2 : -1],
        ]
    )
    weights = steps / float(steps @ steps)
    return np.asarray(np.convolve(padded, weights[::-1], mode="valid") / period)
