"""Reading and checking measurements."""

import gzip
import json
import os
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from sysid.data import Record, make_record, read_record
from sysid.errors import DataError, UsageError

ROWS = 60


def signals(n=ROWS, seed=1):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(n), rng.standard_normal(n)


def write(path, header, rows, separator=",", before="", encoding="utf-8", decimal="."):
    lines = [separator.join(str(cell).replace(".", decimal) for cell in row) for row in rows]
    path.write_text(before + separator.join(header) + "\n" + "\n".join(lines) + "\n", encoding=encoding)
    return path


def table(tmp_path, name="pump.csv", change=None, **how):
    u, y = signals()
    rows = [[k, 0.1 * k, f"{u[k]:.6f}", f"{y[k]:.6f}", "train" if k < 40 else "test"] for k in range(ROWS)]
    if change:
        change(rows)
    return write(tmp_path / name, ["k", "t", "u", "y", "set"], rows, **how)


def test_columns_are_chosen_by_name_and_arrays_are_read_only(tmp_path):
    record = read_record(table(tmp_path), period=0.1, split="set")
    u, y = signals()
    np.testing.assert_allclose(record.u[:, 0], u, atol=5e-7)  # written with six decimals
    np.testing.assert_allclose(record.y[:, 0], y, atol=5e-7)
    assert record.name == "pump"
    assert record.test_sets == ("test",)
    for array in (record.u, record.y, record.split, record.held_out, record.estimation):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]


@pytest.mark.parametrize("separator", [",", ";", "\t", "|", " "])
@pytest.mark.parametrize("before", ["", "# made on a Monday\n# by hand\n", "% comment\n\n"])
def test_separator_and_comments_are_detected(tmp_path, separator, before):
    plain = read_record(table(tmp_path), period=0.1, split="set")
    other = read_record(table(tmp_path, "b.csv", separator=separator, before=before), period=0.1, split="set")
    assert other.sha256 == plain.sha256


@pytest.mark.parametrize("separator", [";", "\t", " "])
def test_decimal_comma_is_detected(tmp_path, separator):
    plain = read_record(table(tmp_path), period=0.1, split="set")
    comma = read_record(table(tmp_path, "c.csv", separator=separator, decimal=","), period=0.1, split="set")
    assert comma.sha256 == plain.sha256


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_byte_order_marks_and_encodings(tmp_path, encoding):
    u, y = signals()
    path = tmp_path / "d.csv"
    write(path, ["u [°C]", "y"], zip(u, y, strict=True), encoding=encoding)
    record = read_record(path, inputs=["u [°C]"], period=1.0)
    assert record.n_samples == ROWS


def test_compressed_file_and_content_hash(tmp_path):
    path = table(tmp_path)
    packed = tmp_path / "pump.csv.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    plain, small = (read_record(p, period=0.1, split="set") for p in (path, packed))
    assert small.name == "pump"
    assert small.sha256 == plain.sha256
    assert read_record(path, period=0.2, split="set").sha256 != plain.sha256


def test_neighbouring_json_gives_units_period_and_skip(tmp_path):
    path = table(tmp_path)
    notes = {
        "units": {"u": "V (pump)", "y": "m"},
        "Ts": 0.1,
        "splits": {"test": {"skip": 7}, "gone": {"skip": 1}},
    }
    path.with_suffix(".json").write_text(json.dumps(notes))
    record = read_record(path, split="set")
    assert (record.period, record.unit("u"), record.unit("y"), dict(record.skip)) == (
        0.1,
        "V",
        "m",
        {"test": 7},
    )
    assert int(record.scored_rows("test").sum()) == 13
    assert dict(read_record(path, split="set", skip=3).skip) == {"test": 3}
    path.with_suffix(".json").write_text("not json")
    assert read_record(path, split="set", period=1.0).unit("u") == ""


