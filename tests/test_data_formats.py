"""Parquet, MATLAB and npz files give the record that a CSV of the same data gives."""

import pickle
import zipfile
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

from sysid.cli import main
from sysid.data import read_record
from sysid.errors import DataError, UsageError

ROWS = 60
HOW = {"inputs": ["u", "v"], "split": "set", "experiment": "run"}


def columns():
    rng = np.random.default_rng(2)
    # Few digits: older pandas reads longer ones from text to within the last bit only.
    u, v, y = rng.standard_normal((3, ROWS)).round(4)
    y[55:57] = np.nan
    return {
        "t": np.tile(0.05 * np.arange(ROWS // 2), 2).round(4),
        "u": u,
        "v": np.round(10 * v).astype(np.int32),
        "y": y,
        "set": np.repeat(["train", "test_1"], [40, 20]),
        "run": np.repeat([1, 2], ROWS // 2),
    }


def write_csv(path, table):
    pd.DataFrame(table).to_csv(path, index=False)


def write_parquet(path, table):
    pq.write_table(pa.table(table), path)


def write_npz(path, table):
    with path.open("wb") as stream:
        np.savez(stream, **table)


def write_mat(path, table):
    """Version 5; columns stand upright and texts become a cell array, as from MATLAB."""
    upright = {
        name: value.astype(object) if value.dtype.kind == "U" else value for name, value in table.items()
    }
    savemat(path, upright, appendmat=False, oned_as="column", do_compression=True)


def write_mat_73(path, table, *, cells=False):
    """Write as MATLAB does: dimensions reversed, class in an attribute, 512 bytes of text in front."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in table.items():
            add_73(file, name, value, cells=cells)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def add_73(file, name, value, *, cells=False):
    if value.dtype.kind != "U":
        words = {"int32": "int32", "int64": "int64"}
        file[name] = value.reshape(1, -1)
        file[name].attrs["MATLAB_class"] = np.bytes_(words.get(str(value.dtype), "double"))
        return
    width = max(len(text) for text in value)
    codes = [np.asarray([ord(letter) for letter in text.ljust(width)], dtype=np.uint16) for text in value]
    if not cells:
        file[name] = np.stack(codes, axis=1)
        file[name].attrs["MATLAB_class"] = np.bytes_("char")
        return
    places = []
    for index, code in enumerate(codes):
        cell = file.create_dataset(f"#refs#/{name}{index}", data=code[:, np.newaxis])
        cell.attrs["MATLAB_class"] = np.bytes_("char")
        places.append(cell.ref)
    held = file.create_dataset(name, (1, len(places)), dtype=h5py.ref_dtype)
    held[0, :] = places
    held.attrs["MATLAB_class"] = np.bytes_("cell")


def write_mat_73_cells(path, table):
    write_mat_73(path, table, cells=True)


WRITERS = [
    pytest.param(write_parquet, "pump.parquet", id="parquet"),
    pytest.param(write_npz, "pump.npz", id="npz"),
    pytest.param(write_mat, "pump.mat", id="mat-5"),
    pytest.param(write_mat_73, "pump.mat", id="mat-7.3"),
    pytest.param(write_mat_73_cells, "pump.mat", id="mat-7.3-cells"),
]


@pytest.mark.parametrize(("write", "name"), WRITERS)
def test_each_format_gives_the_record_of_the_csv(tmp_path, write, name):
    write_csv(tmp_path / "pump.csv", columns())
    write(tmp_path / name, columns())
    plain, other = (read_record(tmp_path / file, time="t", **HOW) for file in ("pump.csv", name))
    assert other.sha256 == plain.sha256
    assert (other.name, other.experiments, other.test_sets) == (
        plain.name,
        plain.experiments,
        plain.test_sets,
    )
    assert other.warnings == plain.warnings
    # Restarts of t are seen without being asked for, as in text.
    assert read_record(tmp_path / name, period=0.05, split="set").starts == (0, 30)


@pytest.mark.parametrize(("write", "name"), WRITERS)
def test_the_content_tells_the_format_where_the_name_does_not(tmp_path, write, name):
    write(tmp_path / name, columns())
    other = (tmp_path / name).rename(tmp_path / "pump.measured")
    assert read_record(other, time="t", **HOW).n_samples == ROWS


@pytest.mark.parametrize(("write", "name"), WRITERS)
def test_bad_cells_and_names_are_told_as_for_text(tmp_path, write, name):
    table = columns()
    table["u"][4] = np.inf
    table["long"] = table["u"]
    write(tmp_path / name, table)
    with pytest.raises(DataError, match="row 5, column 'u': the value is inf"):
        read_record(tmp_path / name, time="t", **HOW)
    with pytest.raises(UsageError, match=r"no column 'lomg'; did you mean 'long'\? it has .*\bu, v"):
        read_record(tmp_path / name, inputs=["lomg"], period=1.0)
    with pytest.raises(UsageError, match="sampling period is not known"):
        read_record(tmp_path / name, inputs=["v"], split="set")
    with pytest.raises(DataError, match="row 1, column 'set': 'train' is not a number"):
        read_record(tmp_path / name, inputs=["set"], period=1.0)


@pytest.mark.parametrize(("write", "name"), WRITERS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6, 0.95, 0.999])
def test_truncated_files_are_refused_in_one_sentence(tmp_path, write, name, share):
    path = tmp_path / name
    write(path, columns())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises((DataError, UsageError)) as caught:
        read_record(path, time="t", **HOW)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("write", "name"), WRITERS)
def test_damaged_files_never_end_in_a_traceback(tmp_path, write, name):
    path = tmp_path / name
    write(path, columns())
    content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    rng = np.random.default_rng(0)
    for _ in range(25):
        wrong = content.copy()
        wrong[rng.integers(0, wrong.size, 20)] = rng.integers(0, 256, 20)
        path.write_bytes(wrong.tobytes())
        # What is not found out is no error; anything but these two errors fails the test.
        with suppress(DataError, UsageError):
            read_record(path, time="t", **HOW)


class Trap:
    """Pickled, it writes a file when it is loaded."""

    def __init__(self, place):
        self.place = place

    def __reduce__(self):
        return Path.write_text, (self.place, "executed")


def test_pickled_objects_are_refused_and_not_executed(tmp_path):
    mark = tmp_path / "mark"
    trap = Trap(mark)
    pickle.loads(pickle.dumps(trap))
    assert mark.read_text() == "executed"  # the trap works
    mark.unlink()
    table = columns()
    path = tmp_path / "trap.npz"
    np.savez(path, u=np.asarray([trap] * ROWS, dtype=object), y=table["y"], t=table["t"])
    with pytest.raises(DataError, match="variable 'u' is an array of objects, which is not read"):
        read_record(path, time="t")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("u.npy", pickle.dumps(trap))
    with pytest.raises(DataError, match="cannot be read"):
        read_record(path, time="t")
    path.write_bytes(pickle.dumps(trap))
    with pytest.raises(DataError, match="not an npz file"):
        read_record(path, time="t")
    assert not mark.exists()


@pytest.mark.parametrize("write", [write_npz, write_mat, write_mat_73])
@pytest.mark.parametrize(("name", "value"), [("Ts", 0.05), ("fs", 20.0), ("period", 0.05), ("dt", 0.05)])
def test_scalars_give_the_period(tmp_path, write, name, value):
    path = tmp_path / ("a.npz" if write is write_npz else "a.mat")
    table = columns()
    write(path, {"u": table["u"], "y": table["v"], name: np.asarray([value])})
    assert read_record(path).period == pytest.approx(0.05, rel=1e-12)
    assert read_record(path, period=0.1).period == 0.1
    write(path, {"u": table["u"], "y": table["v"], name: np.asarray([value]), "FS": np.asarray([7.0])})
    with pytest.raises(DataError, match=r"tells a sampling period of 0\.\d+ s and '\w+' one of 0\.\d+ s"):
        read_record(path)
    write(path, {"u": table["u"], "y": table["v"], name: np.asarray([0.0])})
    with pytest.raises(DataError, match=f"{name!r} is 0"):
        read_record(path)


def test_fields_of_a_matlab_structure_are_columns(tmp_path):
    table = columns()
    measured = {"u": table["u"][:, np.newaxis], "y": 1.0 * table["v"][np.newaxis], "info": {"Ts": 0.5}}
    savemat(tmp_path / "old.mat", {"rig": measured})
    with h5py.File(tmp_path / "new.mat", "w") as file:
        file["rig/u"], file["rig/y"], file["rig/info/Ts"] = table["u"], 1.0 * table["v"], 0.5
    old, new = (
        read_record(tmp_path / name, inputs=["rig.u"], outputs=["rig.y"]) for name in ("old.mat", "new.mat")
    )
    assert old.sha256 == new.sha256
    assert old.period == 0.5


def unusable_mat(path):
    table = columns()
    savemat(
        path,
        {
            "u": table["u"],
            "y": table["v"],
            "both": np.stack([table["u"], table["u"]], axis=1),
            "short": table["u"][:50],
            "z": table["u"] * 1j,
            "mixed": np.asarray([1.0, "a"] * 30, dtype=object),
            "many": np.zeros(3, dtype=[("a", float)]),
            "gain": 3.0,
        },
    )


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("both", "variable 'both' has the shape 60 x 2: a column is n x 1, so save each column"),
        ("short", "'short' has 50 values and 'y' has 60: columns of one record must have one length"),
        ("z", "variable 'z' is complex"),
        ("mixed", "variable 'mixed' is a cell array of other things than texts"),
        ("many", "variable 'many' is an array of structures"),
        ("gain", "variable 'gain' is a single value"),
    ],
)
def test_variables_that_are_no_columns_are_named(tmp_path, name, message):
    unusable_mat(tmp_path / "a.mat")
    with pytest.raises(DataError, match=message):
        read_record(tmp_path / "a.mat", inputs=[name], period=1.0)
    assert read_record(tmp_path / "a.mat", period=1.0).n_samples == ROWS


def test_links_to_other_files_are_not_followed(tmp_path):
    table = columns()
    write_mat_73(tmp_path / "other.mat", {"u": table["u"]})
    with h5py.File(tmp_path / "a.mat", "w") as file:
        file["y"], file["u"] = table["u"], h5py.ExternalLink("other.mat", "u")
        file["loop/again"] = h5py.SoftLink("/loop")
    with pytest.raises(DataError, match="variable 'u' is a link to another place"):
        read_record(tmp_path / "a.mat", period=1.0)


def test_parquet_columns_of_other_types(tmp_path):
    table = columns()
    dates = pd.date_range("2020-01-01", periods=ROWS, freq="s")
    written = pd.DataFrame({**table, "when": dates, "motor.u": table["u"], "wrong": [[1.0]] * ROWS})
    written["set"] = written["set"].astype("category")
    written.to_parquet(tmp_path / "a.parquet")
    record = read_record(tmp_path / "a.parquet", inputs=["motor.u"], time="t", split="set")
    np.testing.assert_array_equal(record.u[:, 0], table["u"])
    for name, message in (("when", "'when' holds dates"), ("wrong", r"'wrong' is of type list")):
        with pytest.raises(DataError, match=message):
            read_record(tmp_path / "a.parquet", inputs=[name], period=1.0)


def test_files_without_columns_and_other_archives(tmp_path):
    np.savez(tmp_path / "a.npz", gain=3.0)
    with pytest.raises(DataError, match=r"a\.npz holds no column \(gain\)"):
        read_record(tmp_path / "a.npz", period=1.0)
    with zipfile.ZipFile(tmp_path / "book.xlsx", "w") as archive:
        archive.writestr("sheet.xml", "<a/>")
    with pytest.raises(DataError, match="not a text table"):
        read_record(tmp_path / "book.xlsx", period=1.0)
    for name in ("none.mat", "none.npz", "none.parquet"):
        with pytest.raises(DataError, match="there is no file"):
            read_record(tmp_path / name, period=1.0)


def test_the_command_reads_them(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("bad.npz").write_bytes(b"PK")
    assert main(["compare", "bad.npz"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "bad.npz is not an npz file" in line


@pytest.mark.parametrize("units", ["s,V,rad/s,", "[s],[V],[rad/s],-", '"s","V","rad/s","set"'])
def test_a_row_of_units_below_the_header_is_read_as_such(tmp_path, units):
    path = tmp_path / "bench.csv"
    rows = "".join(f"{0.1 * k:.1f},{k % 3},{k % 5},train\n" for k in range(40))
    path.write_text(f"time,u,y,set\n{units}\n{rows}")
    record = read_record(path, time="time", split="set")
    assert (record.period, len(record.y)) == (pytest.approx(0.1), 40)
    assert (record.unit("u"), record.unit("y")) == ("V", "rad/s")


def test_a_first_row_without_measurements_is_no_row_of_units(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("set,u,y\ntrain,,\n" + "".join(f"train,{k % 3},{k % 5}\n" for k in range(40)))
    with pytest.raises(DataError, match="row 1"):
        read_record(path, period=0.1, split="set")


def test_times_may_be_dates(tmp_path):
    path = tmp_path / "historian.csv"
    rows = "".join(f"2024-02-29 23:59:{k:02d}.250,{k % 3},{k % 5}\n" for k in range(40))
    path.write_text("stamp,u,y\n" + rows)
    record = read_record(path, time="stamp")
    assert (record.period, len(record.y)) == (1.0, 40)
    path.write_text("stamp,u,y\nyesterday,1,2\n" + rows)
    with pytest.raises(DataError, match="row 1, column 'stamp': 'yesterday' is not a number"):
        read_record(path, time="stamp")
