"""The harness of a replication: sessions, provenance, and the results file."""

import json
import math
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from sysid import replication
from sysid.claims import Claim
from sysid.errors import UsageError
from sysid.gates import exact
from sysid.replication import (
    PaperResult,
    Session,
    chosen_papers,
    commit,
    jsonable,
    provenance,
    read_results,
    write_results,
)

RESULTS = {"schema": 1, "provenance": {"seed": 3}, "papers": {}}


# Results file ---------------------------------------------------------------------------------------


def test_numbers_json_does_not_know_become_null():
    value = {
        "float": np.float64(1.5),
        "count": np.int64(3),
        "truth": np.bool_(True),
        "array": np.array([[1.0, np.nan], [np.inf, 2.0]]),
        "tuple": (1, math.nan, {"deep": -math.inf}),
        "scalar": np.float64("nan"),
        7: None,
        "text": "nan",
    }
    expected = {
        "float": 1.5, "count": 3, "truth": True, "array": [[1.0, None], [None, 2.0]],
        "tuple": [1, None, {"deep": None}], "scalar": None, "7": None, "text": "nan",
    }  # fmt: skip
    assert jsonable(value) == expected
    assert json.loads(json.dumps(jsonable(value), allow_nan=False)) == expected
    assert type(jsonable(np.bool_(True))) is bool


def test_floats_survive_the_file_to_the_bit(tmp_path):
    numbers = [0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0, 2.0**53 + 1]
    write_results(tmp_path, RESULTS | {"numbers": np.array(numbers)})
    read = read_results(tmp_path)["numbers"]
    assert np.array(read).tobytes() == np.array(numbers).tobytes()


def test_equal_results_make_equal_files(tmp_path):
    first = write_results(tmp_path, RESULTS).read_bytes()
    assert write_results(tmp_path, RESULTS).read_bytes() == first
    assert first.endswith(b"\n")


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write_results(tmp_path, RESULTS)
    with pytest.raises(TypeError):
        write_results(tmp_path, RESULTS | {"odd": object()})
    assert read_results(tmp_path) == RESULTS
    assert [path.name for path in tmp_path.iterdir()] == ["results.json"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", r"results.json is not JSON \(line 1\): run the replication again"),
        ('{"schema": 2}', "results.json does not have schema 1: run the replication again"),
        ("[1]", "does not have schema 1"),
        ("{}", "does not have schema 1"),
        (b"\xff\xfe", "results.json cannot be read"),
    ],
)
def test_a_file_that_is_no_result_is_named(tmp_path, text, message):
    (tmp_path / "results.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UsageError, match=message):
        read_results(tmp_path)


def test_a_missing_file_says_how_to_make_it(tmp_path):
    with pytest.raises(UsageError, match=r"results.json does not exist: run `sysid replicate --out"):
        read_results(tmp_path)
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(UsageError, match="cannot be read"):
        read_results(file)


# Papers ---------------------------------------------------------------------------------------------


PARTS = dict.fromkeys(replication.PAPER_PARTS)


def test_the_parts_of_a_paper_are_those_of_its_protocol():
    assert set(replication.PAPER_PARTS) == {
        *replication.Paper.__annotations__,
        *(name for name in vars(replication.Paper) if not name.startswith("_")),
    }


def install(monkeypatch, **papers):
    entries = [
        SimpleNamespace(name=name, value=f"{name}:PAPER", load=lambda paper=paper: paper)
        for name, paper in papers.items()
    ]
    monkeypatch.setattr(replication, "entry_points", lambda group: entries if group == "sysid.papers" else [])


def test_papers_are_chosen_by_name(monkeypatch):
    pepona, bai, giri = (SimpleNamespace(**PARTS, number=number) for number in range(3))
    install(monkeypatch, pepona=pepona, bai=bai, giri=giri)
    assert chosen_papers([]) == {"bai": bai, "giri": giri, "pepona": pepona}
    assert list(chosen_papers(["giri", "bai", "giri"])) == ["giri", "bai"]
    with pytest.raises(UsageError, match="there is no paper 'smith'; installed are: bai, giri, pepona"):
        chosen_papers(["bai", "smith"])
    install(monkeypatch)
    assert chosen_papers([]) == {}
    with pytest.raises(UsageError, match="there is no paper 'bai'; installed are: none"):
        chosen_papers(["bai"])


def test_a_paper_that_cannot_be_loaded_is_told_in_one_sentence(monkeypatch):
    class Broken:
        name, value = "broken", "gone:PAPER"

        def load(self):
            raise ModuleNotFoundError("No module\nnamed 'gone'")

    whole = SimpleNamespace(**PARTS)
    entry = SimpleNamespace(name="whole", value="whole:PAPER", load=lambda: whole)
    monkeypatch.setattr(replication, "entry_points", lambda group: [Broken(), entry])
    told = r"'broken' \(gone:PAPER\) cannot be loaded \(ModuleNotFoundError: No module named 'gone'\): repair"
    with pytest.raises(UsageError, match=told):
        chosen_papers([])
    assert chosen_papers(["whole"]) == {"whole": whole}
    install(monkeypatch, half=SimpleNamespace(id="half"))
    with pytest.raises(UsageError, match=r"the paper 'half' \(half:PAPER\) has no 'title'"):
        chosen_papers(["half"])


def test_the_library_does_not_import_the_replications():
    code = "import sysid.replication, sys; print(any(m.split('.')[0] == 'replications' for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"


# Session and result ---------------------------------------------------------------------------------


class RecordingRunner:
    def __init__(self):
        self.calls = []

    def run(self, case, task, runs, seed):
        self.calls.append((case, task, runs, seed))
        return SimpleNamespace(case=case, failed=0)


def test_a_session_hands_its_runs_and_seed_on():
    runner = RecordingRunner()
    session = Session(runs=100, seed=7, smoke=False, runner=runner)
    assert session.study("a", abs).case == "a"
    session.study("b", abs, runs=5)
    session.study("c", abs, runs=0)
    assert runner.calls == [("a", abs, 100, 7), ("b", abs, 5, 7), ("c", abs, 0, 7)]


def test_failed_runs_are_listed_with_their_messages():
    failures = [SimpleNamespace(run=k, message="overflow") for k in (3, 5, 8, 13, 21, 34)]
    study = SimpleNamespace(failed=6, failures=lambda: iter(failures))
    session = Session(50, 0, False, SimpleNamespace(run=lambda *arguments: study))
    session.study("relay", abs)
    assert [(one.case, one.run, one.message) for one in session.failures] == [
        ("relay", k, "overflow") for k in (3, 5, 8, 13, 21)
    ]


def test_times_are_kept_apart():
    session = Session(1, 0, True, RecordingRunner())
    with session.timed("part"):
        pass
    assert list(session.timings) == ["part"]
    assert session.timings["part"] >= 0
    assert Session(1, 0, True, RecordingRunner()).timings == {}


def test_a_result_has_the_fields_of_the_schema():
    claim = Claim("a", "Table 1", 1.0, "a", "", "replicated", {"type": "exact"})
    result = PaperResult([claim], [exact("g", 1, 1, "why")], {"t": []}, {"case": {}}, {"n": math.nan})
    document = json.loads(json.dumps(jsonable(result.to_json({"fit": 0.1})), allow_nan=False))
    assert set(document) == {"claims", "tables", "monte_carlo", "gates", "numbers", "notes", "timings"}
    assert document["claims"][0]["tolerance"] == {"type": "exact", "lower": None, "upper": None}
    assert document["gates"][0]["passed"] is True
    assert document["numbers"] == {"n": None}
    assert document["timings"] == {"fit": 0.1}


# Provenance -----------------------------------------------------------------------------------------


def git(folder, *arguments):
    identity = ["-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", "-C", str(folder), *identity, *arguments], check=True, capture_output=True)


