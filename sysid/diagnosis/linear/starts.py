"""Starts for effects whose free-run error has several minima."""

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain, Run
from sysid.diagnosis.linear.drives import DRIVING
from sysid.diagnosis.linear.kernels import is_stable, simulate
from sysid.diagnosis.linear.levenberg import minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.sign_retrieval import retrieved_signs
from sysid.diagnosis.structures.structure import WHITE

# Rounds of fitting under the signs of the fit before.
RETRIEVALS = 6
# Regressions, each filtered by the denominator of the one before.
REFILTERED = 4


def further_starts(chain: Chain, data: Data, point: Floats, which: int) -> list[Floats]:
    """Return further starts for the last effect: of the parameters before its own, or of all.

    None for another one, which has been searched before.
    """
    if which < len(chain.choices) - 1:
        return []
    choice = chain.choices[-1]
    port, alone = choice.effect.port, len(chain.drives) == 1
    if (port in DRIVING and alone) or (port == "input" and not choice.form.shapes and not chain.drives):
        return _by_equation_error(chain, data, point)
    if choice.name == "feedthrough" and len(chain.choices) == 1:
        return _with_direct_path(chain, data, point)
    if choice.name == "out_rectify" and choice.form.name == "full-wave":
        return _with_signs(chain, data, point)
    return []


def _with_signs(chain: Chain, data: Data, point: Floats) -> list[Floats]:
    """Return starts for a rectified output: guess the signs, fit, take the signs of the fit, and again.

    The first guesses are those of `retrieved_signs`, the sign of the fit without the rectifier, and that
    of its fit to the output less part of its mean: where the rectifier folds much of the signal over,
    the mean is its trace.
    """
    plain = Chain(chain.order, chain.choices[:-1], chain.constant, chain.free_start, chain.steps)
    size = float(np.sqrt(np.mean(data.y[data.used] ** 2)))
    run, guesses = plain.run(data, point), []
    for sign in retrieved_signs(data, data.u if run is None else run.x, chain.constant):
        # The fit without the rectifier followed next to nothing: its poles are no start.
        signed = Data(data.u, sign * data.y, data.used, data.begin, data.period)
        regressed = with_regressed_coefficients(plain, signed, point)
        guesses.append(_fit(plain, data, point if regressed is None else regressed, sign * data.y))
    for share in (0.0, 0.5, 1.0):
        middle = share * float(np.mean(data.y[data.used]))
        guesses.append(_fit(plain, data, point, data.y - middle))
    found = (_with_own_signs(plain, data, guess, size) for guess in guesses)
    return [point for point in found if point is not None]


def _with_own_signs(plain: Chain, data: Data, guess: Floats | None, size: float) -> Floats | None:
    """Fit with the signs of the fit before, time and again."""
    for _ in range(RETRIEVALS):
        run = None if guess is None else plain.run(data, guess)
        if guess is None or run is None:
            break
        sign = np.where(run.y < -1e-9 * size, -1.0, 1.0)
        guess = _fit(plain, data, guess, sign * data.y)
    return guess


def _fit(chain: Chain, data: Data, point: Floats, y: Floats) -> Floats | None:
    """Fit a chain to another output."""
    other = Data(data.u, y, data.used, data.begin, data.period)
    end = minimise(chain, other, point, WHITE, iterations=8)
    return None if end is None else end.point


