"""Starts from an identified linear model: its frequency response is matched before the data are.

A free run has many local minima in the parameters of a mechanical system, and every evaluation runs
over the record.  A linear model of the same order has its own search, which knows poles; what is left is to
find physical parameters with the same transfer function, and that costs next to nothing.  So it is done
from very many places.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid.linear.forms import Floats, denominator, poles_of
from sysid.linear.output_error import coefficients
from sysid.linear.reduction import Structure
from sysid.linear.restarts import best_search, first_cost, shortened
from sysid.linear.search import Search
from sysid.physics.linear_form import discretise
from sysid.physics.problem import Problem
from sysid.separable.descent import levenberg_marquardt

Complexes = NDArray[np.complex128]

# So many for each unknown parameter.
DRAWS, SURVIVORS = 120, 4
EVALUATIONS = 60
FREQUENCIES = 60
# Frequencies about a resonance, in half-widths of its peak.
ABOUT_A_POLE = (-3.0, -1.0, -0.3, 0.3, 1.0, 3.0)
DELAYS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 38, 54)
SEED = 20_241
# Ends nearer than this are one; two from different places are kept, to tell that they agree.
ALIKE, COPIES = 0.05, 2
IDENTIFICATION_ROWS = 10_000


class Target(NamedTuple):
    """The frequency response that is matched.

    Attributes
    ----------
    z : ndarray, shape (n_frequencies,)
        Points on the unit circle.
    response : ndarray, shape (n_frequencies, n_inputs)
    weight : ndarray, shape (n_frequencies, n_inputs)
        Near one where the record tells the response, near zero where noise hides it.
    """

    z: Complexes
    response: Complexes
    weight: Floats


def matched_points(problem: Problem, centre: Floats, width: Floats, count: int) -> list[Floats]:
    """Return coordinates whose transfer function is that of an identified model, the best match first.

    Parameters
    ----------
    problem : Problem
        Of a linear model, on the rows to identify from.
    centre, width : ndarray, shape (n_searched,)
        Draws lie within the width of the centre.
    count : int
        Most points to return.

    Returns
    -------
    list of ndarray
        Empty if the model is not linear; a point that two searches have found comes twice.
    """
    if problem.simulator.form is None:
        return []
    match = Match(problem, identified_response(problem))
    low, high = (bound[: centre.size] for bound in problem.bounds())
    generator = np.random.default_rng(SEED)
    draws = [centre, *(centre + width * generator.uniform(-1.0, 1.0, (DRAWS * centre.size, centre.size)))]
    with np.errstate(all="ignore"):
        ranked = sorted((match.cost(point), i) for i, point in enumerate(np.clip(draws, low, high)))
        ends = []
        for cost, i in ranked[: SURVIVORS * centre.size]:
            if not np.isfinite(cost):
                break
            end = levenberg_marquardt(
                match.residual,
                match.jacobian,
                np.clip(draws[i], low, high),
                bounds=(low, high),
                tolerance=1e-6,
                max_evaluations=EVALUATIONS,
            )
            ends.append((end.cost, end.x))
    ends.sort(key=lambda end: end[0])
    chosen: list[Floats] = []
    for _, point in ends:
        alike = sum(np.abs(point - other).max(initial=0.0) < ALIKE for other in chosen)
        if len(chosen) < count and alike < COPIES:
            chosen.append(point)
    return chosen


def identified_response(problem: Problem) -> Target:
    """Return the frequency response of the best output-error model of the same order."""
    segments, form = shortened(problem.segments, IDENTIFICATION_ROWS), problem.simulator.form
    assert form is not None
    n_inputs = segments[0].u.shape[1]
    n_rows = max(segment.y.size for segment in segments)
    shifted = any(variable.delay for variable in problem.model.inputs)
    constant = problem.free_start or any(
        column == form.n_states + form.n_inputs for _, column, _ in (*form.rates, *form.outputs)
    )
    direct = any(form.n_states <= column < form.n_states + form.n_inputs for _, column, _ in form.outputs)
    delays = tuple(lag for lag in DELAYS if lag <= max(n_rows // 20, 1)) if shifted else (0 if direct else 1,)
    structures = [Structure(problem.model.order, lag, constant, problem.free_start) for lag in delays]
    structure = min(structures, key=lambda s: first_cost(segments, s)) if shifted else structures[0]
    search = best_search(segments, structure)
    noise = float(np.sqrt(search.cost / sum(int(segment.used.sum()) for segment in segments)))
    return _target(problem, structure, search, noise, n_inputs)


def _target(problem: Problem, structure: Structure, search: Search, noise: float, n_inputs: int) -> Target:
    b, a = numerators_and_denominator(structure, search, n_inputs)
    omega = _frequencies(search, max(segment.y.size for segment in problem.segments))
    z = np.exp(1j * omega)
    powers = z[:, np.newaxis] ** -np.arange(a.size)
    lags = z[:, np.newaxis] ** -(structure.delay + np.arange(b.shape[1]))
    response = (lags @ b.T) / (powers @ a)[:, np.newaxis]
    spread = noise / np.maximum(_input_amplitude(problem, omega, n_inputs), 1e-300)
    return Target(z, response, np.abs(response) / (np.abs(response) + spread))


def numerators_and_denominator(structure: Structure, search: Search, n_inputs: int) -> tuple[Floats, Floats]:
    """Return B of each input and A of a search."""
    _, b, _ = coefficients(structure, search.reflections, search.projection.shared, n_inputs)
    return b, denominator(search.reflections)


def _frequencies(search: Search, n_rows: int) -> Floats:
    """Return frequencies [rad/sample]: even in the logarithm, and some about each resonance."""
    spread = np.geomspace(2.0 * np.pi / n_rows, 0.9 * np.pi, FREQUENCIES)
    poles = poles_of(search.reflections)
    resonant = poles[(poles.imag > 0.0) & (np.abs(poles) > 0.2)]
    about = [np.angle(pole) - np.log(abs(pole)) * share for pole in resonant for share in ABOUT_A_POLE]
    inside = [omega for omega in about if spread[0] < omega < spread[-1]]
    return np.unique(np.concatenate([spread, inside]))


def _input_amplitude(problem: Problem, omega: Floats, n_inputs: int) -> Floats:
    """Return the root of the input's energy in the band about each frequency, shape (n, n_inputs)."""
    edges = np.concatenate([[0.0], np.sqrt(omega[1:] * omega[:-1]), [np.pi]])
    energy = np.zeros((omega.size, n_inputs))
    for segment in problem.segments:
        n_rows = segment.y.size
        power = np.abs(np.fft.rfft(segment.u, axis=0)) ** 2 / n_rows
        band = np.searchsorted(edges, 2.0 * np.pi * np.arange(power.shape[0]) / n_rows, "right") - 1
        np.add.at(energy, np.clip(band, 0, omega.size - 1), power)
    return np.sqrt(energy)


