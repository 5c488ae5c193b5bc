"""The pictures of what an added effect does show the effect that was hidden."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import sysid
from sysid.data import make_record
from sysid.diagnosis.effect_views import effect_views
from sysid.diagnosis.effect_views.probing import is_instantaneous
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.pages.figures_effects import effect_pictures

PERIOD, N = 0.1, 900


def slow(seed, size=1.0, hold=6):
    return np.repeat(np.random.default_rng(seed).uniform(-size, size, N // hold), hold)


def behind(x):
    """Return y(k) = 0.8 y(k-1) + 0.5 x(k-1)."""
    y = np.zeros(x.size)
    for k in range(1, x.size):
        y[k] = 0.8 * y[k - 1] + 0.5 * x[k - 1]
    return y + 0.005 * np.random.default_rng(9).standard_normal(x.size)


def view_of(u, y, effect, model="linear", order=1, **options):
    record = make_record(u, y, PERIOD)
    found = sysid.diagnose(record, model, order, initial_state="rest", effects=[effect], **options)
    assert found.accepted == (effect,)
    (view,) = effect_views(found.final)
    assert view.effect == effect
    return view


def test_the_law_of_a_map_is_drawn_over_the_data():
    u = slow(1)
    view = view_of(u, behind(np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0)), "in_deadzone")
    assert (view.kind, view.quantity, view.result) == ("law", "u", "u that acts")
    expected = np.sign(view.value) * np.maximum(np.abs(view.value) - 0.4, 0.0)
    np.testing.assert_allclose(view.law, expected, atol=0.02)  # some standard errors of the width
    np.testing.assert_array_equal(view.without, view.value)
    np.testing.assert_array_equal(np.sort(view.seen), np.sort(u))


def test_a_sensor_is_drawn_by_what_it_would_read():
    u = slow(2, 2.0)
    free = behind(u)
    view = view_of(u, np.clip(free, -1.5, 1.5), "out_saturation")
    assert (view.quantity, view.result) == ("y before the sensor", "y read")
    np.testing.assert_allclose(view.law, np.clip(view.value, -1.5, 1.5), atol=0.02)
    assert view.seen.max() > 2.0  # more than was ever read
    assert view.seen.max() == pytest.approx(free.max(), abs=0.1)


def test_a_map_with_a_memory_is_drawn_over_time_where_it_shows():
    u = slow(3)
    play = np.zeros(N)
    for k in range(1, N):
        play[k] = min(max(play[k - 1], u[k] - 0.3), u[k] + 0.3)
    view = view_of(u, behind(play), "in_backlash")
    rows = np.rint(view.value / PERIOD).astype(int)
    assert view.kind == "course"
    np.testing.assert_array_equal(view.without, u[rows])
    np.testing.assert_allclose(view.law, play[rows], atol=0.03)


@pytest.mark.parametrize(
    ("effect", "result", "expected"),
    [
        ("time_variation", "factor of u", lambda t: 1.0 + 0.01 * t),
        ("out_drift", "added to y", lambda t: 0.02 * t),
    ],
)
def test_what_changes_with_time_is_drawn_over_all_of_it(effect, result, expected):
    t, u = PERIOD * np.arange(N), slow(4)
    y = behind(u * expected(t)) if effect == "time_variation" else behind(u) + expected(t)
    view = view_of(u, y, effect)
    assert (view.kind, view.result) == ("time", result)
    np.testing.assert_allclose(view.law, expected(view.value), atol=0.05)
    assert view.seen.size == 0


def test_a_mode_is_drawn_by_its_pulse_response():
    u = np.random.default_rng(5).standard_normal(N)
    ring, radius, angle = np.zeros(N), 0.95, 0.9
    for k in range(2, N):
        ring[k] = 2.0 * radius * np.cos(angle) * ring[k - 1] - radius**2 * ring[k - 2] + 0.2 * u[k - 1]
    view = view_of(u, behind(u) + ring, "extra_mode")
    k = np.arange(view.value.size)
    expected = 0.2 * radius ** np.maximum(k - 1, 0) * np.sin(angle * k) / np.sin(angle)
    np.testing.assert_allclose(view.law, expected, atol=0.02)


def moving(u, force, state=(0.0, 0.0)):
    """Integrate x'' = u - 0.5 x' - x - force(x, v) by an adaptive solver, the input held."""
    state, y = np.array(state), []
    for value in u:
        y.append(state[0])
        slope = lambda t, s, value=value: [s[1], value - 0.5 * s[1] - s[0] - force(s[0], s[1])]  # noqa: E731
        state = solve_ivp(slope, (0.0, PERIOD), state, rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(y) + 1e-3 * np.random.default_rng(8).standard_normal(u.size)


MASS = {"start": {"m": 1.0, "c": 0.5, "k": 1.0}}


@pytest.mark.parametrize(
    ("effect", "on", "unit", "force"),
    [
        ("quad_drag", "velocity", "m/s", lambda x, v: 0.6 * v * abs(v)),
        ("cubic_stiffness", "position", "m", lambda x, v: 0.3 * x**3),
    ],
)
def test_a_force_is_drawn_by_what_it_depends_on(effect, on, unit, force):
    u = slow(6, 4.0, 15)
    view = view_of(u, moving(u, force), effect, "mass-spring-damper", None, **MASS)
    assert (view.kind, view.quantity, view.unit, view.result_unit) == ("law", on, unit, "N")
    expected = np.array([force(a, a) for a in view.value])
    np.testing.assert_allclose(view.law, expected, atol=0.03 * np.abs(expected).max())
    assert view.seen.size == N


def drag_in_a_sample(u):
    """Return y(k) = 0.8 y(k-1) + 0.5 x(k-1), where x = u - 0.8 v |v| and v = y(k) - y(k-1)."""
    y, x = np.zeros(N), np.zeros(N)
    for k in range(N):
        if k:
            y[k] = 0.8 * y[k - 1] + 0.5 * x[k - 1]
        v = y[k] - y[k - 1] if k else 0.0
        x[k] = u[k] - 0.8 * v * abs(v)
    return y + 0.002 * np.random.default_rng(3).standard_normal(N)


@pytest.mark.parametrize(
    ("effect", "port", "of"),
    [
        ("in_deadzone", "input", lambda u: behind(np.sign(u) * np.maximum(np.abs(u) - 0.4, 0.0))),
        ("quad_drag", "velocity", drag_in_a_sample),
    ],
)
def test_a_curve_that_knows_no_law_agrees_with_the_law(effect, port, of):
    u = slow(1)
    record = make_record(u, of(u), PERIOD)
    found = sysid.diagnose(record, "linear", 1, initial_state="rest", effects=[effect])
    (view,) = found.views
    assert view.port == port
    free, law = view.free, np.interp(view.free.value, view.value, view.law)
    inside = (free.value > view.value[0]) & (free.value < view.value[-1])
    near = (free.lower <= law) & (law <= free.upper)
    # Pointwise at 95 %, and neighbours move together.
    assert np.mean(near[inside]) > 0.8
    assert np.abs(free.centre - law)[inside].max() < 0.1 * np.ptp(law)
    with_it = effect_pictures((view,))[0]
    assert "without knowing the law" in with_it.reading


def test_views_become_pictures_with_a_reading():
    u = slow(1)
    view = view_of(u, behind(np.clip(u, -0.5, 0.6)), "in_saturation")
    (picture,) = effect_pictures((view,))
    assert picture.title == "What in_saturation does"
    assert picture.wide.startswith("<svg") or "<svg" in picture.wide
    assert "dashed without the effect" in picture.reading
    assert "free form" not in picture.reading


def test_an_effect_that_is_a_number_alone_has_no_picture():
    u = slow(7)
    y = behind(u) + 0.3 * u
    found = sysid.diagnose(
        make_record(u, y, PERIOD), "linear", 1, initial_state="rest", effects=["feedthrough"]
    )
    assert found.accepted == ("feedthrough",)
    assert effect_views(found.final) == ()


def test_play_behind_a_relay_is_not_instantaneous_although_few_rows_are_at_rest():
    seen = 2.0 * np.random.default_rng(2).choice([-1.0, 0.0, 1.0], 1800, p=[0.47, 0.06, 0.47])
    (play,) = find_effects(["in_backlash"])
    assert not is_instantaneous(lambda s: play.forms[0].apply(s, np.array([1.026]), 1.0), seen)
    assert is_instantaneous(np.abs, seen)