@pytest.mark.parametrize(
    ("notes", "warning"),
    [
        ("{", "is not readable JSON"),
        ("[" * 100_000, "is not readable JSON"),
        ("[]", "holds no JSON object"),
        ('{"Ts": "0.1"}', r"'Ts' is no positive number of seconds \("),
        ('{"Ts": true}', r"'Ts' is no positive number of seconds \(true\)"),
        ('{"Ts": -1}', "'Ts' is no positive number"),
        ('{"Ts": 1' + "0" * 400 + "}", "'Ts' is no positive number"),
        ('{"units": {"u": null}}', "the unit of 'u' is no text"),
        ('{"units": 5}', "'units' is no JSON object"),
        ('{"splits": {"test": {"skip": true}}}', "'skip' of the set 'test' is no whole number"),
    ],
)
def test_notes_that_cannot_be_used_are_told(tmp_path, notes, warning):
    path = table(tmp_path)
    path.with_suffix(".json").write_text(notes)
    record = read_record(path, period=0.1, split="set")
    assert re.search(warning, record.warnings[0])
    assert (dict(record.units), dict(record.skip)) == ({}, {})
    with pytest.raises(UsageError, match=rf"period is not known \(pump.json beside the table.*{warning}"):
        read_record(path, split="set")


def test_notes_that_skip_a_whole_set_are_refused(tmp_path):
    path = table(tmp_path)
    path.with_suffix(".json").write_text('{"Ts": 0.1, "splits": {"test": {"skip": 20}}}')
    with pytest.raises(DataError, match=r"notes in pump.json skip 20 rows of the set 'test', which has 20"):
        read_record(path, split="set")


def test_names_that_are_not_asked_for_do_not_matter(tmp_path):
    path = tmp_path / "wide.csv"
    rows = "".join(f'{k % 3},{k % 5},x,y,noon {k:02d}, "a, b",\n' for k in range(40))
    path.write_text('"u, V",y,note,note,t,,\n' + rows)
    record = read_record(path, inputs=["u, V"], period=1.0)
    assert record.u[:4, 0].tolist() == [0, 1, 2, 0]
    assert "'t' does not hold numbers" in record.warnings[0]


def test_last_quarter_of_each_experiment_is_held_out():
    u, y = signals(200)
    record = make_record(u, y, 1.0, experiment=np.repeat(["a", "b"], 100))
    assert record.starts == (0, 100)
    np.testing.assert_array_equal(np.flatnonzero(record.validation), [*range(75, 100), *range(175, 200)])
    np.testing.assert_array_equal(record.learning, record.estimation | record.validation)
    marked = make_record(u, y, 1.0, split=np.repeat(["est", "val", "test_a", "test_b"], 50))
    np.testing.assert_array_equal(np.flatnonzero(marked.validation), np.arange(50, 100))
    assert marked.test_sets == ("test_a", "test_b")
    assert marked.estimation_label == "est"


def test_test_rows_may_lack_the_output():
    u, y = signals()
    split = np.where(np.arange(ROWS) < 40, "train", "test")
    y[50:] = np.nan
    record = make_record(u, y, 1.0, split=split)
    assert int(record.scored_rows("test").sum()) == 10
    y[10] = np.nan
    with pytest.raises(DataError, match=r"row 11, column 'y' \(and 0 more\)|row 11, column 'y': .*missing"):
        make_record(u, y, 1.0, split=split)


def test_time_gives_period_and_restarts_make_experiments(tmp_path):
    u, y = signals()
    times = np.tile(0.05 * np.arange(30), 2)
    path = write(tmp_path / "e.csv", ["t", "u", "y"], zip(times.round(4), u, y, strict=True))
    timed = read_record(path, time="t")
    assert timed.period == pytest.approx(0.05, rel=1e-9)
    assert timed.starts == (0, 30)
    # The column t also tells where experiments restart when a period is given.
    assert read_record(path, period=0.05).starts == (0, 30)
    with pytest.raises(DataError, match=r"stated period is 0\.1 s"):
        read_record(path, time="t", period=0.1)


