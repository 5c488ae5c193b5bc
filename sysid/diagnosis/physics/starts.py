"""Where to start the search of a physical model: near its values, or at the response of a linear fit."""

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.physics.setting import LARGEST_LOGARITHM, Setting
from sysid.errors import SysidError
from sysid.physics import forced_kernels as fk
from sysid.physics.expressions import symbols
from sysid.physics.forced import NO_LAW, ForcedPlant
from sysid.separable.descent import levenberg_marquardt

FREQUENCIES = 40
# Draws around values that are known within some 20 %.
NEAR_SPREAD, NEAR_SEED = 0.25, 7
# The response is compared up to this share of the Nyquist frequency.
HIGHEST = 0.8
# Draws of the logarithms around the nominal values: a factor of exp(4) = 55 to each side.
DRAWS, SPREAD, SEED = 24, 4.0, 11
EVALUATIONS = 60
# So many of the best are searched by the free run.
KEPT = 4
# Gains below this one count as this one: their logarithm is taken.
FLOOR = 1e-12


def near_starts(setting: Setting, count: int) -> list[Floats]:
    """Return the nominal values and draws around them."""
    generator = np.random.default_rng(NEAR_SEED)
    nominal = setting.nominal
    width = np.where(setting.positive, NEAR_SPREAD, NEAR_SPREAD * np.abs(nominal))
    draws = [nominal + width * generator.uniform(-1.0, 1.0, nominal.size) for _ in range(count)]
    return [nominal, *draws]


def wide_starts(setting: Setting, rows: Mask) -> list[Floats]:
    """Return starts for parameters of which little is known."""
    if isinstance(setting.plant, ForcedPlant):
        return like_linear_fit(setting, rows)
    from sysid.physics.fit import fit_physics

    state = "estimate" if setting.free_start else "rest"
    fit = fit_physics(setting.record, setting.model, initial_state=state, rows=rows)
    found = setting.to_coordinates(np.array([fit.values[p.name] for p in setting.searched]))
    return [found, setting.nominal]


def like_linear_fit(setting: Setting, rows: Mask) -> list[Floats]:
    """Return search coordinates whose response resembles that of a linear fit, the best first.

    The logarithm of the size of a response is nearly linear in the logarithms of masses, dampings and
    stiffnesses, so a search from afar does not stop at minima of the free run's error.

    Returns
    -------
    list of ndarray, shape (n_searched,)
        The nominal values among them.
    """
    nominal = setting.nominal
    try:
        frequencies, target, weights = _response_of_linear_fit(setting, rows)
    except SysidError:
        return [nominal]

    def residual(x: Floats) -> Floats:
        return np.asarray(((_log_response(setting, x, frequencies) - target) * weights).ravel())

    def jacobian(x: Floats) -> Floats:
        base = residual(x)
        return np.column_stack([(residual(x + step) - base) / 1e-6 for step in 1e-6 * np.eye(x.size)])

    generator = np.random.default_rng(SEED)
    draws = [nominal] + [nominal + SPREAD * generator.uniform(-1.0, 1.0, nominal.size) for _ in range(DRAWS)]
    low = [np.log(max(p.minimum, FLOOR)) if p.positive else p.minimum for p in setting.searched]
    high = [np.log(p.maximum) if p.positive else p.maximum for p in setting.searched]
    bounds = np.maximum(low, -LARGEST_LOGARITHM), np.minimum(high, LARGEST_LOGARITHM)
    found = []
    for draw in draws:
        start = np.clip(draw, *bounds)
        if np.isfinite(residual(start)).all():
            end = levenberg_marquardt(
                residual, jacobian, start, bounds=bounds, tolerance=1e-6, max_evaluations=EVALUATIONS
            )
            found.append((end.cost, end.x))
    found.sort(key=lambda item: item[0])
    return [*(x for _, x in found[:KEPT]), nominal]