@dataclass(frozen=True)
class Match:
    """Logarithmic distance of a model's frequency response from a target.

    The logarithm of a transfer function in the logarithms of masses, stiffnesses and dampings bends little,
    so that searches rarely end in a local minimum.
    """

    problem: Problem
    target: Target

    def cost(self, coordinates: Floats) -> float:
        """Return the sum of squares; infinite where it has no value."""
        residual = self.residual(coordinates)
        cost = float(residual @ residual)
        return cost if np.isfinite(cost) else np.inf

    def residual(self, coordinates: Floats) -> Floats:
        """Return weighted differences of log magnitude and phase."""
        response, _ = self._response(coordinates, slopes=False)
        return self._parts(np.log(response / self.target.response))

    def jacobian(self, coordinates: Floats) -> Floats:
        """Return the derivative of the residual by the coordinates."""
        response, slopes = self._response(coordinates, slopes=True)
        scale = self.problem.slopes(coordinates)
        return np.stack(
            [self._parts(slope / response) * s for slope, s in zip(slopes, scale, strict=True)], axis=1
        )

    def _parts(self, difference: Complexes) -> Floats:
        weighted = difference * self.target.weight
        return np.concatenate([weighted.real.ravel(), weighted.imag.ravel()])

    def _response(self, coordinates: Floats, *, slopes: bool) -> tuple[Complexes, Complexes]:
        """Return the response, shape (n_frequencies, n_inputs), and its derivatives on a first axis."""
        simulator, z = self.problem.simulator, self.target.z
        values = self.problem.values(coordinates)
        assert simulator.form is not None
        d = discretise(simulator.form, values, simulator.period, slopes=slopes)
        n, m = d.A.shape[0], d.B.shape[1] - 1
        try:
            inverse = np.linalg.inv(z[:, np.newaxis, np.newaxis] * np.eye(n) - d.A)
        except np.linalg.LinAlgError:  # a pole on the unit circle, at one of the frequencies
            inverse = np.full((z.size, n, n), np.nan)
        X, Y = inverse @ d.B[:, :m], d.C @ inverse
        response = (d.C @ X + d.D[:, :m])[:, 0, :]
        shift, shift_slopes = self._delays(values, z)
        count = d.A_slopes.shape[0]
        found = np.empty((count, *response.shape), dtype=np.complex128)
        for c in range(count):
            inner = Y @ (d.A_slopes[c] @ X + d.B_slopes[c, :, :m])
            found[c] = (inner + d.C_slopes[c] @ X + d.D_slopes[c, :, :m])[:, 0, :] * shift
            found[c] += response * shift_slopes[c]
        return response * shift, found

    def _delays(self, values: dict[str, float], z: Complexes) -> tuple[Complexes, Complexes]:
        """Return the factor of dead times for each input, and its derivatives by the searched parameters."""
        problem = self.problem
        names = [variable.delay for variable in problem.model.inputs]
        samples = np.array([values[name] / problem.period if name else 0.0 for name in names])
        shift = z[:, np.newaxis] ** -samples
        slopes = np.zeros((len(problem.names), *shift.shape), dtype=np.complex128)
        for j, name in enumerate(names):
            if name in problem.names:
                slopes[problem.names.index(name), :, j] = -np.log(z) / problem.period * shift[:, j]
        return shift, slopes
