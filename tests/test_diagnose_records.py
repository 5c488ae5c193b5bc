"""Diagnosis of measured records: what is missing, and how far the error falls."""

import pytest

from sysid.data import read_record
from sysid.diagnosis.diagnose import diagnose
from sysid.diagnosis.long_records import rows_for_one


def read(records, name, ending="csv"):
    return read_record(records / name / f"{name}.{ending}", split="split", experiment="experiment")


def test_a_positioning_system_is_sampled_faster_than_it_moves_and_an_oscillator_is_not(records):
    # At 1 kHz a carriage of 0.5 s needs no row in ten; an oscillator at 70 Hz needs every row at 610 Hz.
    assert rows_for_one(read(records, "emps", "csv.gz")) == 9
    assert rows_for_one(read(records, "silverbox", "csv.gz")) == 1


@pytest.mark.slow
def test_a_positioning_system_lacks_dry_friction(records):
    found = diagnose(
        read(records, "emps", "csv.gz"),
        "positioning-stage",
        fixed={"gain": 35.15},
        effects=["coulomb", "quad_drag", "in_deadzone"],
        max_effects=1,
    )
    assert found.decision.trials[0].name == "coulomb"


def errors(found):
    """Return the free-run errors on the test sets [mV]."""
    return {name: 1e3 * score["rmse"] for name, score in found.ladder[-1].scores.items()}


def test_an_oscillator_as_a_difference_equation_lacks_a_cubic_stiffness(records):
    found = diagnose(
        read(records, "silverbox", "csv.gz"),
        "linear",
        2,
        effects=["cubic_stiffness", "feedthrough", "in_delay"],
    )
    assert "cubic_stiffness" in found.accepted
    # Linear 8 and 16 mV; a cubic term and a direct path, fitted to the free run of all rows, 0.41 and 0.62.
    assert errors(found)["test_multisine"] < 0.45
    assert errors(found)["test_arrow"] < 0.68


@pytest.mark.slow
def test_an_oscillator_lacks_a_cubic_stiffness_and_a_bias(records):
    found = diagnose(
        read(records, "silverbox", "csv.gz"),
        "oscillator",
        effects=["cubic_stiffness", "constant_force", "in_saturation"],
    )
    assert set(found.accepted) >= {"cubic_stiffness", "constant_force"}
    assert errors(found)["test_multisine"] < 0.37
    assert errors(found)["test_arrow"] < 0.55


@pytest.mark.slow
def test_tanks_empty_by_the_root_of_their_level_and_overflow(records):
    found = diagnose(
        read(records, "cascaded_tanks"),
        "two-tanks",
        effects=["sqrt_outflow", "overflow", "out_quadratic", "out_offset"],
    )
    assert set(found.accepted) >= {"sqrt_outflow", "overflow"}
    # A linear model has 1.1 V; a square root alone 0.68 V, no better than a shifted linear one; recurrent
    # networks have 0.40 V.
    assert errors(found)["test"] < 300.0


def test_a_hair_dryer_lacks_nothing(records):
    found = diagnose(read(records, "hair_dryer"), "linear")
    assert set(found.accepted) <= {"in_delay", "coloured_noise"}
    # The noise floor of the record is near 79 mV.
    assert found.ladder[-1].scores["test"]["rmse"] < 0.085
