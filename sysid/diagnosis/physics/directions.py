"""Directions in which an effect, listed or not, would change the free run of a physical model."""

from itertools import product

import numpy as np

from sysid.diagnosis.effects.base import Effect, Floats, Form
from sysid.diagnosis.physics.free_run import runs
from sysid.diagnosis.physics.problem import Problem, problem_of
from sysid.diagnosis.physics.search import DRY_PROBE, PROBE, problem_point, shape_values
from sysid.diagnosis.physics.setting import Setting
from sysid.diagnosis.structures.probe_functions import EXTRA_LAGS, probe_functions
from sysid.diagnosis.structures.structure import Choice, StructureFit
from sysid.physics.forced import ForcedPlant

# Share of the input at which the response to a small signal is measured.
RIPPLE = 1e-3
# Larger grids are thinned out: neighbours would tell the same.
MOST_SHAPES = 24


def directions(setting: Setting, fit: StructureFit, effect: Effect) -> list[Floats]:
    """Return how an effect, added to a fit, would change its free run, at a grid of its shapes.

    Each of shape (n_samples, n_columns): one column for each strength, or the change itself.
    """
    if effect.port == "noise":
        return []
    found: list[Floats] = []
    for form in effect.found_by:
        strengths = [j for j, p in enumerate(form.parameters) if p.is_strength]
        if len(form.shapes) > 1 and not strengths and len(effect.forms) > 1:
            continue  # the symmetric form stands for the two-sided one
        found += _of_form(setting, fit, Choice(effect, form), strengths)
    return found


def _of_form(setting: Setting, fit: StructureFit, choice: Choice, strengths: list[int]) -> list[Floats]:
    """Return the directions of one form."""
    before = problem_of(setting, fit)
    problem = problem_of(setting, fit, (*fit.choices, choice))
    first = problem.effect_places[-1].start
    start = problem_point(problem, before, fit.point)
    shapes = _thinned(list(product(*shape_values(problem, len(fit.choices)))), choice.form)
    size = (DRY_PROBE if choice.effect.dry else PROBE) * problem.sizes[
        first : first + len(choice.form.parameters)
    ]
    points, probed = [], []
    for values in shapes:
        point = start.copy()
        point[[first + j for j in choice.form.shapes]] = values
        points.append(point)
        for j in strengths:
            moved = point.copy()
            moved[first + j] += size[j]
            probed.append(moved)
    moved_runs = runs(problem, np.array(probed if strengths else points))
    # With its strengths at zero an effect leaves the run as it is, but for the steps of the simulation.
    still, point = (problem, start) if strengths else (before, fit.point)
    base = runs(still, point[np.newaxis])[0]
    count = len(strengths) or 1
    found = []
    for number in range(len(shapes)):
        change = moved_runs[number * count : (number + 1) * count] - base
        if np.isfinite(change).all():
            found.append(
                np.ascontiguousarray((change / size[strengths, np.newaxis] if strengths else change).T)
            )
    return found


def _thinned(shapes: list[tuple[float, ...]], form: Form) -> list[tuple[float, ...]]:
    """Return at most so many shapes; those of a sharp resonance are all kept."""
    step = 1 if len(form.shapes) < 2 or form.apply is not None else -(-len(shapes) // MOST_SHAPES)
    return shapes[::step]


def probes(setting: Setting, fit: StructureFit, since: int = 0) -> Floats:
    """Return directions in which an effect that is not in any list would show.

    Functions of input, position, speed and time, added to the output, to the input of the model with its
    effects and, where the model has a moving body, to the force on it; and lags of the input.

    Parameters
    ----------
    setting : Setting
    fit : StructureFit
    since : int
        Least number of samples by which the input comes before the output.

    Returns
    -------
    ndarray, shape (n_samples, n_probes)
    """
    problem = problem_of(setting, fit)
    record, plant = setting.record, setting.plant
    numbers = {part.start: number for number, part in enumerate(problem.parts)}
    found = []
    for part in record.slices:
        u = record.u[part]
        states = np.empty((1, u.shape[0], plant.order))
        y = problem.run(part, fit.point[np.newaxis], numbers.get(part.start), states)[0]
        port = plant.port
        position = y if port.position is None else states[0, :, port.position]
        if port.velocity is None or port.velocity == port.position:
            slope = np.gradient(position if port.velocity is not None else y)
            speed = _lagged(slope, since)  # that of a row asks for the next row, which its input moves
        else:
            slope = speed = states[0, :, port.velocity]
        time, before = np.linspace(-1.0, 1.0, u.shape[0]), _lagged(u[:, 0], 1)
        shown = _lagged(u[:, 0], since), _lagged(before, since)
        functions = np.array([*probe_functions(*shown, position, speed, time)])
        # What is held over a sample is best known in its middle.
        middle = _in_the_middle(position), _in_the_middle(slope)
        held = np.array([*probe_functions(u[:, 0], before, *middle, time)])
        through = _through(problem, fit.point, (part, numbers.get(part.start)), held)
        lags = [_lagged(u[:, 0], lag) for lag in range(since, 2 * plant.order + EXTRA_LAGS + 1)]
        found.append(np.vstack([functions, *through, lags]))
    return np.ascontiguousarray(np.nan_to_num(np.concatenate(found, axis=1)).T)


def _through(
    problem: Problem, point: Floats, part: tuple[slice, int | None], signals: Floats
) -> list[Floats]:
    """Return the responses to signals at the input and at the port of forces."""
    setting, plant = problem.setting, problem.setting.plant
    values = setting.values_of(point)
    moved = problem.moved_by_input(*part, point, RIPPLE * setting.sizes["u"] * signals)
    found = [moved / (RIPPLE * setting.sizes["u"])]
    if isinstance(plant, ForcedPlant) and plant.port.velocity is not None:
        found.append(np.array([plant.respond(values, signal) for signal in signals]))
    return found


def _in_the_middle(signal: Floats) -> Floats:
    """Return the mean of each value and the next."""
    return np.asarray(0.5 * (signal + np.append(signal[1:], signal[-1:])))


def _lagged(signal: Floats, lag: int) -> Floats:
    return np.concatenate([np.zeros(min(lag, signal.size)), signal[: max(signal.size - lag, 0)]])
