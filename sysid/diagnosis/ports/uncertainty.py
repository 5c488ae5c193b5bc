"""How sure a fitted curve is, how dense its data, and how much of the error it removes."""

from dataclasses import dataclass, replace

import numpy as np

from sysid.diagnosis.ports.kernels import BEHIND
from sysid.diagnosis.ports.loop import DEGREE, Loop, opening_state
from sysid.diagnosis.ports.search import PortFit
from sysid.diagnosis.residuals import block_length
from sysid.linear.forms import Floats
from sysid.linear.kernels import polynomial_filter
from sysid.linear.uncertainty import autoregression
from sysid.nonlinearities.spline import Spline

POINTS = 101
REPLICATES = 400
# Differences are taken over this share of a standard error.
SMALL = 0.1
# Mean square difference from a fit on half as many knots, over that of the error.
COARSER_ERROR = 2.0


def judged_errors(loop: Loop, point: Floats, near: tuple[Loop, Floats] | None = None) -> list[Floats]:
    """Return the free-run error on the judged rows of each stretch that has any.

    A stretch without fitted rows gets its initial state from its first rows, searched from that of
    the plant alone.
    """
    starts = loop.starts(point)
    for number, stretch in enumerate(loop.stretches):
        if stretch.judged.any() and stretch.free and not stretch.fitted.any():
            guess = np.zeros(loop.plant.order)
            if near is not None:
                guess = opening_state(*near, number, guess)
            starts[number] = opening_state(loop, point, number, guess)
    return [
        np.asarray((y - s.y)[s.judged])
        for s, (y, _) in zip(loop.stretches, loop.run(point, starts), strict=True)
        if s.judged.any()
    ]


def explained(alone: list[Floats], errors: list[Floats]) -> tuple[float, tuple[float, float]]:
    """Return the share of the squared error removed, and its 95 % interval by a block bootstrap."""
    before = np.concatenate(alone) ** 2
    after = np.concatenate(errors) ** 2
    total = float(before.sum())
    if not np.isfinite(after).all() or not np.isfinite(total) or total <= 0.0:
        return 0.0, (0.0, 0.0)
    length = max(block_length(before), block_length(after))
    starts = np.random.default_rng(0).integers(0, before.size, (REPLICATES, -(-before.size // length)))
    blocks = [_block_sums(x, length)[starts].sum(axis=1) for x in (before, after)]
    replicates = 1.0 - blocks[1] / np.maximum(blocks[0], 1e-300)
    low, high = np.clip(np.quantile(replicates, [0.025, 0.975]), 0.0, 1.0)
    return float(np.clip(1.0 - after.sum() / total, 0.0, 1.0)), (float(low), float(high))


def _block_sums(values: Floats, length: int) -> Floats:
    """Return the sum of the block that starts at each row, wrapping around."""
    wrapped = np.concatenate([[0.0], np.cumsum(np.concatenate([values, values[: length - 1]]))])
    return np.asarray(wrapped[length:] - wrapped[:-length])


@dataclass(frozen=True)
class Shape:
    """A curve over its places, its standard error and the density of its data."""

    value: Floats
    centre: Floats
    spread: Floats
    density: Floats


def shape_of(fit: PortFit) -> Shape:
    """Return the curve with straight lines of the linear part taken out.

    What is shown depends on the map's weights and, by the line over the data that is taken out, on
    all parameters: its derivatives along the axes of their covariance are taken by differences.
    """
    loop, lines = fit.loop, _lines_of_the_plant(fit)
    ends, z = np.array([loop.knots[0], loop.knots[-1]]), fit.z
    if loop.port.mode == BEHIND:
        level, slope = _line(loop, fit.point, z, lines)
        ends, z = ends + level + slope * ends, z + level + slope * z
    value = np.linspace(ends.min(), ends.max(), POINTS)  # a steeply falling line turns the ends round

    def shown(point: Floats) -> Floats:
        return _shown(loop, point, loop.map_inputs(point), lines, value)

    variance = np.zeros(POINTS)
    for axis in _axes(loop, fit.point):
        above, below = (shown(fit.point + sign * SMALL * axis) for sign in (1.0, -1.0))
        variance += ((above - below) / (2.0 * SMALL)) ** 2
    return Shape(value, shown(fit.point), np.sqrt(variance), density_of(z, value))


def with_bias(shape: Shape, fit: PortFit, coarser: PortFit) -> Shape:
    """Widen the standard error by what a spline of these knots leaves out, as at a knee.

    The error of a spline near a knee falls with the distance of its knots, so that a fit on half as many
    is off by about twice as much.  Where both errors agree in sign the mean square of the difference is that
    of the finer one's error, where they are independent five times as much; twice is in between.  The part
    that the noise explains is taken off, and the rest averaged over a knot interval to each side.

    Parameters
    ----------
    shape : Shape
        Of the fit that is shown.
    fit, coarser : PortFit
        At the same port, the second one on fewer knots.
    """
    other = shape_of(coarser)
    inside = (shape.value >= other.value[0]) & (shape.value <= other.value[-1])
    difference = np.interp(shape.value, other.value, other.centre) - shape.centre
    noise = shape.spread**2 - np.interp(shape.value, other.value, other.spread) ** 2
    squared = np.where(inside, np.maximum(difference**2 - np.maximum(noise, 0.0), 0.0), 0.0)
    step = float(shape.value[1] - shape.value[0])
    # No farther than the curve: where the plant is nearly still its range is narrower than a knot interval.
    widest = (shape.value.size - 1) // 2
    reach = int(min(np.ceil(float(np.diff(fit.loop.knots).max()) / abs(step)), widest))
    window = np.ones(2 * reach + 1)
    mean = np.convolve(squared, window, "same") / np.convolve(np.ones(squared.size), window, "same")
    return replace(shape, spread=np.sqrt(shape.spread**2 + mean / COARSER_ERROR))


def _lines_of_the_plant(fit: PortFit) -> Floats:
    """Return the lines to be taken out: weights on 1 and z."""
    if fit.loop.plant.black_box and not fit.lines[1].any():
        return np.column_stack([fit.lines, [0.0, 1.0]])
    return fit.lines


def _line(loop: Loop, point: Floats, z: Floats, lines: Floats) -> tuple[float, float]:
    """Return level and slope of the line that is nearest to the map over the data."""
    f = Spline(loop.knots, loop.coefficients(point), DEGREE)
    at_data = np.column_stack([np.ones(z.size), z]) @ lines
    level, slope = lines @ np.linalg.lstsq(at_data, f(z), rcond=None)[0]
    return float(level), float(slope)


def _shown(loop: Loop, point: Floats, z: Floats, lines: Floats, value: Floats) -> Floats:
    """Return the map less its line, in the scale of a plant that has taken the line over.

    In front of the plant, the line's slope becomes gain; behind it, what the map depends on is
    stretched as well; in a loop the line goes into the poles and the level.
    """
    f = Spline(loop.knots, loop.coefficients(point), DEGREE)
    if not lines.shape[1] or not np.isfinite(z).all():
        return f(value)
    level, slope = _line(loop, point, z, lines)
    if loop.port.mode == BEHIND:
        place = (value - level) / (1.0 + slope)
        return np.asarray(place + f(place) - value)
    left = f(value) - level - slope * value
    return left / (1.0 + slope) if loop.port.kind == "input" else left


def _axes(loop: Loop, point: Floats) -> Floats:
    """Return the axes of the parameters' uncertainty: the covariance is the sum of their squares."""
    values, vectors = np.linalg.eigh(point_covariance(loop, point))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))).T