@pytest.fixture
def library(monkeypatch, tmp_path):
    """A folder that plays the part of the installed library."""
    source = tmp_path / "sysid"
    source.mkdir()
    for name in ("__init__.py", "replication.py"):
        (source / name).write_text("")
    module = SimpleNamespace(__file__=str(source / "__init__.py"))
    monkeypatch.setattr(replication, "import_module", lambda name: module)
    return source


@pytest.fixture
def repository(library):
    try:
        git(library.parent, "init", "-q")
    except FileNotFoundError:
        pytest.skip("git is not installed")
    return library


def test_the_commit_of_a_checkout(repository):
    git(repository.parent, "add", ".")
    git(repository.parent, "commit", "-q", "-m", "first")
    clean = commit()
    assert len(clean) == 12
    assert set(clean) <= set("0123456789abcdef")
    git(repository.parent, "tag", "v1")
    assert commit() == clean  # a tag does not hide the commit
    (repository / "replication.py").write_text("changed")
    assert commit() == f"{clean}-dirty"


def test_a_foreign_repository_around_an_installed_wheel_is_not_taken_for_ours(repository):
    (repository.parent / "other.txt").write_text("")
    git(repository.parent, "add", "other.txt")
    git(repository.parent, "commit", "-q", "-m", "not the library")
    assert commit() == "no repository"


def test_an_installed_wheel_has_no_repository(library, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(library.parent.parent))
    assert commit() == "no repository"


def test_commit_without_git(library, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert commit() == "no repository"


def test_provenance_says_what_was_run(library, monkeypatch, tmp_path):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    monkeypatch.setattr(sys, "argv", ["/any/where/sysid", "replicate", "bai"])
    claims = tmp_path / "bai.toml"
    claims.write_bytes(b"abc")
    found = provenance({"bai": SimpleNamespace(claims_file=claims)}, {"bai": 100}, 5)
    assert found["commit"] == "no repository"
    assert found["command"] == "sysid replicate bai"
    assert (found["seed"], found["runs"]) == (5, {"bai": 100})
    # The first test vector of FIPS 180-2.
    assert found["data_hashes"] == {
        "bai.toml": "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    }
    assert {"python", "numpy", "scipy", "numba", "sysid"} <= set(found["versions"])
    assert found["versions"]["numpy"] == np.__version__
    json.dumps(jsonable(found), allow_nan=False)


def test_a_package_that_is_missing_has_no_version():
    assert replication._version("no-such-package-at-all") is None