def change_cell(row, column, value):
    def change(rows):
        rows[row][column] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (change_cell(4, 2, "abc"), r"row 5, column 'u': 'abc' is not a number"),
        (change_cell(4, 2, "inf"), r"row 5, column 'u': the value is inf"),
        (change_cell(4, 3, "-inf"), r"row 5, column 'y': the value is -inf"),
        (change_cell(4, 2, "nan"), r"row 5, column 'u': the value is missing \(NaN\)"),
        (change_cell(4, 2, ""), r"row 5, column 'u': the value is missing"),
        (change_cell(45, 2, ""), r"row 46, column 'u': the value is missing"),
        (change_cell(4, 3, ""), r"row 5, column 'y': the value is missing .* only the output of test rows"),
        (change_cell(4, 4, "training"), r"row 5: split value 'training' is not known"),
        (change_cell(7, 1, 0.75), r"row 8: the time step in 't' is 0.15 s where the others are 0.1 s"),
        (change_cell(7, 1, 0.55), r"row 8: the time 0.55 does not come after 0.6"),
        (change_cell(7, 1, ""), r"pump.csv, row 8: the time is missing"),
        (change_cell(45, 2, "1e300"), r"row 46, column 'u': the value is 1e\+300, beyond 1e\+100"),
    ],
)
def test_bad_cells_are_named(tmp_path, change, message):
    with pytest.raises(DataError, match=message) as caught:
        read_record(table(tmp_path, change=change), time="t", split="set")
    assert "\n" not in str(caught.value)


def test_bad_use_is_told_in_one_sentence(tmp_path):
    path = table(tmp_path)
    with pytest.raises(UsageError, match=r"no column 'sett'; did you mean 'set'\? it has k, t, u, y, set"):
        read_record(path, period=1.0, split="sett")
    with pytest.raises(UsageError, match="no column 'force': it has k, t, u, y, set"):
        read_record(path, period=1.0, inputs=["force"])
    with pytest.raises(UsageError, match="no column 'U'; did you mean 'u'"):
        read_record(path, period=1.0, inputs=["U"])
    with pytest.raises(UsageError, match="column 'u' is given 2 times as input"):
        read_record(path, period=1.0, inputs=["u", "u"])
    with pytest.raises(UsageError, match="column 'u' is both input and output"):
        read_record(path, period=1.0, outputs=["u"])
    with pytest.raises(UsageError, match="sampling period is not known"):
        read_record(path)
    with pytest.raises(DataError, match="there is no file"):
        read_record(tmp_path / "none.csv", period=1.0)
    with pytest.raises(DataError, match="is a folder"):
        read_record(tmp_path, period=1.0)
    for period in (0.0, -1.0, float("nan")):
        with pytest.raises(DataError, match="give a positive number of seconds"):
            read_record(path, period=period)
    with pytest.raises(DataError, match="skip is 20 for the set 'test', which has 20 rows"):
        read_record(path, period=1.0, split="set", skip=20)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"# only a comment\n", "is empty"),
        (b"u,y\n", "has a header and no rows"),
        (b"u,u,y\n1,2,3\n", "2 columns named 'u'"),
        (b"PK\x03\x04\0\0", "not a text table"),
        (b"\x90\x02\x07u,y\n", "not a text table"),
        (gzip.compress(b"u,y\n1,2\n", mtime=0)[:-9], "give a whole, readable file"),
        (b"u,y\n1,2,3,4\n" * 2, r"bad.csv, row 1: there are more cells than the 2 columns of the header"),
        (b"u,y\n1,2\n1,000,2\n", r"bad.csv, row 2: there are more cells than the 2 columns of the header"),
        (b"u,y\n1,2\n1,2,3,4,5\n", r"bad.csv, line 3: there are more cells than the 2 columns"),
        (b'u,y\n"1,2\n3,4\n', "cannot be read as a table"),
        (b"\x1f\x8bnot gzip", "cannot be read"),
    ],
)
def test_unusable_files(tmp_path, content, message):
    path = tmp_path / "bad.csv"
    path.write_bytes(content)
    with pytest.raises(DataError, match=message):
        read_record(path, period=1.0)


