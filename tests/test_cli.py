"""The command line: exit codes, one-sentence errors, resumption, complete and repeatable results."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from replications.lacy import paper as lacy
from sysid.cli import main
from sysid.replication import PaperResult

SMALL = ["--runs", "20", "--format", "json", "--jobs", "1", "--backend", "threading"]


def error_of(capsys, *arguments):
    """Return the exit code and the lines on standard error."""
    try:
        code = main(arguments)
    except SystemExit as stop:
        code = stop.code
    lines = capsys.readouterr().err.strip().splitlines()
    return code, lines


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "required"),
        (["nonsense"], "nonsense"),
        (["replicate", "nonsense"], "no paper 'nonsense'; installed are: bai"),
        (["replicate", "--runs", "0"], "0 is too small"),
        (["replicate", "--runs", "9"], "--runs is 9: covariances of the estimates need at least 10 runs"),
        (["replicate", "--runs", "ten"], "'ten' is not a whole number"),
        (["replicate", "--seed", "-1"], "-1 is too small"),
        (["replicate", "--jobs", "0"], "0 is too small"),
        (["replicate", "--format", "docx"], "'docx' is not a format"),
        (["replicate", "--format", ","], "no format is named"),
        (["replicate", "--backend", "mpi"], "invalid choice: 'mpi'"),
        (["replicate", "--scheduler", "tcp://127.0.0.1:1"], "goes with the backend 'dask'"),
        (["replicate", "--case", "relay"], "--case goes with --only-run"),
        (["replicate", "--backend", "dask", "--scheduler", "nonsense"], "no address of a Dask scheduler"),
        (["replicate", "--backend", "dask", "--scheduler", ""], "'' is no address of a Dask scheduler"),
        (["replicate", "--out", "/dev/null/out"], "cannot be written (Not a directory): name a folder"),
        (["replicate", "--case", "nonsense", "--only-run", "3"], "no case is named 'nonsense'"),
        (["compare", "no-such-file.csv", "--period", "1"], "no-such-file.csv"),
    ],
)
def test_bad_use_ends_in_one_sentence(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    code, lines = error_of(capsys, *arguments)
    assert code == 2
    assert len(lines) == 1
    assert words in lines[0]


def test_out_may_not_be_a_file(capsys, tmp_path):
    place = tmp_path / "taken"
    place.write_text("mine")
    code, lines = error_of(capsys, "replicate", "--out", str(place))
    assert (code, len(lines)) == (2, 1)
    assert "is a file: name a folder" in lines[0]
    assert place.read_text() == "mine"


PRINTING = """
import argparse, sys
import sysid.cli as cli

def print_much(arguments):
    if sys.argv[1] == "rich":
        from rich.console import Console
        Console().print("found " * 50_000)
    else:
        print("found " * 50_000)
    return 0

parsed = argparse.Namespace(command="tell", load=lambda: print_much)
cli.build_parser = lambda: argparse.Namespace(parse_args=lambda argv: parsed)
sys.exit(cli.main())
"""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this platform has no full device")
@pytest.mark.parametrize("printer", ["plain", "rich"])
def test_output_that_cannot_be_written_ends_in_one_sentence_or_in_silence(printer):
    def run(redirection):
        shell = ["sh", "-c", f'"$@" {redirection}', "sh", sys.executable, "-c", PRINTING, printer]
        done = subprocess.run(shell, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, check=False)
        return done.returncode, done.stderr.decode()

    assert run(">/dev/full") == (2, "sysid tell: error: No space left on device\n")
    assert run(">&-") == (0, "")
    command = [sys.executable, "-c", PRINTING, printer]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()  # as `head` does when it has seen enough
        error = process.stderr.read()
    assert (process.returncode, error) == (141, b"")


@pytest.mark.parametrize("asked", [True, False])
def test_real_records_are_used_when_asked_for(asked, tmp_path, monkeypatch):
    seen = []

    def replicate(session):
        seen.append(session.with_records)
        return PaperResult([], [], {}, {}, {"rmse": None}, {"rmse": "the record is not at hand"})

    paper = SimpleNamespace(
        id="circuit", title="Circuit", citation="", default_runs=10, smoke_runs=10, plan=lambda runs: {},
        claims_file=lacy.claims_file, notebook=None, replicate=replicate,
    )  # fmt: skip
    monkeypatch.setattr("sysid.commands.replicate.chosen_papers", lambda names: {"circuit": paper})
    command = ["replicate", "circuit", "--out", str(tmp_path), "--format", "json"]
    assert main([*command, *(["--with-records"] if asked else [])]) == 0
    assert seen == [asked]
    found = json.loads((tmp_path / "results.json").read_text())["papers"]["circuit"]
    assert found["numbers"] == {"rmse": None}
    assert found["notes"] == {"rmse": "the record is not at hand"}


def test_ctrl_c_is_one_sentence(capsys, monkeypatch):
    def interrupt(names):
        raise KeyboardInterrupt

    monkeypatch.setattr("sysid.commands.replicate.chosen_papers", interrupt)
    assert main(["replicate"]) == 130
    captured = capsys.readouterr()
    assert captured.err == "sysid replicate: interrupted; the finished runs are kept, --resume goes on\n"


def test_help_has_an_example_and_costs_little():
    for command in ([], ["replicate"], ["compare"]):
        shown = subprocess.run(
            [sys.executable, "-m", "sysid.cli", *command, "--help"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert "example" in shown.stdout
    heavy = ["numpy", "numba", "scipy", "matplotlib", "pandas", "pyarrow", "control", "nbconvert", "rich"]
    script = f"import sys, sysid.cli as c; c.build_parser(); print([m for m in {heavy} if m in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"


def test_dry_run_lists_cases_and_writes_nothing(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["replicate", "bai", "--dry-run", "--runs", "7"]) == 0
    assert "hysteresis-relay-schmitt" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A small replication: 20 runs are too few for every gate, but not for the form of the results."""
    out = tmp_path_factory.mktemp("out")
    code = main(["replicate", "bai", *SMALL, "--out", str(out)])
    return code, out, json.loads((out / "results.json").read_text())


