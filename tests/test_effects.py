"""The catalogue of effects: names, maps against their definitions, effects of one's own."""

import re
import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from sysid.cli import main
from sysid.diagnosis.effects import Effect, EffectParameter, Form, catalogue, find_effects, read_effects
from sysid.diagnosis.effects.counts import counts
from sysid.diagnosis.effects.laws import drive_of, rows_of
from sysid.errors import ModelError

NAMES = [
    "in_saturation",
    "in_deadzone",
    "in_preload",
    "in_relay",
    "in_backlash",
    "in_delay",
    "in_rate_limit",
    "in_hysteresis",
    "out_saturation",
    "out_offset",
    "out_drift",
    "out_quantisation",
    "out_rectify",
    "out_quadratic",
    "out_delay",
    "out_lowpass",
    "coulomb",
    "stribeck",
    "quad_drag",
    "cubic_stiffness",
    "op_gain",
    "sqrt_outflow",
    "overflow",
    "hysteresis_force",
    "gravity_sine",
    "constant_force",
    "asymmetric_friction",
    "extra_mode",
    "feedthrough",
    "time_variation",
    "coloured_noise",
]

U = np.array([0.0, 0.4, 1.3, 2.0, 0.7, -0.2, -1.9, -0.6, 0.1])


def test_the_catalogue_holds_every_effect_with_its_story():
    effects = {effect.name: effect for effect in catalogue()}
    assert set(NAMES) <= set(effects)
    for effect in effects.values():
        story = (effect.mechanism, effect.equation, effect.signature, effect.look_alikes, effect.reference)
        assert all(story)
        for form in effect.forms:
            assert all(parameter.meaning and parameter.unit for parameter in form.parameters)


def test_the_step_of_a_quantiser_is_read_off_the_values_it_shows():
    rng = np.random.default_rng(0)
    signal = 5.0 + np.cumsum(rng.standard_normal(1500)) / 20.0
    step = 0.19
    noise = 0.1 * step * rng.standard_normal(signal.size)
    found = counts(step * np.round(signal / step) + noise)
    # Half a count at the largest value is the least that a grid must resolve; the peak is far sharper.
    assert np.abs(found - step).min() < 0.1 * step * step / np.abs(signal).max()
    assert counts(rng.standard_normal(1500)).size == 0
    assert counts(np.zeros(100)).size == 0


def mapped(name, form, parameters, sequence=U, period=0.5):
    (effect,) = find_effects([name])
    return effect.form(form).apply(np.asarray(sequence), np.asarray(parameters, dtype=float), period)


@pytest.mark.parametrize(
    ("name", "form", "parameters", "expected"),
    [
        ("in_saturation", "two-sided", [0.5, 1.0], lambda u: min(max(u, -0.5), 1.0)),
        ("in_deadzone", "two-sided", [0.5, 1.0], lambda u: u - 1 if u > 1 else u + 0.5 if u < -0.5 else 0.0),
        ("in_preload", "two-sided", [0.5, 1.0], lambda u: u + (1.0 if u > 0 else -0.5 if u < 0 else 0.0)),
        ("in_relay", "symmetric", [0.5], lambda u: float(np.sign(u)) if abs(u) > 0.5 else 0.0),
        ("out_quadratic", "quadratic", [0.3], lambda u: u + 0.3 * u * u),
        ("out_quantisation", "round", [0.5], lambda u: 0.5 * round(u / 0.5)),
        ("out_rectify", "half-wave", [], lambda u: max(u, 0.0)),
        ("out_saturation", "symmetric", [0.9], lambda u: min(max(u, -0.9), 0.9)),
    ],
)
def test_a_static_map_is_its_formula(name, form, parameters, expected):
    assert np.allclose(mapped(name, form, parameters), [expected(u) for u in U], atol=1e-15)


def test_maps_with_memory_against_slow_definitions():
    x, play = 0.0, []
    for u in U:
        x = u - 0.6 if x < u - 0.6 else u + 0.6 if x > u + 0.6 else x
        play.append(x)
    assert np.allclose(mapped("in_backlash", "symmetric", [0.6]), play)
    # 0.8 s are 1.6 samples of 0.5 s.
    delayed = [0.4 * (U[k - 1] if k > 0 else 0) + 0.6 * (U[k - 2] if k > 1 else 0) for k in range(U.size)]
    assert np.allclose(mapped("in_delay", "delay", [0.8]), delayed)
    limited, x = [], U[0]
    for u in U:
        x += np.clip(u - x, -0.35, 0.35)
        limited.append(x)
    assert np.allclose(mapped("in_rate_limit", "symmetric", [0.7]), limited)
    limited, x = [], 0.0
    for u in U:
        x += np.clip(u - x, -0.2, 0.35)
        limited.append(x)
    assert np.allclose(mapped("in_rate_limit", "two-sided from rest", [0.4, 0.7]), limited)
    assert mapped("in_hysteresis", "symmetric", [1.0]).tolist() == [-1, -1, 1, 1, 1, 1, -1, -1, -1]
    assert np.allclose(mapped("out_drift", "linear", [2.0]), U + 2.0 * 0.5 * np.arange(U.size))


def test_a_lag_follows_what_is_straight_between_samples_exactly():
    fine, period, lag = 4000, 0.5, 0.8
    t = np.arange((U.size - 1) * fine + 1) / fine * period
    w = np.interp(t, period * np.arange(U.size), U)
    for form, state in (("straight between samples", 0.0), ("straight between samples in motion", U[0])):
        # What stood at zero before reaches the first row along a straight line.
        x = state or U[0] * (1.0 - (1.0 - np.exp(-period / lag)) * lag / period)
        slow = np.empty_like(w)
        for k, value in enumerate(w):
            if k:
                x += (0.5 * (value + w[k - 1]) - x) * (1.0 - np.exp(-period / fine / lag))
            slow[k] = x
        assert np.allclose(mapped("out_lowpass", form, [lag]), slow[::fine], atol=1e-6)


