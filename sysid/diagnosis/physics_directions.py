"""Directions in which an effect, listed or not, would change the free run of a physical model."""

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from sysid.diagnosis.effects.base import Effect, Floats, Form
from sysid.diagnosis.physics_free_run import runs
from sysid.diagnosis.physics_search import DRY_PROBE, PROBE, problem_point, shape_values
from sysid.diagnosis.structures import Choice, StructureFit
from sysid.physics.forced import NO_LAW, ForcedPlant

if TYPE_CHECKING:
    from sysid.diagnosis.physics_structure import PhysicsStructure

DEGREES = (2, 3, 4, 5)
EXTRA_LAGS = 8
# Larger grids are thinned out: neighbours would tell the same.
MOST_SHAPES = 24


def directions(structure: "PhysicsStructure", fit: StructureFit, effect: Effect) -> list[Floats]:
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
        found += _of_form(structure, fit, Choice(effect, form), strengths)
    return found


def _of_form(
    structure: "PhysicsStructure", fit: StructureFit, choice: Choice, strengths: list[int]
) -> list[Floats]:
    """Return the directions of one form."""
    before = structure.problem_of(fit)
    problem = structure.problem_of(fit, (*fit.choices, choice))
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


def probes(structure: "PhysicsStructure", fit: StructureFit) -> Floats:
    """Return directions in which an effect that is not in any list would show.

    Functions of input, position, speed and time, added to the output, to the input and, where the
    model has a moving body, to the force on it; and lags of the input.
    """
    problem = structure.problem_of(fit)
    record, plant = structure.record, structure.plant
    values = structure.setting.known.copy()
    values[structure.setting.places] = structure.setting.to_values(fit.point[: problem.n_model])
    numbers = {part.start: number for number, part in enumerate(problem.parts)}
    found = []
    for part in record.slices:
        u = record.u[part]
        states = np.empty((1, u.shape[0], plant.order))
        y = problem.run(part, fit.point[np.newaxis], numbers.get(part.start), states)[0]
        port = plant.port
        position = y if port.position is None else states[0, :, port.position]
        speed = np.gradient(y) if port.velocity is None else states[0, :, port.velocity]
        if port.velocity == port.position and port.velocity is not None:
            speed = np.gradient(position)
        functions = np.array(list(_functions(u[:, 0], position, speed)))
        through = _through(structure, values, functions)
        lags = [_lagged(u[:, 0], lag) for lag in range(2 * plant.order + EXTRA_LAGS + 1)]
        found.append(np.vstack([functions, *through, lags]))
    return np.ascontiguousarray(np.nan_to_num(np.concatenate(found, axis=1)).T)


def _through(structure: "PhysicsStructure", values: Floats, signals: Floats) -> list[Floats]:
    """Return the responses to signals at the input and at the port of forces, from rest."""
    plant = structure.plant
    lanes = signals.shape[0]
    many = np.tile(values, (lanes, 1))
    laws = np.tile(NO_LAW, (lanes, 1))
    driven = np.zeros((lanes, signals.shape[1], plant.n_inputs))
    still = plant.run(values[np.newaxis], NO_LAW[np.newaxis], driven[0])
    driven[:, :, 0] = signals
    found = [plant.run(many, laws, driven) - still]
    if isinstance(plant, ForcedPlant) and plant.port.velocity is not None:
        found.append(np.array([plant.respond(values, signal) for signal in signals]))
    return found


def _functions(u: Floats, position: Floats, speed: Floats) -> Iterator[Floats]:
    before = _lagged(u, 1)
    rise = _scaled(u - before)
    signals = [_scaled(signal) for signal in (u, position, speed)]
    for signal in signals:
        for degree in DEGREES:
            yield np.polynomial.legendre.Legendre.basis(degree)(np.clip(signal / 3.0, -1.0, 1.0))
        yield np.sign(signal)
    u, position, speed = signals
    before = _scaled(before)
    yield from (u * position, u * speed, position * speed, u * before, np.sign(rise), np.abs(rise))
    yield from (u * np.sign(speed), position * np.abs(speed), position**2 * speed, u * np.abs(rise))
    yield from (u**2 * before, u * before**2, position**2 * u, np.sign(speed) * np.abs(position))
    time = np.linspace(-1.0, 1.0, u.size)
    for factor in (np.ones(u.size), u, position):
        for degree in (0, 1, 2, 3):
            yield factor * np.polynomial.legendre.Legendre.basis(degree)(time)


def _scaled(signal: Floats) -> Floats:
    return np.asarray(signal / (float(np.std(signal)) or 1.0))


def _lagged(signal: Floats, lag: int) -> Floats:
    return np.concatenate([np.zeros(min(lag, signal.size)), signal[: max(signal.size - lag, 0)]])
