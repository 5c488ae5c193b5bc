"""The command `sysid fit`: what it says, writes and refuses; and what a new structure needs."""

import contextlib
import csv
import io
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sysid.cli import main
from sysid.commands import fit_structures
from sysid.commands.fit_structures import LFT, Structure, find_structure, lag_list
from sysid.data import make_record
from sysid.diagnosis.models.lft import fit_lft_structure
from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.lft import LftFit, fit_lft, load, save
from sysid.lft.choice import choose_lft, likely_delay

ROWS = 500
EMPTY = 2  # rows without values at the end of the file
GIVEN = ["--a-order", "1", "--g-order", "1", "--input-lags", "1,2", "--knots", "9", "--starts", "2"]
NASTY = "y<script>alert(1)</script>"


def measured(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    u, y, w = rng.uniform(-2.0, 2.0, ROWS), np.zeros(ROWS), np.zeros(ROWS)
    for k in range(2, ROWS):
        w[k] = np.tanh(0.8 * u[k - 1] + 0.6 * u[k - 2])
        y[k] = 0.7 * y[k - 1] + w[k] + 0.4 * w[k - 1] + 0.02 * rng.standard_normal()
    return u, y


def write_csv(path: Path, output: str = "y") -> Path:
    u, y = measured()
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["u", output, "set"])
        for k in range(ROWS):
            writer.writerow([repr(float(u[k])), repr(float(y[k])), "train" if k < 350 else "test"])
        file.write(",,\n" * EMPTY)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with everything that one call writes."""
    place = tmp_path_factory.mktemp("fit")
    data = write_csv(place / "data.csv", NASTY)
    results = [f"--{name}={place / file}" for name, file in (
        ("json", "fit.json"), ("html", "fit.html"), ("pdf", "fit.pdf"),
        ("save", "model.json"), ("predictions", "fit.csv"))]  # fmt: skip
    given = ["--output", NASTY, "--period", "0.1", "--split-column", "set", *GIVEN]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        code = main(["fit", str(data), *given, *results])
    (place / "said.txt").write_text(said.getvalue())
    assert code == 0
    return place


def test_json_holds_parameters_scores_and_the_map(folder: Path) -> None:
    found = json.loads((folder / "fit.json").read_text())
    parameters = found["model"]["parameters"]
    for name, truth in {"a1": -0.7, "g1": 0.4, "d1": 0.8, "d2": 0.6}.items():
        value, error = parameters[name]["value"], parameters[name]["std_error"]
        assert abs(value - truth) < 5.0 * error + 0.005  # the spline misses tanh by a little
    assert set(found["scores"]) == {"train", "validation", "test"}
    test = found["scores"]["test"]
    assert test["one_step"]["rmse"] < test["rmse"] < 0.06
    shown = found["model"]["map"]
    inner = slice(20, 180)
    assert np.all(np.array(shown["lower"])[inner] < np.array(shown["upper"])[inner])
    np.testing.assert_allclose(np.array(shown["centre"])[inner], np.tanh(shown["value"])[inner], atol=0.05)
    assert sum(shown["density"]) * (shown["value"][1] - shown["value"][0]) == pytest.approx(1.0, abs=0.03)


def test_saved_model_runs_as_the_predictions_say(folder: Path) -> None:
    model = load(folder / "model.json")
    record = make_record(*measured(), period=0.1)
    with (folder / "fit.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["k"]) for row in rows] == list(range(ROWS + EMPTY))
    assert rows[-1] == {"k": str(ROWS + EMPTY - 1), "measured": "", "one_step": "", "free_run": ""}
    rows = rows[:ROWS]
    free_run = np.array([float(row["free_run"]) for row in rows])
    np.testing.assert_allclose(model.simulate((record.u, record.y[:, 0])), free_run, atol=1e-12)
    one_step = np.array([float(row["one_step"]) for row in rows])
    np.testing.assert_allclose(model.one_step((record.u, record.y[:, 0]))[3:], one_step[3:], atol=1e-12)
    assert "a1" in repr(model)


class Page(HTMLParser):
    """Collects what a page would load, and its scripts."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.scripts = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.scripts += tag == "script"
        self.loaded += [value or "" for name, value in attrs if name in ("src", "href", "srcset")]


def test_page_is_self_contained_and_escaped(folder: Path) -> None:
    text = (folder / "fit.html").read_text()
    page = Page()
    page.feed(text)
    assert page.scripts == 0
    assert page.loaded
    assert all(address.startswith("data:") for address in page.loaded)
    for words in ("<h2>The map</h2>", "Measured and modelled", "one-step RMSE", "95 % interval", "F test"):
        assert words in text
    assert (folder / "fit.pdf").read_bytes().startswith(b"%PDF")