def test_records_without_information_are_refused():
    u, y = signals()
    with pytest.raises(DataError, match="input 'u' is constant"):
        make_record(np.ones(ROWS), y, 1.0)
    with pytest.raises(DataError, match="output 'y' is constant"):
        make_record(u, np.zeros(ROWS), 1.0)
    with pytest.raises(DataError, match="10 rows are marked for estimation"):
        make_record(u, y, 1.0, split=["train"] * 10 + ["test"] * 50)
    with pytest.raises(DataError, match="0 rows are marked for estimation"):
        make_record(u, y, 1.0, split=["test"] * ROWS)
    with pytest.raises(DataError, match="1 row is marked val, at least 5 are needed"):
        make_record(u, y, 1.0, split=["train"] * 59 + ["val"])
    with pytest.raises(DataError, match="output 'y' moves by 4e-300 only"):
        make_record(u, np.arange(ROWS) % 5 * 1e-300, 1.0)
    with pytest.raises(DataError, match="experiment 'a' comes back at row 41"):
        make_record(u, y, 1.0, experiment=np.repeat(["a", "b", "a"], 20))
    with pytest.raises(DataError, match="u has 60 rows, y has 59"):
        make_record(u, y[1:], 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"u": ["a"] * ROWS}, "u is no array of real numbers"),
        ({"y": 1j * np.ones(ROWS)}, r"y is no array of real numbers \(complex numbers\)"),
        ({"u": [[1], [2, 3]]}, "u is no array of real numbers"),
        ({"u": 1.0}, r"u has shape \(\): give"),
        ({"u": np.zeros((ROWS, 0))}, r"u has shape \(60, 0\): give"),
        ({"u": np.ma.masked_array(np.arange(ROWS), np.arange(ROWS) == 7)}, "row 8, column 'u': .* missing"),
        ({"period": "x"}, "the sampling period is 'x'"),
        ({"period": None}, "the sampling period is None"),
        ({"split": np.full((ROWS, 1), "train")}, "split has 2 dimensions"),
        ({"experiment": [1, 2]}, r"experiment has shape \(2,\): give one value for each of 60 rows"),
        ({"experiment": np.zeros((ROWS, 2))}, "experiment has shape"),
        ({"split": ["train"] * 40 + ["test"] * 20, "skip": 1.5}, "skip is 1.5: give a whole number"),
        (
            {"split": ["train"] * 40 + ["test"] * 20, "skip": {"test": "1"}},
            "skip is '1': give a whole number",
        ),
        ({"inputs": ["a"], "outputs": ["a"]}, "the names a, a are not all different"),
    ],
)
def test_bad_arrays_are_told_and_left_alone(change, message):
    u, y = signals()
    arguments = {"u": u, "y": y, "period": 1.0} | change
    with pytest.raises(DataError, match=message):
        make_record(**arguments)
    assert np.array_equal(u, signals()[0])
    assert np.array_equal(y, signals()[1])


def test_a_name_may_stand_alone_and_must_stand_somewhere(tmp_path):
    path = table(tmp_path)
    assert read_record(path, inputs="u", outputs="y", period=1.0).inputs == ("u",)
    with pytest.raises(UsageError, match="no output column is named"):
        read_record(path, outputs=(), period=1.0)
    with pytest.raises(UsageError, match=r"decimal is '\.\.': give a single sign"):
        read_record(path, decimal="..", period=1.0)


