"""A record with a hidden effect: a random plant, excitation, effect of a chosen size, noise."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.demonstration import effects as hidden
from sysid.demonstration.effects import Hidden, Scales
from sysid.demonstration.plants import MODELS, Plant, draw_plant, rounded
from sysid.demonstration.share import added_share, baseline_share, nonlinear_share
from sysid.demonstration.signals import draw_excitation
from sysid.errors import UsageError

Floats = NDArray[np.float64]

SETS = (("est", 1200), ("val", 600), ("test", 600))
N_SAMPLES = sum(size for _, size in SETS)

_GRID = (0.01, 0.03, 0.08, 0.2, 0.4, 0.65, 1.0)
_BISECTIONS = 6
_ATTEMPTS = 300

_EVERYWHERE = (
    "in_saturation",
    "in_deadzone",
    "in_preload",
    "in_relay",
    "in_backlash",
    "in_delay",
    "out_saturation",
    "out_offset",
    "out_drift",
    "out_quantisation",
    "out_rectify",
    "out_quadratic",
)
_LAST = ("op_gain", "extra_mode", "feedthrough", "time_variation", "coloured_noise")
_BODY = ("quad_drag", "cubic_stiffness")
_DRY = ("coulomb", "stribeck")

CANDIDATES: Mapping[str, tuple[str, ...]] = {
    "difference-equation": (*_EVERYWHERE, *_BODY, *_LAST),
    "dc-motor": (*_EVERYWHERE, *_DRY, *_BODY, *_LAST),
    "mass-spring-damper": (*_EVERYWHERE, *_DRY, *_BODY, *_LAST),
    "two-mass": (*_EVERYWHERE, *_DRY, *_BODY, *_LAST),
    "positioning-stage": (*(name for name in _EVERYWHERE if name != "out_rectify"), *_DRY, *_BODY, *_LAST),
    "two-tanks": (*_EVERYWHERE, "sqrt_outflow", "overflow", *_LAST),
}
"""Family -> the effects that a user would ask about, in the catalogue's order."""

FURTHER: Mapping[str, tuple[str, ...]] = {
    "difference-equation": ("in_rate_limit", "in_hysteresis", "out_lowpass", "gravity_sine"),
    "dc-motor": ("in_rate_limit", "in_hysteresis", "asymmetric_friction", "constant_force"),
    "mass-spring-damper": ("in_rate_limit", "asymmetric_friction", "hysteresis_force", "gravity_sine"),
    "two-mass": ("in_rate_limit", "asymmetric_friction", "hysteresis_force", "gravity_sine"),
    "positioning-stage": ("in_rate_limit", "asymmetric_friction", "hysteresis_force", "gravity_sine"),
    "two-tanks": ("in_rate_limit", "in_hysteresis", "out_lowpass"),
}
"""Family -> effects of the catalogue that apply as well."""


@dataclass(frozen=True)
class Difficulty:
    """How large the effect is and how loud the noise.

    Attributes
    ----------
    share : (float, float)
        Range of the share of the output variance that the baseline cannot explain.
    snr : (float, float)
        Range of the signal-to-noise ratio [dB].
    coloured : bool
        Whether the noise of every record is coloured.
    """

    share: tuple[float, float] = (0.03, 0.30)
    snr: tuple[float, float] = (20.0, 40.0)
    coloured: bool = False


