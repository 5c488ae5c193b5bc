"""Several outputs of one physical model: what they share, and by how much the error of each counts."""

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.linear.forms import Floats
from sysid.linear.output_error import make_segments
from sysid.linear.reduction import Segment
from sysid.physics.problem import Problem
from sysid.physics.restarts import EVALUATIONS, descend
from sysid.separable.descent import Minimum, Residual

ROUNDS, TOLERANCE = 20, 1e-3
# An output that is fitted better than this share of its size is exact: its noise is rounding.
EXACT_SHARE = 1e-6


def segments_of(record: Record, rows: Mask | None) -> tuple[Segment, ...]:
    """Cut the experiments that hold chosen rows; several outputs side by side, shape (n_rows, n_outputs)."""
    cut = [make_segments(record.of_output(name), rows) for name in record.outputs]
    if len(cut) == 1:
        return cut[0]
    return tuple(
        Segment(same[0].u, np.column_stack([s.y for s in same]), same[0].used)
        for same in zip(*cut, strict=True)
    )


def output_sizes(segments: tuple[Segment, ...]) -> Floats:
    """Return the standard deviation of each output over the used rows."""
    y = np.concatenate([segment.y[segment.used].reshape(int(segment.used.sum()), -1) for segment in segments])
    return np.asarray(np.std(y, axis=0))


def first_weights(segments: tuple[Segment, ...]) -> Floats:
    """Return weights before anything is known of the noise: one output as it is, several by their sizes."""
    sizes = output_sizes(segments)
    return np.ones(1) if sizes.size == 1 else 1.0 / np.where(sizes > 0.0, sizes, 1.0)


def rms_of_outputs(problem: Problem, residual: Floats) -> Floats:
    """Return the root mean square of the error of each output, in its unit."""
    found = []
    for place, weight in enumerate(problem.weights.tolist()):
        parts = [residual[rows] for rows, _, output in problem.runs() if output == place]
        found.append(np.sqrt(np.mean(np.concatenate(parts) ** 2)) / weight)
    return np.array(found)


def weighed_by_noise(problem: Problem, minimum: Minimum[Residual]) -> tuple[Problem, Minimum[Residual]]:
    """Weigh each output by what is left of it, and search on, until neither changes.

    With s_i the size of what is left of output i this lowers sum_i n_i log s_i at every round: the
    logarithm of the likelihood under white noise that is independent from output to output.
    """
    sizes = output_sizes(problem.segments)
    for _ in range(ROUNDS):
        left = np.maximum(rms_of_outputs(problem, minimum.point.residual), EXACT_SHARE * sizes)
        weights = 1.0 / np.where(left > 0.0, left, 1.0)
        if np.abs(weights / problem.weights - 1.0).max() < TOLERANCE:
            break
        problem = problem.with_weights(weights)
        minimum = descend(problem, minimum.x, EVALUATIONS)
    return problem, minimum
