"""Claims files: what is read, what is refused, and how each tolerance is judged."""

import json
import math
from dataclasses import replace

import pytest

from sysid.claims import VERDICTS, Claim, judge, read
from sysid.errors import UsageError

ENTRY = {
    "id": '"a"',
    "where": '"Table 1"',
    "printed": "1.02",
    "number": '"mean/a"',
    "unit": '""',
    "verdict": '"reproduced"',
    "tolerance": '{type = "digits", decimals = 2}',
}


@pytest.fixture
def claims_file(tmp_path):
    def write(*entries):
        path = tmp_path / "paper.toml"
        tables = [
            "[[claim]]\n" + "\n".join(f"{key} = {value}" for key, value in entry.items()) for entry in entries
        ]
        path.write_text("\n\n".join(tables), encoding="utf-8")
        return path

    return write


def claim(kind, printed=1.02, verdict="replicated", **parameters):
    return Claim("a", "Table 1", printed, "a", "", verdict, {"type": kind, **parameters})


# Reading --------------------------------------------------------------------------------------------


def test_a_file_is_read_in_its_order(claims_file):
    second = ENTRY | {"id": '"b"', "note": '"why"', "printed": '"c < 1"', "tolerance": '{type = "exact"}'}
    first, last = read(claims_file(ENTRY, second))
    assert (first.id, first.printed, first.tolerance["decimals"], first.note) == ("a", 1.02, 2, "")
    assert (last.id, last.printed, last.note) == ("b", "c < 1", "why")
    assert first.value is None
    assert not first.passed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "1"}, "paper.toml: claim a has unknown key 'colour'; keys are id, note, number"),
        ({"where": None}, "paper.toml: claim a has no 'where'"),
        ({"id": None}, "paper.toml: claim number 1 has no 'id'"),
        ({"verdict": '"perhaps"'}, "paper.toml: claim a has verdict 'perhaps'; use one of reproduced"),
        ({"tolerance": '{type = "loose"}'}, "claim a has tolerance type 'loose'; use one of exact, digits"),
        ({"tolerance": "{decimals = 2}"}, "claim a has tolerance type None"),
        ({"tolerance": '"exact"'}, "claim a has tolerance type 'exact'"),
        (
            {"tolerance": '{type = "digits"}'},
            "claim a has a tolerance of type digits without a number 'decimals'",
        ),
        ({"tolerance": '{type = "relative"}'}, "without a number 'tolerance': add it"),
        (
            {"tolerance": '{type = "slope", tolerance = "x"}'},
            "tolerance = 'x' in its tolerance, which is no number",
        ),
        ({"tolerance": '{type = "slope", tolerance = nan}'}, "tolerance = nan in its tolerance"),
        ({"tolerance": '{type = "relative", tolerance = true}'}, "tolerance = True in its tolerance"),
        (
            {"tolerance": '{type = "digits", decimals = -1}'},
            "decimals = -1 in its tolerance, which is no whole",
        ),
        ({"tolerance": '{type = "digits", decimals = 1.5}'}, "decimals = 1.5 in its tolerance"),
        ({"tolerance": '{type = "exact", decimals = "2"}'}, "decimals = '2' in its tolerance"),
        ({"tolerance": '{type = ["exact"]}'}, "claim a has tolerance type ['exact']"),
        ({"printed": "[1, 2]"}, "claim a has printed = [1, 2]: give it as a text"),
        ({"printed": "nan"}, "claim a has printed = nan"),
        ({"verdict": "1"}, "claim a has verdict 1"),
        ({"number": "7"}, "claim a has number = 7: give it as a text"),
    ],
)
def test_a_faulty_claim_is_named_with_its_file(claims_file, change, message):
    entry = {key: value for key, value in (ENTRY | change).items() if value is not None}
    with pytest.raises(UsageError) as error:
        read(claims_file(entry))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"paper.toml cannot be read"):
        read(tmp_path / "paper.toml")
    (tmp_path / "paper.toml").write_bytes(b"# caf\xe9")
    with pytest.raises(UsageError, match=r"paper.toml is not UTF-8 text \(byte 5\)"):
        read(tmp_path / "paper.toml")


