"""Where searches for a state-space model start: subspace estimates, and poles found output by output."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sysid.linear.forms import Complexes, Floats, poles_of
from sysid.linear.reduction import Segment, Structure
from sysid.linear.restarts import ranked_starts, shortened
from sysid.linear.sections import Sections, sections_of
from sysid.linear.subspace import INSTRUMENTS, Factor, Run

RANKING_ROWS = 5_000
# Poles that are tried of each output, and random changes of the best end's, as shares of 1 - modulus.
OF_EACH_OUTPUT, CHANGED = 2, 6
CHANGE = 0.5


def first_starts(
    factor: Factor, order: int, direct: bool, free_start: bool, runs: Sequence[Run], weights: Floats
) -> list[Sections]:
    """Return the models of the subspace estimates."""
    found = []
    for kind in INSTRUMENTS:
        A, C = factor.dynamics(kind, order)
        model = sections_of(A, C, factor.n_inputs, direct=direct, constant=free_start, free_start=free_start)
        found.append(model.with_linear_part(runs, weights))
    return found


def further_starts(best: Sections, runs: Sequence[Run], weights: Floats) -> Iterator[Sections]:
    """Make models with the poles that suit each output by itself, then with the best model's changed."""
    order = best.order
    structure = Structure(order, 0 if best.direct else 1, best.constant, best.free_start)
    for o in range(weights.size):
        segments = tuple(Segment(run.u, run.y[:, o], run.used) for run in runs)
        for reflections in ranked_starts(shortened(segments, RANKING_ROWS), structure, ())[:OF_EACH_OUTPUT]:
            yield with_poles(best, poles_of(reflections), runs, weights)
    rng = np.random.default_rng(0)
    for _ in range(CHANGED):
        yield with_poles(best, changed(best.poles, rng), runs, weights)


def changed(poles: Complexes, rng: np.random.Generator) -> Complexes:
    """Return poles whose time constants and frequencies are some half larger or smaller; pairs stay pairs."""
    found: list[complex] = []
    for pole in poles[poles.imag >= 0.0]:
        rate = np.log(pole if abs(pole) > 1e-6 else 1e-6 + 0j)
        real, imaginary = np.exp(CHANGE * rng.standard_normal(2))
        moved = complex(np.exp(complex(rate.real * real, np.clip(rate.imag * imaginary, 0.0, np.pi))))
        found += [moved, moved.conjugate()] if pole.imag > 0.0 else [complex(moved.real)]
    return np.array(found, dtype=np.complex128)


def with_poles(like: Sections, poles: Complexes, runs: Sequence[Run], weights: Floats) -> Sections:
    """Return a model with given poles and nearly the best outputs.

    Each output alone is linear in the residues at the poles.  Those of all outputs at one pole are a matrix
    of rank one in a model with no more states than poles: C takes its leading direction.
    """
    modes = _modes(poles)
    of_outputs = []
    for o in range(weights.size):
        reading = np.array([[[1.0, 0.0] if isinstance(mode, complex) else [1.0, 1.0] for mode in modes]])
        alone = _with_modes(like, modes, reading)
        measured = [replace(run, y=run.y[:, [o]]) for run in runs]
        of_inputs = alone.with_linear_part(measured, weights[[o]]).B[:, :, : like.D.shape[1]]
        of_outputs.append(of_inputs * weights[o])
    residues = np.stack(of_outputs)
    readings = np.empty((weights.size, len(modes), 2))
    for place, mode in enumerate(modes):
        if isinstance(mode, complex):
            direction = _leading(residues[:, place, 0] - 1j * residues[:, place, 1])
            readings[:, place] = np.column_stack([direction.real, direction.imag])
        else:
            readings[:, place] = np.column_stack([_leading(residues[:, place, j]).real for j in range(2)])
    readings /= weights[:, np.newaxis, np.newaxis]
    if like.order % 2:
        readings[:, -1, 1] = 0.0
    return _with_modes(like, modes, readings).with_linear_part(runs, weights)


def _leading(matrix: Complexes | Floats) -> Complexes | Floats:
    return np.asarray(np.linalg.svd(matrix, full_matrices=False)[0][:, 0])


def _modes(poles: Complexes) -> list[complex | tuple[float, float]]:
    """Return a complex pole of each pair, then real poles two by two, slow with slow; 0 fills the last."""
    pairs: list[complex | tuple[float, float]] = [complex(pole) for pole in poles if pole.imag > 0.0]
    real = sorted((float(pole.real) for pole in poles if pole.imag == 0.0), reverse=True)
    return pairs + [(real[i], real[i + 1] if i + 1 < len(real) else 0.0) for i in range(0, len(real), 2)]


def _with_modes(like: Sections, modes: list[complex | tuple[float, float]], readings: Floats) -> Sections:
    """Return a model with these poles and C, of shape (n_outputs, n_sections, 2), and nothing else."""
    blocks = [
        [[mode.real, mode.imag], [-mode.imag, mode.real]]
        if isinstance(mode, complex)
        else [[mode[0], 0.0], [0.0, mode[1]]]
        for mode in modes
    ]
    p = readings.shape[0]
    B = np.zeros((len(modes), 2, like.B.shape[2]))
    D, offset = np.zeros((p, like.D.shape[1])), np.zeros(p)
    return replace(like, A=np.array(blocks), B=B, C=readings, D=D, offset=offset)
