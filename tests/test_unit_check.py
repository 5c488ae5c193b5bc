"""Columns in another unit than the model's: told by their names, or by start values that they miss."""

import numpy as np
import pytest
from scipy.signal import lsim

from sysid import compare, diagnose
from sysid.data import Record, make_record
from sysid.data.conversions import conversion, other_units
from sysid.diagnosis.models.unit_check import in_units_of
from sysid.physics import load_model
from sysid.physics.model import Model

PERIOD = 0.01
TRUE = {"m": 2.0, "c": 12.0, "k": 800.0}
GIVEN = {"m": 2.3, "c": 10.0, "k": 700.0}


def spring_record(scale: float = 1.0, names: tuple[str, str] = ("F", "x"), seed: int = 0) -> Record:
    """Return a noisy record of a mass on a spring, its position multiplied, simulated by scipy."""
    rng = np.random.default_rng(seed)
    u = 20.0 * np.repeat(rng.uniform(-1, 1, 120), 10)
    t = PERIOD * np.arange(u.size)
    system = (
        [[0.0, 1.0], [-TRUE["k"] / TRUE["m"], -TRUE["c"] / TRUE["m"]]],
        [[0.0], [1.0 / TRUE["m"]]],
        [[1.0, 0.0]],
        [[0.0]],
    )
    y = lsim(system, u, t, interp=False)[1]
    y = scale * (y + 0.02 * y.std() * rng.standard_normal(y.size))
    split = np.repeat(["est", "val", "test"], [700, 200, 300])
    given = {name: name.partition("[")[2].rstrip("]") for name in names if "[" in name}
    return make_record(u, y, period=PERIOD, split=split, inputs=names[:1], outputs=names[1:], units=given)


def spring(**given: float) -> Model:
    return load_model("mass-spring-damper").with_parameters(given or GIVEN)


def test_conversions_are_those_of_the_tables() -> None:
    # NIST SP 811: 1 rpm = 2 pi/60 rad/s, 1 mile = 1609.344 m, 1 bar = 1e5 Pa; exact, up to rounding.
    expected = {("rpm", "rad/s"): 60 / (2 * np.pi), ("mph", "m/s"): 3600 / 1609.344, ("kPa", "bar"): 100.0}
    expected |= {("um", "mm"): 1e3, ("°", "rad"): 180 / np.pi, ("kN", "N"): 1e-3, ("degC", "K"): None}
    for (given, wanted), size in expected.items():
        assert conversion(given, wanted) == (None if size is None else pytest.approx(size, rel=1e-12))


def test_other_units_leave_out_the_unit_itself() -> None:
    assert set(other_units("m")) == {"mm", "cm", "µm", "deg", "mrad"}
    assert other_units("no unit") == {}


@pytest.mark.parametrize(("scale", "unit"), [(1e3, "mm"), (1e2, "cm"), (180 / np.pi, "deg")])
def test_start_values_tell_the_unit(scale: float, unit: str) -> None:
    model, note = in_units_of(spring_record(scale), spring())
    assert f"'x' in {unit} and not in m" in note
    assert str(model.outputs[0]) == f"y = {scale:.12g}*x"


def test_a_name_with_its_unit_tells_it() -> None:
    for names in (("F", "x [mm]"), ("F", "x_mm")):
        model, note = in_units_of(spring_record(1e3, names), spring())
        assert "is in mm where the model has m" in note
        assert str(model.outputs[0]) == "y = 1000*x"


