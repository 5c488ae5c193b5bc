"""The registry of public records: what it says, and how records are fetched and checked."""

import dataclasses
import hashlib
import json
import socket
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pandas as pd
import pytest

from sysid.cli import main
from sysid.data import read_record, registry
from sysid.data.fetching import fetch
from sysid.data.registry import Benchmark, benchmarks, local_table
from sysid.errors import DataError, UsageError

ROWS = 200


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """A registered record, and the folder of records that holds it; nothing of the user's is touched."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.delenv("SYSID_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    u, y = np.random.default_rng(0).standard_normal((2, ROWS))
    split = np.repeat(["train", "test"], ROWS // 2)
    table = pd.DataFrame(
        {"experiment": split, "split": split, "u": u, "y": np.convolve(u, [0, 1, 0.5])[:ROWS]}
    )
    table["y"] += 0.1 * y
    place = tmp_path / "records" / "rig"
    place.mkdir(parents=True)
    table.to_csv(place / "rig.csv", index=False)
    record = Benchmark(
        name="rig",
        title="A rig [tested]",
        citation="Nobody, 1999",
        period=0.25,
        rows=ROWS,
        file="rig.csv",
        sha256=hashlib.sha256((place / "rig.csv").read_bytes()).hexdigest(),
        units={"u": "V (drive)", "y": "m"},
        sets={"train": (ROWS // 2, 0), "test": (ROWS // 2, 5)},
    )
    register(monkeypatch, record)
    return record


def register(monkeypatch, record):
    known = {**registry.benchmarks(), record.name: record}
    monkeypatch.setattr(registry, "benchmarks", lambda: known)


@pytest.fixture
def server(tmp_path):
    """Address of the records, served on this machine."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *arguments):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=tmp_path / "records")) as running:
        thread = threading.Thread(target=running.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{running.server_port}"
        running.shutdown()
        thread.join()


def test_every_entry_is_complete_enough_to_cite():
    for name, record in benchmarks().items():
        assert record.title, name
        assert record.citation, name
        assert bool(record.file) == bool(record.sha256) == bool(record.rows)
        assert record.rows is None or record.rows == sum(rows for rows, _ in record.sets.values())
        assert all(scores.source and scores.unit and scores.values for scores in record.published)
    assert {"emps", "cascaded_tanks", "silverbox", "wiener_hammerstein", "hair_dryer"} <= set(benchmarks())


def test_registry_agrees_with_the_records_at_hand(records):
    checked = 0
    for name, record in benchmarks().items():
        table = registry.table_in(records, name)
        if table is None:
            continue
        notes = json.loads((records / name / f"{name}.json").read_text())
        own = record.notes()
        for key in ("title", "file", "rows", "Ts", "units", "citation", "sha256", "splits"):
            assert own[key] == notes[key], (name, key)
        assert hashlib.sha256(table.read_bytes()).hexdigest() == record.sha256
        checked += 1
    assert checked >= 5


def test_a_copy_is_fetched_from_a_folder_and_read_by_name(rig, tmp_path):
    with pytest.raises(DataError, match="'rig' is registered and not at hand: `sysid data fetch rig`"):
        read_record("rig")
    fetched = fetch("rig", source=str(tmp_path / "records"))
    assert fetched.path == tmp_path / "cache" / "sysid" / "data" / "rig" / "rig.csv"
    assert fetched.checked
    record = read_record("rig")  # period, units and skip come with it
    assert (record.n_samples, record.period, record.unit("u"), record.skip["test"]) == (ROWS, 0.25, "V", 5)
    assert record.experiments == ("train", "test")
    # A folder of this name is no file; a file is.
    (tmp_path / "rig").mkdir()
    assert read_record("rig").n_samples == ROWS
    (tmp_path / "rig").rmdir()
    (tmp_path / "rig").write_text("a;b\n")
    with pytest.raises(UsageError, match="no column 'u'"):
        read_record("rig")


def test_the_named_folder_comes_before_the_cache(rig, tmp_path, monkeypatch):
    fetch("rig", source=str(tmp_path / "records"))
    monkeypatch.setenv("SYSID_DATA", str(tmp_path / "records"))
    assert local_table("rig") == tmp_path / "records" / "rig" / "rig.csv"
    again = fetch("rig", folder=tmp_path / "mine")
    assert again.path == tmp_path / "mine" / "rig" / "rig.csv"
    assert fetch("rig", folder=tmp_path / "records").checked  # onto itself: only checked


def test_a_changed_copy_is_refused(rig, tmp_path):
    table = tmp_path / "records" / "rig" / "rig.csv"
    table.write_text(table.read_text() + "test,test,1,1\n")
    with pytest.raises(DataError, match=f"and not {rig.sha256} as registered"):
        fetch("rig", source=str(tmp_path / "records"))
    assert local_table("rig") is None


def test_a_mirror_is_checked(rig, tmp_path, server):
    fetched = fetch("rig", source=server)
    assert fetched.sha256 == rig.sha256
    assert read_record("rig").period == 0.25
    (tmp_path / "records" / "rig" / "rig.csv").write_text("u,y\n1,2\n")
    with pytest.raises(DataError, match="is not the registered file") as caught:
        fetch("rig", source=server, folder=tmp_path / "other")
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "other" / "rig" / "rig.csv").exists()
    with pytest.raises(DataError, match=r"cannot be reached \(HTTP 404\)"):
        fetch("rig", source=f"{server}/nowhere", folder=tmp_path / "other")