def at_the_same_flow(setting: Setting, point: Floats) -> Floats:
    """Return a point whose outflows with the root of a level carry about what they did in proportion to it.

    From a x to a sqrt(x) the coefficient changes by the root of the level, which depends on its unit: of a
    level in millimetres a search from the same number starts with next to no flow.

    Examples
    --------
    >>> from sysid.data import make_record
    >>> from sysid.diagnosis.diagnose import structure_of
    >>> record = make_record(np.arange(30.0), np.tile([90.0, 110.0], 15), period=1.0)
    >>> setting = structure_of(record, "two-tanks", None, "rest").setting
    >>> np.exp(at_the_same_flow(setting, setting.nominal)).round(3)
    array([1. , 1. , 0.1])
    """
    record, model = setting.record, setting.model
    level = float(np.nanmean(np.abs(record.y[record.learning, 0])))
    states = {model.states[i].name for i in setting.plant.port.levels}
    flows = [symbols(term.expression) for equation in model.equations for term in equation.terms]
    moved = point.copy()
    for place, parameter in enumerate(setting.searched):
        if level > 0.0 and any(parameter.name in inside and inside & states for inside in flows):
            moved[place] = (
                moved[place] + 0.5 * np.log(level) if parameter.positive else moved[place] * level**0.5
            )
    return moved


def _response_of_linear_fit(setting: Setting, rows: Mask) -> tuple[Floats, Floats, Floats]:
    """Return frequencies, logarithm of the gain of a linear model, and how strongly the input excites it.

    Shapes (n_frequencies,), (n_inputs, n_frequencies) twice.
    """
    from sysid.linear.output_error import fit_output_error

    record, period = setting.record, setting.record.period
    initial_state = "estimate" if setting.free_start else "rest"
    fit = fit_output_error(record, setting.plant.order, initial_state=initial_state, rows=rows)
    frequencies = np.geomspace(4 * np.pi / rows.sum(), HIGHEST * np.pi, FREQUENCIES)
    z = np.exp(-1j * frequencies)
    below = np.polyval(np.asarray(fit.a)[::-1], z)
    held = np.abs(np.sinc(frequencies / (2 * np.pi)))
    gains, weights = [], []
    for channel, b in enumerate(np.atleast_2d(fit.b)):
        gain = np.abs(np.polyval(b[::-1], z) / below) / held
        spectrum = np.abs(np.fft.rfft(record.u[rows, channel] - record.u[rows, channel].mean()))
        place = np.minimum((frequencies / np.pi * (spectrum.size - 1)).astype(int), spectrum.size - 1)
        smooth = np.sqrt(np.convolve(spectrum**2, np.ones(9) / 9.0, mode="same"))[place]
        gains.append(np.log(np.maximum(gain, FLOOR)))
        strength = smooth * gain
        weights.append(np.sqrt(strength / max(float(strength.max()), FLOOR)) + 0.02)
    return frequencies / period, np.array(gains), np.array(weights)


def _log_response(setting: Setting, x: Floats, frequencies: Floats) -> Floats:
    """Return the logarithm of the model's gain from each input, shape (n_inputs, n_frequencies)."""
    plant = setting.plant
    assert isinstance(plant, ForcedPlant)
    values = setting.values_of(x)
    plants, by_input, direct = plant.coefficients(values[np.newaxis], NO_LAW[np.newaxis])
    n = plant.order
    matrix = plants[0, fk.A : fk.A + 16].reshape(4, 4)[:n, :n]
    read = plants[0, fk.READ : fk.READ + n]
    with np.errstate(all="ignore"):
        try:
            inverse = np.linalg.inv(1j * frequencies[:, np.newaxis, np.newaxis] * np.eye(n) - matrix)
        except np.linalg.LinAlgError:
            return np.full((plant.n_inputs, frequencies.size), np.nan)
        gain = np.abs(np.einsum("i,fij,jm->mf", read, inverse, by_input[0, :n]) + direct[0][:, np.newaxis])
        return np.asarray(np.log(np.maximum(gain, FLOOR)))