def test_a_mode_is_the_discretised_oscillator():
    from scipy.signal import lfilter

    frequency, damping, period = 3.0, 0.1, 0.5
    pole = np.exp(period * frequency * (-damping + 1j * np.sqrt(1 - damping**2)))
    expected = lfilter([0.0, 0.2, 0.1], [1.0, -2 * pole.real, abs(pole) ** 2], U)
    found = mapped("extra_mode", "second order", [frequency, damping, 0.2, 0.1])
    assert np.allclose(found, expected, atol=1e-13)


def test_a_law_is_its_expression():
    drag, gain = find_effects(["quad_drag", "op_gain"])
    assert drive_of(drag, drag.forms[0])(1.0, 5.0, -3.0, np.array([0.2])) == pytest.approx(1.0 + 0.2 * 9.0)
    acting = drive_of(gain, gain.forms[0])(2.0, 0.7, 9.0, np.array([0.3, 0.5]))
    assert acting == pytest.approx(2.0 * (1.0 + 0.3 * np.tanh(0.7 / 0.5)))


def test_an_effect_of_ones_own_in_python_and_in_toml(tmp_path):
    cube = Effect(
        "in_cube", "input", "", "x = u + c u^3", "", "", "",
        (Form("cube", (EffectParameter("c", "1/[u]^2", ""),), lambda u, p, period: u + p[0] * u**3),),
    )  # fmt: skip
    assert find_effects([cube, "coulomb"])[0].forms[0].apply(U, np.array([2.0]), 1.0)[2] == 1.3 + 2 * 1.3**3
    file = tmp_path / "mine.toml"
    file.write_text('[in_cube]\nport = "input"\nexpression = "s + c*s**3"\nparameters.c.unit = "1/[u]^2"\n')
    (read,) = read_effects(file)
    assert np.allclose(read.forms[0].apply(U, np.array([2.0]), 1.0), U + 2 * U**3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[a]\nexpression = "os"\nport = "input"', "symbol 'os' is not known"),
        ('[a]\nport = "nowhere"\nexpression = "x"', "port 'nowhere' is not known"),
        ('[a]\nexpression = "x"\ncolour = 1', "key 'colour' is not known"),
        ("[a]\nport = 1", "give a table with port"),
        ("no toml", "is not TOML"),
        ('[a]\nexpression = "k*x"\nparameters.k.grid = { scale = "ell", points = [1] }', "scale 'ell'"),
        ('[a]\nexpression = "k*xx"\nparameters.k = {}', r"bad.toml: effect 'a', .*'k\*xx': symbol 'xx'"),
        ('[a]\nport = "output"\nexpression = "s+"', r"bad.toml: effect 'a', .*'s\+': it is not an expr"),
        (
            '[a]\nexpression = "k*x"\nparameters.k = { smallest = 0 }',
            "parameter 'k': key 'smallest' is not known",
        ),
        (
            '[a]\nexpression = "k*x"\nparameters.k.grid = { scale = "plain", points = [] }',
            "parameter 'k': its grid is empty",
        ),
    ],
)
def test_a_bad_effect_is_one_clear_sentence(tmp_path, text, message):
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(ModelError, match=message):
        read_effects(file)[0].forms[0].apply(U, np.zeros(0), 1.0)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("no_such_package_here:effect", "cannot be loaded .*repair the package"),
        ("json:nothing", "cannot be loaded .*repair the package"),
        ("json:dumps", "is of type function: name an Effect"),
    ],
)
def test_an_installed_effect_that_cannot_be_used_is_one_clear_sentence(monkeypatch, capsys, value, message):
    entry = EntryPoint("mine", value, "sysid.effects")
    monkeypatch.setattr(sys.modules[read_effects.__module__], "entry_points", lambda group: (entry,))
    catalogue.cache_clear()
    try:
        assert main(["effects"]) == 2
    finally:
        catalogue.cache_clear()
    error = capsys.readouterr().err
    assert re.search(f"entry point 'mine' of sysid.effects, {value}, {message}", error)
    assert error.count("\n") == 1


def test_a_misspelt_effect_is_guessed_and_one_named_again_counts_once():
    with pytest.raises(ModelError, match="'coulumb' is not known: did you mean coulomb"):
        find_effects(["coulumb"])
    assert [effect.name for effect in find_effects(["coulomb", "in_delay", "coulomb"])] == [
        "coulomb",
        "in_delay",
    ]


def test_the_command_lists_and_explains(capsys):
    assert main(["effects"]) == 0
    listed = capsys.readouterr().out
    assert all(name in listed for name in NAMES)
    assert main(["effects", "in_backlash"]) == 0
    told = capsys.readouterr().out
    assert "play operator" in told
    assert "width in [u]: half the gap (tried from 0.05 to 0.88 x the input's swing)" in told
    assert "[u], [y], [F], [x] and [v] stand for the units" in told
    assert main(["effects", "in_backlsh"]) == 2
    assert "effect 'in_backlsh' is not known" in capsys.readouterr().err


def test_compiled_laws_have_names_of_their_own():
    """numba tells the environments of functions that it loads apart by module and name: two of one name, kept
    by different processes, ended in an error of numba's."""
    drag, constant = find_effects(["quad_drag", "constant_force"])
    names = {
        law(effect, effect.forms[0]).__name__ for law in (rows_of, drive_of) for effect in (drag, constant)
    }
    assert len(names) == 4