def test_an_address_nobody_answers_is_told(rig, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(
        DataError, match=r"cannot be reached .* name a folder or mirror with --from"
    ) as caught:
        fetch("rig", source=f"http://127.0.0.1:{port}")
    assert "\n" not in str(caught.value)


def test_an_original_is_downloaded_as_it_is(rig, tmp_path, server, monkeypatch):
    (tmp_path / "records" / "rig.mat").write_bytes(b"original")
    register(
        monkeypatch,
        dataclasses.replace(rig, address=f"{server}/rig.mat", original="variables u and y", sha256=""),
    )
    fetched = fetch("rig")
    assert fetched.path.read_bytes() == b"original"
    assert not fetched.checked
    assert "variables u and y" in fetched.remark


def test_bad_use_is_told(rig, tmp_path):
    with pytest.raises(UsageError, match=r"no record is registered as 'rigg'; did you mean 'rig'\?"):
        fetch("rigg")
    with pytest.raises(UsageError, match="no direct address of 'rig' is known"):
        fetch("rig")
    with pytest.raises(UsageError, match=r"holds no rig/rig\.csv"):
        fetch("rig", source=str(tmp_path))
    for source in ("http://", "http://[", "http://127.0.0.1:nonsense"):
        with pytest.raises(DataError, match=r"cannot be reached|is no address"):
            fetch("rig", source=source)
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(OSError, match="taken"):
        fetch("rig", source=str(tmp_path / "records"), folder=tmp_path / "taken")
    with pytest.raises(UsageError, match="no mirror can have it"):
        fetch("bouc_wen", source="http://127.0.0.1:1")


def test_the_commands(rig, tmp_path, capsys, monkeypatch):
    assert main(["data", "fetch", "rig", "--from", "records", "--to", "mine"]) == 0
    shown = capsys.readouterr().out
    assert str(tmp_path / "mine" / "rig" / "rig.csv") not in shown  # told as it was asked for
    assert "mine/rig/rig.csv" in shown
    assert f"SHA-256 {rig.sha256}, as registered" in shown
    monkeypatch.setenv("SYSID_DATA", "mine")
    notes = tmp_path / "mine" / "rig" / "rig.json"
    notes.write_text(json.dumps({**json.loads(notes.read_text()), "mass": 3.5}))
    assert main(["data", "info", "rig"]) == 0
    shown = capsys.readouterr().out
    for words in (
        "A rig [tested]",
        "Nobody, 1999",
        "unit of u: V (drive)",
        "set test: 100 rows, 5 skipped",
        "mass: 3.5",
    ):
        assert words in shown
    assert main(["data", "list"]) == 0
    assert "emps" in capsys.readouterr().out
    assert main(["data", "info", "nonsense"]) == 2
    assert "no record is registered as 'nonsense'" in capsys.readouterr().err
    for action in ("list", "info", "fetch"):
        with pytest.raises(SystemExit):
            main(["data", action, "--help"])
        assert "example: sysid data" in capsys.readouterr().out


def test_published_scores_are_shown(capsys, monkeypatch, tmp_path):
    monkeypatch.delenv("SYSID_DATA", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert main(["data", "info", "emps"]) == 0
    shown = capsys.readouterr().out
    assert "LSTM: 0.0741" in shown
    assert "at hand: no; `sysid data fetch emps`" in shown


def test_compare_takes_a_registered_name(rig, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SYSID_DATA", "records")
    (tmp_path / "records" / "rig" / "rig.json").write_text(json.dumps(rig.notes()))
    assert main(["compare", "rig", "--order", "2"]) == 0
    assert "skip 5" in capsys.readouterr().out