def test_an_input_in_another_unit_is_converted_at_the_input() -> None:
    model, note = in_units_of(spring_record(1e3, ("F [kN]", "x [m]")), spring())
    assert "'F [kN]' is in kN where the model has N" in note
    assert "1000*u" in str(model)


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_said_of_a_record_in_the_units_of_the_model(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = {name: value * rng.uniform(0.75, 1.3) for name, value in TRUE.items()}
    for names in (("F", "x"), ("F [N]", "x [m]")):
        model = spring(**start)
        assert in_units_of(spring_record(1.0, names, seed), model) == (model, "")


def test_start_values_in_the_units_of_the_column_are_left_alone() -> None:
    model = spring(**{name: value / 1e3 for name, value in GIVEN.items()})
    assert in_units_of(spring_record(1e3, ("F", "x [mm]")), model) == (model, "")


def test_without_start_values_only_a_name_tells() -> None:
    model = load_model("mass-spring-damper")
    assert in_units_of(spring_record(1e3), model) == (model, "")
    same, note = in_units_of(spring_record(1e3, ("F", "x [mm]")), model)
    assert same == model
    assert "divide 'x [mm]' by 1000 first" in note


def test_a_gain_of_ten_that_fits_as_well_is_not_converted() -> None:
    # What is missing may be a gain: a factor of rpm to rad/s is told as a possibility.
    motor = load_model("dc-motor").with_parameters({"J": 0.1, "K": 0.5}, {"b": 1e-3, "L": 1e-2, "R": 1.0})
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1, 1, 100), 12)
    A, B = [[-0.01, 5.0], [-50.0, -100.0]], [[0.0], [100.0]]
    y = 9.5493 * lsim((A, B, [[1.0, 0.0]], [[0.0]]), u, PERIOD * np.arange(u.size), interp=False)[1]
    record = make_record(u, y + 0.01 * rng.standard_normal(y.size), period=PERIOD)
    model, note = in_units_of(record, motor)
    assert "in rpm and not in rad/s" in note
    assert model == motor or "converted" in note


def test_compare_and_diagnose_find_the_parameters_of_a_record_in_millimetres() -> None:
    record = spring_record(1e3)
    found = compare(record, "mass-spring-damper", start=GIVEN, ports=False)
    assert any("'x' in mm and not in m" in sentence for sentence in found.model.notes)
    diagnosis = diagnose(record, "mass-spring-damper", start=GIVEN)
    assert diagnosis.verdict == "nothing-missing"
    assert any(sentence.startswith("Units: ") for sentence in diagnosis.sentences())
    values = {p.name: p.value for p in diagnosis.final.parameters}
    # Noise of 2 % on 900 rows leaves each parameter within one per cent.
    for name, value in TRUE.items():
        assert values[name] == pytest.approx(value, rel=0.02)
        assert found.model.parameters[name].value == pytest.approx(value, rel=0.02)


@pytest.mark.parametrize(("unit", "size"), [("rpm", 30 / np.pi), ("deg/s", 180 / np.pi)])
def test_a_unit_is_told_although_friction_is_missing(unit: str, size: float) -> None:
    # Without the friction of its shaft a motor's values come out wrong by a factor of their own.
    rng = np.random.default_rng(9)
    J, b, K, L, R, dry, fine = 2e-3, 8e-4, 0.09, 3e-3, 1.4, 0.035, 20
    u, w, current, y, h = np.repeat(rng.uniform(-6, 6, 32), 35), 0.0, 0.0, np.empty(1120), 0.005 / fine
    for k, volts in enumerate(u):
        y[k] = size * w
        for _ in range(fine):
            current += h / L * (volts - R * current - K * w)
            free = w + h / J * (K * current - b * w)
            w = np.sign(free) * max(abs(free) - h / J * dry, 0.0)
    record = make_record(u, y + 0.01 * y.std() * rng.standard_normal(y.size), period=0.005)
    motor = load_model("dc-motor").with_parameters({"J": 2.2e-3, "b": 7e-4, "K": 0.09}, {"L": L, "R": R})
    model, note = in_units_of(record, motor)
    assert f"in {unit} and not in rad/s" in note
    assert model.outputs[0].unit == unit


@pytest.mark.parametrize(("scale", "names", "unit"), [(1.0, ("F", "x"), "m"), (1e3, ("F", "x"), "mm")])
def test_errors_are_told_in_the_unit_of_the_model(scale: float, names: tuple[str, str], unit: str) -> None:
    record = spring_record(scale, names)
    found = compare(record, "mass-spring-damper", start=GIVEN, ports=False)
    assert f"{unit} RMSE" in found.sentences()[0]
    diagnosis = diagnose(record, "mass-spring-damper", start=GIVEN, max_effects=0)
    assert diagnosis.record.unit("x") == unit
    assert diagnosis.record.unit("F") == "N"
    assert any(f"{unit} RMSE" in sentence for sentence in diagnosis.sentences())


def test_a_unit_that_a_column_has_is_kept() -> None:
    record = spring_record(1e3, ("F", "x [mm]"))
    assert compare(record, "mass-spring-damper", ports=False).record.unit("x [mm]") == "mm"
    assert record.with_units({"x [mm]": "m", "F": "N"}).units == {"x [mm]": "mm", "F": "N"}
    assert record.units == {"x [mm]": "mm"}
