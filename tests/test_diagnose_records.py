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


def test_a_hair_dryer_lacks_nothing(records):
    found = diagnose(read(records, "hair_dryer"), "linear")
    assert set(found.accepted) <= {"in_delay", "coloured_noise"}
    # The noise floor of the record is near 79 mV.
    assert found.ladder[-1].scores["test"]["rmse"] < 0.085