@dataclass(frozen=True)
class Case:
    """A record with everything about it; `truth` is what the one who diagnoses must not see.

    Attributes
    ----------
    plant : Plant
    effects : tuple of Hidden
    u : ndarray, shape (N_SAMPLES,)
    noise_free : ndarray, shape (N_SAMPLES,)
        Output of the plant with its effects.
    y : ndarray, shape (N_SAMPLES,)
        Measured output.
    excitation : str
    share : float
        Share of the output variance that the baseline cannot explain.
    snr : float
        Of the white (or coloured) noise [dB].
    start : mapping of str to float
        Uncertain values of the physical parameters, 10 to 20 % off; empty for a difference equation.
    known : mapping of str to float
        Physical parameters that are known.
    """

    plant: Plant
    effects: tuple[Hidden, ...]
    u: Floats
    noise_free: Floats
    y: Floats
    excitation: str
    share: float
    snr: float
    start: Mapping[str, float]
    known: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects that are there."""
        return tuple(effect.name for effect in self.effects)

    @property
    def sets(self) -> NDArray[np.str_]:
        """Split of the rows: est, val, test."""
        return np.repeat([name for name, _ in SETS], [size for _, size in SETS])

    def model_arguments(self) -> list[str]:
        """Arguments of ``sysid`` that name the model and what is known of it."""
        arguments = ["--model", MODELS[self.plant.family]]
        if self.plant.family == "difference-equation":
            return [*arguments, "--order", str(self.plant.order)]
        for name, value in self.start.items():
            arguments += ["--param", f"{name}={value!r}"]
        for name, value in self.known.items():
            arguments += ["--fix", f"{name}={value!r}"]
        return arguments

    def truth(self) -> dict[str, object]:
        """Tell everything that is hidden, in plain values."""
        return {
            "effects": [{"name": e.name, "parameters": dict(e.parameters)} for e in self.effects],
            "family": self.plant.family,
            "order": self.plant.order,
            "parameters": dict(self.plant.parameters),
            "period": self.plant.period,
            "excitation": self.excitation,
            "share": self.share,
            "snr": self.snr,
            "noise_free_test": self.noise_free[self.sets == "test"].tolist(),
            "measured_test": self.y[self.sets == "test"].tolist(),
        }


def simulate(plant: Plant, effects: Sequence[Hidden], u: Floats) -> Floats:
    """Return the noise-free output of a plant with effects, shape (n_samples,)."""
    effects = tuple(effects)
    driven = hidden.map_input(u, effects)
    return hidden.map_output(plant.response(driven, hidden.inside(effects)), u, effects)


def draw_case(
    rng: np.random.Generator,
    family: str,
    names: Sequence[str] = (),
    difficulty: Difficulty | None = None,
) -> Case:
    """Draw a record in which the named effects are hidden.

    Parameters
    ----------
    rng : numpy.random.Generator
    family : str
        A key of `sysid.demonstration.plants.MODELS`.
    names : sequence of str
        Effects of `sysid.demonstration.effects.NAMES`; none for a plant with nothing missing.
    difficulty : Difficulty, optional

    Raises
    ------
    UsageError
        If no plant and excitation of the family shows the effects in the wanted size.

    Examples
    --------
    >>> case = draw_case(np.random.default_rng(0), "dc-motor", ["in_deadzone"])
    >>> case.names, 0.03 <= case.share <= 0.3
    (('in_deadzone',), True)
    """
    difficulty = difficulty or Difficulty()
    for _ in range(_ATTEMPTS):
        case = _attempt(rng, family, tuple(names), difficulty)
        if case is not None:
            return case
    raise UsageError(f"{' and '.join(names)} cannot be hidden in a {family}; choose another effect.")


def _attempt(
    rng: np.random.Generator, family: str, names: tuple[str, ...], difficulty: Difficulty
) -> Case | None:
    plant = draw_plant(rng, family)
    excitation, u = draw_excitation(rng, N_SAMPLES, plant.bandwidth)
    u = _operating_range(rng, plant, u, names)
    found = _hidden(rng, plant, u, [name for name in names if name != "coloured_noise"], difficulty.share)
    if found is None:
        return None
    effects, u, share = found
    noise_free = simulate(plant, effects, u)
    if not np.all(np.isfinite(noise_free)) or np.var(noise_free[-600:]) < 0.1 * np.var(noise_free):
        return None
    snr = float(rng.uniform(*difficulty.snr))
    y = noise_free + _noise(rng, noise_free, snr, coloured=difficulty.coloured)
    if "coloured_noise" in names:
        share = float(np.exp(rng.uniform(*np.log(difficulty.share))))
        y = y + _noise(rng, noise_free, -10.0 * math.log10(share), coloured=True)
        effects.append(Hidden("coloured_noise", {"share": share}))
    start, known = _what_is_known(rng, plant)
    return Case(plant, tuple(effects), u, noise_free, y, excitation, share, snr, start, known)


def _hidden(
    rng: np.random.Generator, plant: Plant, u: Floats, names: Sequence[str], wanted: tuple[float, float]
) -> tuple[list[Hidden], Floats, float] | None:
    """Size the effects one after another, each with those before it in place; None if one cannot be seen."""
    scales = _scales(plant, u)
    low, high = wanted
    effects: list[Hidden] = []
    for name in names:
        found = _sized(rng, plant, u, name, scales, effects, (low * 1.05, high * 0.95 / len(names)))
        if found is None or (len(names) > 1 and found[1] is not u):
            return None
        effects.append(found[0])
        u = found[1]
    if not effects:
        return effects, u, 0.0
    share = _share(plant, effects, u)
    # Whichever of several effects is left out, something must be missing.
    for effect in effects if len(effects) > 1 else ():
        if _added(plant, [other for other in effects if other is not effect], effect, u) < low:
            return None
    return (effects, u, share) if low <= share <= high else None


def _operating_range(rng: np.random.Generator, plant: Plant, u: Floats, names: tuple[str, ...]) -> Floats:
    """Give the excitation its amplitude: around a level for tanks, about a radian for a pendulum."""
    if plant.family == "two-tanks":
        level = plant.parameters["a1"] / plant.parameters["b"]
        return level * np.maximum(1.0 + rng.uniform(0.2, 0.4) * u, 0.0)
    u = u * float(np.exp(rng.uniform(-0.5, 1.0)))
    if "gravity_sine" in names:
        u = u * rng.uniform(0.8, 2.0) / float(np.std(plant.motion(u)[0]))
    return u


def _scales(plant: Plant, u: Floats) -> Scales:
    y = plant.response(u)
    position = velocity = force = 1.0
    if plant.family != "two-tanks":
        position, velocity, force = (float(np.sqrt(np.mean(part**2))) for part in plant.motion(u))
    return Scales(
        u_rms=float(np.sqrt(np.mean(u**2))),
        u_peak=float(np.abs(u).max()),
        u_step=float(np.abs(np.diff(u)).max()),
        y_rms=float(np.std(y)),
        y_peak=float(np.abs(y).max()),
        position=position,
        velocity=velocity,
        force=force,
        bandwidth=plant.bandwidth,
        n_samples=u.size,
    )


def _sized(
    rng: np.random.Generator,
    plant: Plant,
    u: Floats,
    name: str,
    scales: Scales,
    present: Sequence[Hidden],
    wanted: tuple[float, float],
) -> tuple[Hidden, Floats] | None:
    """Find a strength at which the effect has a share in the wanted range, drawn evenly in its logarithm."""
    law = hidden.sizes(rng, name, scales)
    level, strength = float(rng.uniform()), float(rng.uniform())

    def made(strength: float) -> tuple[Hidden, Floats]:
        effect = Hidden(name, law(strength))
        return effect, _excited(plant, u, effect)

    def share(strength: float) -> float:
        effect, driven = made(strength)
        return _added(plant, present, effect, driven) if present else _share(plant, [effect], driven)

    if name in hidden.UNSIZED:
        return made(strength)
    found = _crossing(share, wanted, level)
    return None if found is None else made(found)


def _crossing(share: Callable[[float], float], wanted: tuple[float, float], level: float) -> float | None:
    """Return the first strength of the share `level` of the way up the wanted range, by bisection."""
    shares = [0.0]
    for strength in _GRID:
        shares.append(share(strength))
        if shares[-1] > wanted[1]:
            break
    low, high = wanted[0], min(max(shares), wanted[1])
    if high <= low:
        return None
    target = low * (high / low) ** level
    place = next(i for i, found in enumerate(shares) if found >= target)
    below, above = (0.0, *_GRID)[place - 1], _GRID[place - 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (below + above)
        below, above = (below, middle) if share(middle) > target else (middle, above)
    return above


def _excited(plant: Plant, u: Floats, effect: Hidden) -> Floats:
    """Return the input that shows the effect: a bias for a rectifier, a swing of the level for tanks."""
    if effect.name == "out_rectify":
        return u + effect.parameters["bias"]
    if effect.name == "sqrt_outflow":
        level = plant.parameters["a1"] / plant.parameters["b"]
        return np.asarray(np.maximum(level + 3.0 * effect.parameters["swing"] * (u - level), 0.0))
    return u


def _share(plant: Plant, effects: Sequence[Hidden], u: Floats) -> float:
    y = simulate(plant, effects, u)
    linear = all(effect.name in hidden.LINEAR for effect in effects)
    return (baseline_share if linear else nonlinear_share)(u, y, plant.poles)


def _added(plant: Plant, present: Sequence[Hidden], effect: Hidden, u: Floats) -> float:
    """Return the share of the output that an effect adds to the present ones beyond any short filter."""
    y, before = simulate(plant, [*present, effect], u), simulate(plant, present, u)
    return added_share(y, before, u, constant=effect.name not in hidden.LINEAR)


def _noise(rng: np.random.Generator, y: Floats, snr: float, *, coloured: bool) -> Floats:
    """Return noise of the given signal-to-noise ratio [dB]; coloured is autoregressive of order 1 or 2."""
    from scipy.signal import lfilter

    noise = rng.standard_normal(y.size + 500)
    if coloured:
        radius, angle = rng.uniform(0.6, 0.95), rng.uniform(0.05, 0.6)
        a = [1.0, -radius] if rng.random() < 0.6 else [1.0, -2.0 * radius * math.cos(angle), radius**2]
        noise = lfilter([1.0], a, noise)
    noise = noise[500:]
    return np.asarray(noise / np.std(noise) * np.std(y) * 10.0 ** (-snr / 20.0))


def _what_is_known(rng: np.random.Generator, plant: Plant) -> tuple[dict[str, float], dict[str, float]]:
    """Return the uncertain values, 10 to 20 % off, and the values that are known."""
    if plant.family == "difference-equation":
        return {}, {}
    fixed = {"dc-motor": ("L", "R")}.get(plant.family, ())
    default = {"positioning-stage": ("gain", "offset")}.get(plant.family, ())
    known = {name: plant.parameters[name] for name in fixed}
    start = {
        name: rounded(value * (1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.2))))
        for name, value in plant.parameters.items()
        if name not in fixed and name not in default
    }
    return start, known