def test_an_id_is_used_once(claims_file):
    with pytest.raises(UsageError, match=r"paper.toml: claim id a is used twice"):
        read(claims_file(ENTRY, ENTRY))


@pytest.mark.parametrize("text", ["", "claim = 3", "claim = [1]", "[claim]\nid = 1", "[[claim]\n"])
def test_a_file_without_claims_is_refused(tmp_path, text):
    path = tmp_path / "paper.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"^paper.toml (is not TOML|has no array of tables)"):
        read(path)


# Judging --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "values", "others"),
    [
        (claim("exact", 3), [3.0], [3.0000001, 2.9999999]),
        (claim("digits", decimals=2), [1.015, 1.02, 1.025], [1.01499, 1.02501]),
        (claim("digits", -0.83, decimals=2), [-0.835, -0.825], [-0.8351, -0.8249, 0.83]),
        (claim("relative", tolerance=0.1), [0.9181, 1.1219], [0.9179, 1.1221, -1.02]),
        (claim("relative", -2.0, tolerance=0.1, decimals=1), [-2.2, -1.8], [-2.21, -1.79]),
        (claim("slope", -0.5, tolerance=0.1), [-0.6, -0.4], [-0.61, -0.39]),
    ],
)
@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_tolerance_on_both_sides_of_its_edges(given, values, others, verdict):
    expected = replace(given, verdict=verdict)
    agreeing = verdict != "not replicated"
    assert [judge(expected, value).passed for value in values] == [agreeing] * len(values)
    assert [judge(expected, value).passed for value in others] == [not agreeing] * len(others)


@pytest.mark.parametrize(
    ("band", "agrees"),
    [
        ((0.9, 1.1), True),
        ((1.025, 2.0), True),
        ((1.0251, 2.0), False),
        ((0, 1.015), True),
        ((0, 1.0149), False),
    ],
)
@pytest.mark.parametrize("verdict", VERDICTS)
def test_a_printed_value_meets_the_band_with_its_rounding(band, agrees, verdict):
    judged = judge(claim("monte-carlo-band", verdict=verdict, decimals=2), 1.0, band)
    assert judged.passed == (agrees == (verdict != "not replicated"))
    assert (judged.value, judged.lower, judged.upper) == (1.0, *band)


@pytest.mark.parametrize("verdict", VERDICTS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_verdict_follows_from_a_missing_number(verdict, value):
    for given in (claim("exact"), claim("digits", decimals=2), claim("relative", tolerance=0.1)):
        judged = judge(replace(given, verdict=verdict), value)
        assert not judged.passed
        assert judged.value is None
    assert not judge(claim("monte-carlo-band", verdict=verdict), value, (0.9, 1.1)).passed
    judged = judge(claim("monte-carlo-band", verdict=verdict), 1.0, (math.nan, math.nan))
    assert not judged.passed
    json.dumps(judged.to_json(), allow_nan=False)


def test_a_band_or_a_number_that_is_missing_is_asked_for():
    with pytest.raises(UsageError, match="claim a needs the band"):
        judge(claim("monte-carlo-band"), 1.0)
    with pytest.raises(UsageError, match="claim a prints 'x < 1', which is no number"):
        judge(claim("exact", "x < 1"), 1.0)


def test_a_judged_claim_as_json():
    judged = judge(claim("relative", 2.0, tolerance=0.5, verdict="partial"), 2.5)
    document = json.loads(json.dumps(judged.to_json(), allow_nan=False))
    assert (document["tolerance"]["type"], document["tolerance"]["tolerance"]) == ("relative", 0.5)
    assert document["tolerance"]["lower"] == pytest.approx(1.0)
    assert document["tolerance"]["upper"] == pytest.approx(3.0)
    assert set(document) == {
        "id", "where", "printed", "unit", "value", "verdict", "tolerance", "passed", "note",
    }  # fmt: skip
    assert document["passed"] is True
