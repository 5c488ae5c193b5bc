"""Whether a force is missing that changes its sign with the velocity, seen before the dynamics.

A dry friction is large in the force and small in the output: a plant that integrates turns a jump of the
force into a kink of the position, which no share of the squared error near the reversals can show.  So the
residual is held against the output that such a force would make.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.comparison.regions import moving_signal
from sysid.diagnosis.comparison.series import Series
from sysid.diagnosis.comparison.where import LEVEL, SMALLEST_EXPLAINED, Finding
from sysid.diagnosis.ports.plants import Plant
from sysid.diagnosis.ports.reversals import NEAR_ZERO
from sysid.diagnosis.wording import percent, quantity
from sysid.linear.forms import Floats
from sysid.linear.simulation import simulate_state_space
from sysid.linear.uncertainty import autoregression

# Blocks of time whose contributions are compared, and the fewest rows or means that they are cut from.
BLOCKS = 24
FEWEST_MEANS = 10 * BLOCKS
FEWEST_REVERSALS = 4
# From one time scale to the next.
LADDER = 4
# What the test adds to the false alarms of all looks together: a fifth of their level.
LOOKS = 5
DEPENDENT = 1e-7


@dataclass(frozen=True)
class ReversalForce:
    """A force along the sign of the velocity, at the input.

    Attributes
    ----------
    size : float
        In the unit of the first input; negative against the motion.
    p_value : float
        Of a trace as clear by chance, corrected for time scales and looks.
    explained : float
        Share of the error, after the best linear correction, that it removes.
    near_zero : float
        Share of the rows at which the velocity is near zero.
    reversals : int
    """

    size: float
    p_value: float
    explained: float
    near_zero: float
    reversals: int


def reversal_force(series: Series, free_run: Floats, plant: Plant) -> ReversalForce | None:
    """Test the residual for the trace of a force that follows the sign of the velocity.

    The force is that of the model's free run, its trace the plant's response to it.  What forces that are
    smooth in input, output and velocity (to the third power) would do, with the effect of every parameter of
    the linear part, is taken out first, so that neither a misfit nor a hardening spring is taken for a
    change of sign.  Residual and traces are whitened by the residual's autoregression, for means over several
    time scales; the contributions of successive blocks of time to their product are compared with their own
    scatter (Student's t), so that memory the autoregression misses does no harm.

    Parameters
    ----------
    series : Series
        The judged rows.
    free_run : ndarray, shape (n_samples,)
        Of the model, over all rows of the record.
    plant : Plant
        Its linear part.

    Returns
    -------
    ReversalForce or None
        None where the motion has too few reversals, or the rows are too few.
    """
    from scipy.special import stdtr

    velocity = np.concatenate([series.velocity[run] for run in series.runs])
    bound = NEAR_ZERO * float(np.sqrt(np.mean(velocity**2)))
    count = sum(_reversals(series.velocity[run], bound) for run in series.runs)
    if bound == 0.0 or count < FEWEST_REVERSALS:
        return None
    traces = _traces(series, free_run, plant, bound)
    if traces is None:
        return None
    trace, linear, smooth = traces
    both, lengths, p_values = np.hstack([linear, smooth]), _lengths(series), []
    for length in lengths:
        found = _whitened(series, length, trace, both)
        if found is not None:
            sums = np.array([part.sum() for part in np.array_split(found[0] * found[1], BLOCKS)])
            scatter = float(sums.std(ddof=1)) / np.sqrt(BLOCKS)
            ratio = abs(float(sums.mean())) / scatter if scatter > 0.0 else 0.0
            p_values.append(2.0 * float(stdtr(BLOCKS - 1, -ratio)))
    if not p_values:
        return None
    left, seen = _left(linear, np.column_stack([series.residual, trace])).T
    size = float(seen @ left / max(float(seen @ seen), 1e-300))
    explained = size**2 * float(seen @ seen) / max(float(left @ left), 1e-300)
    p_value = min(1.0, min(p_values) * len(p_values) * LOOKS)
    return ReversalForce(size, p_value, explained, float(np.mean(np.abs(velocity) <= bound)), count)


def reversal_finding(series: Series, free_run: Floats, plant: Plant) -> Finding | None:
    """Return the finding, if such a force is significant and removes enough to matter."""
    found = reversal_force(series, free_run, plant)
    if found is None or found.p_value > LEVEL or found.explained < SMALLEST_EXPLAINED:
        return None
    name, unit = moving_signal(series.record)
    channel = series.record.inputs[0]
    side = "against" if found.size < 0.0 else "along"
    size = quantity(abs(found.size), series.record.unit(channel), 2)
    sentence = (
        f"An effect of about {size} at {channel} {side} the motion is missing, which changes its sign with "
        f"the {name}: it would remove {percent(found.explained)} of the error on {series.judged} that a "
        f"linear model leaves ({found.reversals} reversals)."
    )
    place = {"signal": name, "unit": unit, "changes_sign": True, "reversals": found.reversals}
    return Finding(
        "velocity-sign",
        place,
        found.explained,
        found.near_zero,
        found.p_value,
        sentence,
        "error that a force with the sign of the velocity removes",
    )


def _reversals(velocity: Floats, bound: float) -> int:
    """Count the changes from motion in one direction to motion in the other."""
    moving = np.sign(velocity[np.abs(velocity) > bound])
    return int(np.sum(moving[1:] != moving[:-1]))


def _lengths(series: Series) -> list[int]:
    """Return the numbers of rows that are averaged: powers of four up to the time scale of the motion."""
    lengths, most = [1], min(series.mean_length, series.places.size // FEWEST_MEANS)
    while lengths[-1] * LADDER < most:
        lengths.append(lengths[-1] * LADDER)
    return lengths + [most] * (most > lengths[-1])


def _traces(
    series: Series, free_run: Floats, plant: Plant, bound: float
) -> tuple[Floats, Floats, Floats] | None:
    """Return the output of a force with the sign of the velocity, of linear forces, and of smooth ones."""
    record = series.record
    (port,) = plant.ports(record, ("velocity",))[:1] or (None,)
    matrices = plant.matrices(plant.start, port) if port is not None else None
    if matrices is None:
        return None
    A, _, C, _, E, G, _, _ = matrices.values
    output, spread = series.output, [_size(part) for part in series.u.T]
    middle, scale, speed = float(output.mean()), _size(output), bound / NEAR_ZERO
    inside = [(series.places >= p.start) & (series.places < p.stop) for p in record.slices]
    parts = [(part, rows) for part, rows in zip(record.slices, inside, strict=True) if rows.any()]
    blocks = []
    for number, (part, judged) in enumerate(parts):
        u = (record.u[part] - series.u.mean(axis=0)) / spread
        y = (free_run[part] - middle) / scale
        v = np.gradient(free_run[part], record.period) / speed
        sign = np.clip(v / NEAR_ZERO, -1.0, 1.0)
        linear = [np.ones(y.size), *u.T, y, v]
        smooth = [y**2, y**3, v**2, v**3, *(u**2).T, *(u**3).T]
        shifted = [np.concatenate([np.zeros(plant.lag), f])[: y.size] for f in (sign, *linear, *smooth)]
        answers = [_answer(A, E, C, G, force, None) for force in shifted]
        free = np.zeros((y.size, len(parts) * A.shape[0]))
        for i, unit in enumerate(np.eye(A.shape[0])):
            free[:, number * A.shape[0] + i] = _answer(A, E, C, 0.0, np.zeros(y.size), unit)
        rows = series.places[judged] - part.start
        blocks.append(np.column_stack([*answers, np.ones(y.size), free])[rows])
    table = np.vstack(blocks)
    if not np.isfinite(table).all():
        return None
    first, last = 1 + len(linear), 1 + len(linear) + len(smooth)
    others = [*range(1, first), *range(last, table.shape[1])]
    return table[:, 0], table[:, others], table[:, np.arange(first, last)]


def _answer(A: Floats, E: Floats, C: Floats, G: float, force: Floats, start: Floats | None) -> Floats:
    D = np.array([[float(G)]])
    return simulate_state_space(A, E[:, np.newaxis], C[np.newaxis], D, force[:, np.newaxis], start)[:, 0]


def _size(values: Floats) -> float:
    return float(np.std(values)) or 1.0


def _whitened(series: Series, length: int, trace: Floats, others: Floats) -> tuple[Floats, Floats] | None:
    """Return residual and trace, averaged and whitened, without what the others explain."""
    means = _averager(series, length)
    residual = [means(series.residual, run) for run in series.runs]
    noise, _ = autoregression(residual)
    columns = np.column_stack([series.residual, trace, others])
    white = [
        np.column_stack([np.convolve(column, noise, "valid") for column in block.T])
        for block in (means(columns, run) for run in series.runs)
        if block.shape[0] >= noise.size
    ]
    if not white or sum(block.shape[0] for block in white) < FEWEST_MEANS:
        return None
    table = np.vstack(white)
    left = _left(table[:, 2:], table[:, :2])
    if np.linalg.norm(left[:, 1]) <= DEPENDENT * np.linalg.norm(table[:, 1]):
        return None
    return np.ascontiguousarray(left[:, 0]), np.ascontiguousarray(left[:, 1])


def _averager(series: Series, length: int) -> Callable[[Floats, slice], Floats]:
    def means(values: Floats, run: slice) -> Floats:
        part = values[run]
        count = part.shape[0] // length
        return np.asarray(part[: count * length].reshape(count, length, *part.shape[1:]).mean(axis=1))

    return means


def _left(columns: Floats, target: Floats) -> Floats:
    """Return what least squares by columns leaves of one or more targets."""
    size = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(size > 0.0, size, 1.0), full_matrices=False)
    basis = left[:, values > DEPENDENT * values[0]]
    return np.asarray(target - basis @ (basis.T @ target))