def point_covariance(loop: Loop, point: Floats) -> Floats:
    """Return the covariance of plant, map and initial states under a coloured residual."""
    parts, residuals = loop.jacobian_parts(point), loop.residual_parts(point)
    noise, noise_std = autoregression(residuals)
    rows, filtered = [], []
    for stretch, part in zip(loop.stretches, parts, strict=True):
        if stretch.fitted.any():
            part[~stretch.fitted] = 0.0
            rows.append(part)
            filtered.append(_backwards(part, noise))
    J = loop.jacobian(point)
    scale = np.linalg.norm(J, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv(np.linalg.qr(J / scale, mode="r"), rcond=1e-10)
    M = np.linalg.qr(np.vstack(filtered) / scale, mode="r") @ inverse @ inverse.T / scale
    count = sum(r.size for r in residuals)
    return np.asarray(noise_std**2 * count / max(count - point.size, 1) * (M.T @ M))


def _backwards(columns: Floats, noise: Floats) -> Floats:
    """Filter each column by 1/D in reversed time."""
    out = np.empty_like(columns)
    b = np.eye(1, noise.size)[0]
    for j in range(columns.shape[1]):
        signal = np.ascontiguousarray(columns[::-1, j])
        filtered = np.empty_like(signal)
        polynomial_filter(b, noise, signal, np.zeros(noise.size - 1), filtered)
        out[:, j] = filtered[::-1]
    return out


def density_of(z: Floats, value: Floats) -> Floats:
    """Return the share of the data for each unit of the curve's places."""
    step = value[1] - value[0]
    edges = np.concatenate([value - 0.5 * step, [value[-1] + 0.5 * step]])
    return np.asarray(np.histogram(z, edges)[0] / (z.size * step), dtype=np.float64)