def test_output_is_what_an_engineer_would_say(folder: Path) -> None:
    said = (folder / "said.txt").read_text()
    assert said.startswith("A Wiener-Hammerstein model with a static map of u(k-1), u(k-2) explains 99.")
    for words in (
        "free-run error",
        "The map rises where 95 % of its data lie",
        "95 % interval",
        "one-step RMSE",
    ):
        assert words in said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--z", "q:1", "--a-order", "1"], "there is no signal 'q'"),
        (["--z", "u:"], "'u:' is no lag: write SIGNAL:DELAY"),
        (["--a-order", "x"], "--a-order 'x': give a whole number of at least 0"),
        (["--knots", "1"], "--knots '1': give a whole number of at least 2"),
        (["--z", "u:1", "--input-lags", "2"], "--z and --input-lags say the same"),
        (["--structure", "nonsense"], "structure 'nonsense' is not known: choose one of lft"),
        (["--jacobian", "newton"], "choose exact or kaufman"),
        (
            ["--a-order", "1", "--z", "u:1", "--b-lags", "1", "--overlap", "reject"],
            "b1 and the slope of the map",
        ),
        (["--a-order", "1", "--z", "u:1", "--knots", "600"], "rows cannot determine"),
        (["--knot", "5"], "unrecognized arguments: --knot 5 (did you mean --knots?)"),
        (["--save", "data.csv"], "is the measurement file"),
    ],
)
def test_bad_use_is_one_sentence(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_csv(tmp_path / "data.csv")
    try:
        code: Any = main(["fit", "data.csv", "--period", "0.1", "--split-column", "set", *arguments])
    except SystemExit as stop:
        code = stop.code
    lines = capsys.readouterr().err.strip().splitlines()
    assert (code, len(lines)) == (2, 1)
    assert words in lines[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare", "D", "--out", "x"], "unrecognized arguments: --out x (did you mean --output?)"),
        (["replicate", "--smok"], "unrecognized arguments: --smok (did you mean --smoke?)"),
        (["data", "fetch", "emps", "--t", "x"], "unrecognized arguments: --t x"),
    ],
)
def test_options_are_not_abbreviated(
    capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 2
    assert words in capsys.readouterr().err


def test_a_further_structure_is_an_entry_and_a_module(monkeypatch: pytest.MonkeyPatch) -> None:
    other = Structure("other", "another one", LFT.options[:1], "sysid.diagnosis.models.lft:fit_lft_structure")
    monkeypatch.setattr(fit_structures, "STRUCTURES", (LFT, other))
    assert find_structure("other").load() is fit_lft_structure
    assert other.read_options({"--z": "u:1"}) == {"z_lags": (("u", 1),)}
    with pytest.raises(UsageError, match="--knots does not belong to the structure other: it has --z"):
        other.read_options({"--knots": "3"})


def test_lags_of_columns_with_colons() -> None:
    assert lag_list("flow: in:2, 3") == (("flow: in", 2), ("u", 3))
    assert lag_list("none") == ()


def test_structure_is_chosen_on_validation_rows_alone() -> None:
    u, y = measured()
    split = np.repeat(["train", "test"], [400, 100])
    record = make_record(u, y, period=0.1, split=split)
    found = choose_lft(record, {"b_lags": (), "z_lags": (("u", 1), ("u", 2))})
    assert found.fit.structure.kind == "Wiener-Hammerstein"
    assert "the simplest of" in found.reason
    assert found.trials[0].validation_rms <= found.trials[-1].validation_rms
    spoilt = y.copy()
    spoilt[400:] = 1e3
    other = choose_lft(
        make_record(u, spoilt, period=0.1, split=split), {"b_lags": (), "z_lags": found.fit.structure.z_lags}
    )
    assert other.fit.structure == found.fit.structure
    np.testing.assert_array_equal(other.fit.a, found.fit.a)


def test_one_input_of_two_goes_through_the_map() -> None:
    rng = np.random.default_rng(0)
    u, y = rng.uniform(-2.0, 2.0, (600, 2)), np.zeros(600)
    for k in range(1, 600):
        y[k] = 0.6 * y[k - 1] + np.tanh(u[k - 1, 0]) + 0.5 * u[k - 1, 1] + 0.05 * rng.standard_normal()
    record = make_record(u, y, period=1.0, inputs=("valve", "load"))
    found = choose_lft(record, {"knots": 6}, criterion="one-step")
    assert found.fit.structure.z_lags == (("valve", 1),)
    assert found.fit.structure.b_lags == (("load", 1),)
    assert abs(found.fit.b[0] - 0.5) < 4.0 * found.fit.parameters()["b1"][1]


def test_a_map_that_is_not_determined_is_told() -> None:
    rng = np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, 300)
    y = np.r_[0.0, u[:-1]] + 0.1 * rng.standard_normal(300)  # nothing is bent: b1, b2 or the map may do it
    given = {"n_a": 0, "b_lags": (("u", 1), ("u", 2)), "z_lags": (("u", 1),), "n_g": 1, "overlap": "keep"}
    model = fit_lft_structure(make_record(u, y, period=1.0), given | {"criterion": "one-step", "knots": 4})
    assert model.notes[0].startswith("The map ")
    loose = fit_lft_structure(
        make_record(u, y, period=1.0), given | {"n_g": 2, "criterion": "one-step", "knots": 4}
    )
    assert any("do not determine the map" in warning for warning in loose.warnings)