def test_results_have_the_pinned_form(finished):
    code, out, results = finished
    assert results["schema"] == 1
    assert set(results["provenance"]) >= {
        "commit",
        "versions",
        "platform",
        "seed",
        "runs",
        "date",
        "data_hashes",
    }
    bai = results["papers"]["bai"]
    assert set(bai) >= {"claims", "tables", "monte_carlo", "gates", "numbers", "timings"}
    cases = "preload dead-zone saturation relay hysteresis-relay hysteresis "
    cases += "hysteresis-relay-schmitt hysteresis-play"
    for case in cases.split():
        study = bai["monte_carlo"][case]
        assert (study["n_runs"], study["failed"]) == (20, 0)
        assert list(study["parameters"]) == ["a", "alpha1", "alpha2", "beta1", "beta2"]
        for quality in study["parameters"].values():
            names = "true mean bias bias_std_error std rmse q025 q975 crlb_std efficiency"
            assert set(quality) == set(names.split())
        for parameter in study["parameters"]:
            assert -1.5 < bai["numbers"][f"slope/{case}/{parameter}"] < 0
        assert bai["numbers"][f"ej/{case}/100"] > 0
        assert 0 <= bai["numbers"][f"local_minima_share/{case}"] <= 1
        assert (out / "runs" / "bai" / f"{case}.parquet").exists()
    assert "example-2/separable" in bai["monte_carlo"]
    keys = {"id", "where", "printed", "value", "unit", "verdict", "tolerance", "passed", "note"}
    assert all(set(claim) == keys and "type" in claim["tolerance"] for claim in bai["claims"])
    keys = {"id", "value", "lower", "upper", "type", "passed", "reason"}
    assert all(set(gate) >= keys for gate in bai["gates"])
    assert code == (0 if all(gate["passed"] for gate in bai["gates"]) else 1)


def test_numbers_do_not_depend_on_workers_backend_or_resumption(finished, tmp_path):
    _, out, results = finished
    main(["replicate", "bai", "--runs", "20", "--format", "json", "--jobs", "2", "--out", str(tmp_path)])
    again = json.loads((tmp_path / "results.json").read_text())
    main(["replicate", "bai", *SMALL, "--out", str(out), "--resume"])
    resumed = json.loads((out / "results.json").read_text())
    for other in (again, resumed):
        for part in ("monte_carlo", "numbers", "claims", "gates", "tables"):
            assert other["papers"]["bai"][part] == results["papers"]["bai"][part]


def test_resuming_with_another_seed_is_refused(finished, capsys):
    _, out, _ = finished
    code, lines = error_of(capsys, "replicate", "bai", *SMALL, "--out", str(out), "--resume", "--seed", "9")
    assert (code, len(lines)) == (2, 1)
    assert "seed" in lines[0]


def test_one_run_can_be_repeated(finished, capsys):
    import pandas

    _, out, _ = finished
    assert main(["replicate", "bai", "--case", "saturation", "--only-run", "7"]) == 0
    values = json.loads(capsys.readouterr().out)["saturation"]
    row = pandas.read_parquet(out / "runs" / "bai" / "saturation.parquet").iloc[7]
    assert {name: row[name] for name in values} == values


def test_a_red_gate_gives_exit_code_1(tmp_path, monkeypatch, capsys):
    from replications.bai import setting

    monkeypatch.setattr(setting, "EXAMPLE_1_NOISE", 0.5)
    code = main(["replicate", "bai", *SMALL, "--out", str(tmp_path)])
    assert code == 1
    assert "RED bai claims" in capsys.readouterr().out


def test_failed_runs_are_named_with_the_way_to_repeat_them(tmp_path, monkeypatch, capsys):
    from replications.bai.example_1 import Example1

    sound = Example1.__call__

    def failing(task, rng):
        values = sound(task, rng)
        if task.case == "relay" and task.n_samples == 100 and values["a"] > 1:
            raise ArithmeticError("the amplifier caught fire")
        return values

    monkeypatch.setattr(Example1, "__call__", failing)
    code = main(["replicate", "bai", *SMALL, "--out", str(tmp_path)])
    shown = capsys.readouterr()
    assert code == 1
    assert "RED bai failed-runs" in shown.out
    lines = [line for line in shown.err.splitlines() if "caught fire" in line]
    assert 1 <= len(lines) <= 5
    assert "--case relay --only-run" in lines[0]
    study = json.loads((tmp_path / "results.json").read_text())["papers"]["bai"]["monte_carlo"]["relay"]
    assert 0 < study["failed"] < 20
    assert study["parameters"]["a"]["mean"] is not None