def test_a_record_survives_the_way_to_a_worker(tmp_path):
    record = make_record(*signals(), 0.5, units={"u": "V"}, split=["train"] * 40 + ["test"] * 20, skip=3)
    copy = pickle.loads(pickle.dumps(record))
    assert copy.sha256 == record.sha256
    assert (dict(copy.units), dict(copy.skip)) == ({"u": "V"}, {"test": 3})
    assert not copy.u.flags.writeable
    with pytest.raises(TypeError):
        copy.units["u"] = "A"


def test_clipping_is_seen_and_ordinary_signals_are_not():
    rng = np.random.default_rng(3)
    smooth = np.convolve(rng.standard_normal(3000), np.ones(20) / 4.0, mode="valid")
    u = rng.standard_normal(smooth.size)
    clipped = make_record(u, np.minimum(smooth, 1.2), 1.0)
    assert any("rests at its maximum 1.2" in warning for warning in clipped.warnings)
    quantised_sine = np.round(100.0 * np.sin(0.01 * np.arange(smooth.size)))
    steps = np.repeat(rng.integers(0, 5, 150), 20)[: smooth.size]
    for fine in (smooth, quantised_sine, np.round(smooth, 1), steps + 0.0, np.sign(u)):
        assert not any("rests at" in warning for warning in make_record(u, fine, 1.0).warnings)


def test_outliers_are_seen_and_steps_are_not():
    rng = np.random.default_rng(4)
    u = rng.standard_normal(3000)
    slow = np.convolve(rng.standard_normal(3400), 0.99 ** np.arange(401), mode="valid")
    y = 0.01 * slow + 0.01 * rng.standard_normal(3000)
    spiked = y.copy()
    spiked[[500, 1500]] += [2.0, -3.0]
    (warning,) = make_record(u, spiked, 1.0).warnings
    assert "2 outliers in 'y', the largest at row 1501" in warning
    stepped = y + (np.arange(3000) > 1000) * 5.0
    assert make_record(u, stepped, 1.0).warnings == ()


def test_false_alarms_of_the_checks_are_rare():
    rng = np.random.default_rng(5)
    alarms = 0
    for _ in range(200):
        y = np.convolve(rng.standard_normal(1100), 0.9 ** np.arange(100), mode="valid")
        alarms += bool(make_record(rng.standard_normal(y.size), y, 1.0).warnings)
    assert alarms <= 1  # a Gaussian record has none in practice


def test_what_is_no_record_or_no_name_is_told():
    u, y = signals()
    for change, message in [
        ({"units": {"u": 3}}, "give a mapping from column to unit"),
        ({"units": ["V"]}, "give a mapping from column to unit"),
        ({"inputs": [1]}, "a column is named 1"),
        ({"outputs": [" "]}, "a column is named ' '"),
    ]:
        with pytest.raises(UsageError, match=message):
            make_record(u, y, 0.1, **change)


def test_multichannel_names_and_repr():
    rng = np.random.default_rng(0)
    record = make_record(rng.standard_normal((50, 2)), rng.standard_normal((50, 1)), 0.5)
    assert record.inputs == ("u1", "u2")
    assert isinstance(record, Record)
    assert "50 rows at 0.5 s, u1, u2 -> y" in repr(record)


@pytest.mark.skipif("SYSID_DATA" not in os.environ, reason="SYSID_DATA names no folder of real records")
@pytest.mark.parametrize(
    ("name", "rows", "tests", "skip"),
    [
        ("emps", 49682, ("test",), 20),
        ("cascaded_tanks", 2048, ("test",), 50),
        ("hair_dryer", 1000, ("test",), 0),
        ("silverbox", 127225, ("test_arrow", "test_multisine"), 50),
        ("wiener_hammerstein", 178800, ("test",), 50),
    ],
)
def test_real_records_are_read_with_their_notes(name, rows, tests, skip):
    folder = Path(os.environ["SYSID_DATA"]) / name
    (path,) = folder.glob(f"{name}.csv*")
    record = read_record(path, split="split", experiment="experiment")
    assert (record.n_samples, record.test_sets, record.skip[tests[0]]) == (rows, tests, skip)