def test_delay_is_found() -> None:
    u = np.random.default_rng(0).standard_normal(400)
    y = np.convolve(u, [0.0, 0.0, 0.0, 0.0, 1.0, 0.5])[:400]
    assert likely_delay(make_record(u, np.tanh(y), period=1.0)) == 4


def test_a_test_experiment_without_outputs_starts_at_rest_and_says_so() -> None:
    u, y = measured()
    y[400:] = np.nan
    split, experiment = (np.repeat(names, [400, 100]) for names in (["train", "test"], ["one", "two"]))
    record = make_record(u, y, period=0.1, split=split, experiment=experiment)
    model = fit_lft_structure(record, {"n_a": 1, "z_lags": (("u", 1),)})
    prediction = model.predict(record)
    assert prediction.starts == ("the first 1 rows as measured", "at rest")
    assert np.isfinite(prediction.free_run).all()
    at_rest = fit_lft_structure(record, {"n_a": 1, "z_lags": (("u", 1),)}, initial_state="rest")
    assert at_rest.predict(record).starts == ("at rest", "at rest")


def test_coloured_residual_is_told() -> None:
    rng = np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, 600)
    y = np.r_[0.0, np.tanh(2.0 * u[:-1])] + np.convolve(0.3 * rng.standard_normal(600), [1.0, 0.9])[:600]
    record = make_record(u, y, period=1.0)
    model = fit_lft_structure(record, {"n_a": 0, "z_lags": (("u", 1),), "knots": 5})
    assert any("one-step residual is not white" in warning for warning in model.warnings)


def test_straight_maps_are_told_from_bent_ones() -> None:
    rng = np.random.default_rng(1)
    u = rng.uniform(-1.0, 1.0, 500)
    noise = 0.1 * rng.standard_normal(500)
    for bend, expected in ((0.0, False), (0.3, True)):
        y = np.r_[0.0, u[:-1] + bend * u[:-1] ** 2] + noise
        fit = fit_lft((u, y), replace(fit_lft_given(), knots=5))
        assert (fit.straight_line_test() < 0.01) is expected
        value, error = fit.bend([0.0])
        assert abs(value[0] + bend * 0.33) < 4.0 * error[0]


def fit_lft_given() -> Any:
    from sysid.lft import LftStructure

    return LftStructure(z_lags=(("u", 1),))


def test_straight_line_test_has_its_level() -> None:
    """P values of a straight map are uniform: their smallest tenth holds a tenth of them."""
    from scipy.stats import binom

    low = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u = rng.uniform(-1.0, 1.0, 120)
        y = np.r_[0.0, u[:-1]] + 0.3 * rng.standard_normal(120)
        low += fit_lft((u, y), replace(fit_lft_given(), knots=4)).straight_line_test() < 0.1
    least, most = binom.ppf([5e-5, 1.0 - 5e-5], 200, 0.1)
    assert least <= low <= most


def test_saved_models_are_checked_when_read(tmp_path: Path) -> None:
    fit: LftFit = fit_lft(measured(), replace(fit_lft_given(), knots=5))
    save(fit, tmp_path / "model.json")
    content = json.loads((tmp_path / "model.json").read_text())
    for change in (
        {"kind": "other"},
        {"a": [1.0, 2.0]},
        {"d": ["x"]},
        {"names": []},
        {"map": {}},
        {"structure": 3},
    ):
        (tmp_path / "bad.json").write_text(json.dumps(content | change))
        with pytest.raises(DataError, match="is no saved LFT model"):
            load(tmp_path / "bad.json")
    with pytest.raises(DataError, match="cannot be read"):
        load(tmp_path / "none.json")


def test_choice_without_a_usable_structure_gives_the_reason() -> None:
    record = make_record(*measured(), period=1.0)
    with pytest.raises(IdentifiabilityError, match=r"none of \d+ structures .* rows cannot determine"):
        choose_lft(record, {"knots": 2000})