def _by_equation_error(chain: Chain, data: Data, point: Floats) -> list[Floats]:
    """Return starts for a force, gain or input map by regression, the output in it as it was measured.

    The regression is linear in the coefficients and in the strengths times them, so it has no local minimum.
    Filtering by the last 1/A lessens what the noise does to it; a constant and a drift are taken along.

    Source: Steiglitz & McBride (1965), IEEE Transactions on Automatic Control 10.
    """
    form, n, place = chain.choices[-1].form, chain.order, chain.places(data)[-1]
    strengths = [place.start + i for i, p in enumerate(form.parameters) if p.is_strength]
    if not strengths:
        return []
    middle = [grid[grid.size // 2] for grid in form.starts(data.u, data.y[data.used], data.period)]
    own = np.zeros(len(form.parameters))
    own[list(form.shapes)] = middle
    whole = np.concatenate([point, own])
    units = np.tile(whole, (len(strengths), 1))
    units[np.arange(len(strengths)), strengths] = 1.0
    run = chain.run(data, whole)
    if run is None:
        return []
    measured = np.where(data.used, data.y - (run.y - run.z), run.z)
    starts = []
    for seen in (measured, run.z):
        a, current = np.zeros(n), seen
        for step in range(REFILTERED):
            felt = [_added_by(chain, data, unit, run, current) for unit in units]
            found = _regressed(data, n, a, measured, run.x, felt)
            if found is None:
                break
            start = whole.copy()
            start[: 2 * n], start[strengths] = found
            coefficients = found[0]
            a = coefficients[:n] if is_stable(coefficients[:n]) else a
            simulated = chain.run(data, start)
            if simulated is None:
                continue
            current = simulated.z
            if step in (0, REFILTERED - 1):
                starts.append(start)
    return starts


def _added_by(chain: Chain, data: Data, unit: Floats, run: Run, z: Floats) -> Floats:
    """Return what the last effect adds to the input with its strength at one, if the output were ``z``."""
    if chain.drives:
        return chain.felt(data, unit, run.x, z) - run.x
    return chain.mapped(data, unit) - run.x


def _with_direct_path(chain: Chain, data: Data, point: Floats) -> list[Floats]:
    """Return a start for a direct path by regression: in A y = B u + d A u it is the coefficient of u itself.

    The fit without it has no zeros where the plant has them, and its poles may be far off.
    """
    n, whole = chain.order, np.append(point, 0.0)
    run = chain.run(data, whole)
    if run is None:
        return []
    measured = np.where(data.used, data.y, run.y)
    signals = [measured, data.u, np.ones(data.u.size), np.arange(data.u.size) / data.u.size]
    a, starts = np.zeros(n), []
    for _ in range(REFILTERED):
        y, u, *slow = (data.by_experiment(lambda s, p, T: _all_pole(s, p), signal, a) for signal in signals)
        past = [data.lagged(signal, i) for signal in (-y, u) for i in range(1, n + 1)]
        found = _least_squares(np.array([*past, u, *slow]).T[data.used], y[data.used])
        if found is None or not is_stable(found[:n]):
            break
        a, d, start = found[:n], found[2 * n], whole.copy()
        start[: 2 * n], start[-1] = np.concatenate([a, found[n : 2 * n] - d * a]), d
        starts.append(start)
    return starts[-1:]


def with_regressed_coefficients(chain: Chain, data: Data, whole: Floats) -> Floats | None:
    """Return a point with a and b from the equation error, the effects held as they are."""
    run, n = chain.run(data, whole), chain.order
    if run is None:
        return None
    measured = np.where(data.used, data.y - (run.y - run.z), run.z)
    a, start = np.zeros(n), whole.copy()
    for _ in range(REFILTERED - 1):
        found = _regressed(data, n, a, measured, run.v, [])
        if found is None or not is_stable(found[0][:n]):
            break
        start[: 2 * n], a = found[0], found[0][:n]
    return start


def _regressed(
    data: Data, n: int, a: Floats, z: Floats, x: Floats, felt: list[Floats]
) -> tuple[Floats, list[float]] | None:
    """Return a, b and the strengths from the equation error, all signals filtered by 1/A first."""
    signals = [z, x, *felt, np.ones(z.size), np.arange(z.size) / z.size]
    rows = [data.by_experiment(lambda s, p, T: _all_pole(s, a), signal, a) for signal in signals]
    columns = [data.lagged(-rows[0], i) for i in range(1, n + 1)]
    columns += [data.lagged(row, i) for row in rows[1:-2] for i in range(1, n + 1)]
    found = _least_squares(np.array([*columns, *rows[-2:]]).T[data.used], rows[0][data.used])
    if found is None:
        return None
    b, *scaled = found[n : (2 + len(felt)) * n].reshape(-1, n)
    return found[: 2 * n], [float(b @ d) / max(float(b @ b), 1e-300) for d in scaled]


def _least_squares(X: Floats, y: Floats) -> Floats | None:
    """Return the coefficients of a regression; None if a column is lost."""
    size = np.linalg.norm(X, axis=0)
    if not np.isfinite(size).all() or (size == 0.0).any():
        return None
    return np.asarray(np.linalg.lstsq(X / size, y, rcond=1e-10)[0] / size)


def _all_pole(signal: Floats, a: Floats) -> Floats:
    """Filter by 1/A from rest."""
    z = np.empty(signal.size)
    begin = np.array([0, signal.size])
    b = np.zeros(a.size + 1)
    b[0] = 1.0
    # The kernel's B starts at one lag: one more coefficient of A and a shift give 1/A itself.
    padded = np.append(signal[1:], 0.0)
    start = np.zeros((1, a.size + 1))
    start[0, 0] = signal[0]
    simulate(padded, np.append(a, 0.0), b, 0.0, start, begin, z)
    return z
