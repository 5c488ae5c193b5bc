"""Comparison: scores, intervals, residual tests, findings, page, command."""

import dataclasses
import json
import math
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.compare import compare
from sysid.diagnosis.comparison.scores import nrmse_interval, score
from sysid.diagnosis.pages.drawing import WIDE, envelope
from sysid.diagnosis.pages.figures_residual import correlations, power_density
from sysid.diagnosis.residuals import input_independence, whiteness
from sysid.errors import UsageError

A, B = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]


def record(n=900, noise=0.1, seed=0, **keywords):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter(B, A, u) + noise * rng.standard_normal(n)
    keywords = {"split": np.repeat(["train", "test"], [2 * n // 3, n - 2 * n // 3]), **keywords}
    return make_record(u, y, 0.1, name="plant", units={"u": "V", "y": "m"}, **keywords)


@pytest.fixture(scope="module")
def comparison():
    return compare(record(), order=2, delay=1)


@pytest.fixture(scope="module")
def page(comparison):
    return comparison.to_html()


# Scores


def test_scores_are_their_definitions():
    rng = np.random.default_rng(0)
    y, predicted = rng.standard_normal((2, 200))
    s = score(y, predicted)
    error = y - predicted
    assert s.rmse == pytest.approx(math.sqrt(np.mean(error**2)))
    assert s.nrmse == pytest.approx(np.linalg.norm(error) / np.linalg.norm(y - y.mean()))
    assert s.fit == pytest.approx(100 * (1 - s.nrmse))
    assert s.vaf == pytest.approx(100 * (1 - error.var() / y.var()))
    assert score(np.ones(5), np.zeros(5)).to_json() == {"rmse": 1.0, "nrmse": None, "fit": None, "vaf": None}


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_interval_covers_the_true_nrmse(memory):
    """95 % intervals of 200 records cover the error's true size, with coloured errors too."""
    rng = np.random.default_rng(4)
    n, hits = 2000, 0
    y = np.sin(0.37 * np.arange(n)) * math.sqrt(2.0)
    for _ in range(200):
        error = signal.lfilter([math.sqrt(1 - memory**2)], [1.0, -memory], rng.standard_normal(n + 200))[200:]
        low, high = nrmse_interval(y, y + 0.3 * error)
        hits += low <= 0.3 <= high
    # 95 % of 200 is 190 +- 3 for exact intervals; block bootstraps of coloured series cover a little less.
    assert 174 <= hits <= 199


def test_interval_is_repeatable_and_contains_the_estimate():
    rng = np.random.default_rng(1)
    y = rng.standard_normal(500)
    predicted = y + 0.2 * rng.standard_normal(500)
    low, high = nrmse_interval(y, predicted)
    assert (low, high) == nrmse_interval(y, predicted)
    assert low < score(y, predicted).nrmse < high


# Residual tests


def test_false_alarms_of_whiteness_are_nominal():
    rng = np.random.default_rng(2)
    tests = [whiteness(rng.standard_normal(800)) for _ in range(400)]
    outside = np.mean([test.outside / test.lags.size for test in tests])
    assert 0.006 < outside < 0.014  # 1 % of 10 000 correlations, 0.1 % standard error
    assert sum(not test.passed for test in tests) <= 10  # 1 % of 400 is 4 +- 2


def test_false_alarms_of_input_independence_are_nominal_for_coloured_signals():
    rng = np.random.default_rng(3)
    tests = []
    for _ in range(300):
        u = signal.lfilter([1.0], [1.0, -0.9], rng.standard_normal(1200))[200:]
        e = signal.lfilter([1.0], [1.0, -0.8], rng.standard_normal(1200))[200:]
        tests.append(input_independence(u, e))
    outside = np.mean([test.outside / test.lags.size for test in tests])
    # 1 % nominal; neighbouring lags are correlated, and the band itself is estimated from the record.
    assert 0.004 < outside < 0.022
    assert sum(not test.passed for test in tests) <= 9  # 1 % of 300 is 3 +- 1.7


def test_residual_tests_find_what_is_there():
    rng = np.random.default_rng(5)
    u, e = rng.standard_normal((2, 1000))
    assert not whiteness(signal.lfilter([1.0], [1.0, -0.5], e)).passed
    test = input_independence(u, e + 0.3 * np.roll(u, 7))
    assert not test.passed
    assert test.lags[np.argmax(np.abs(test.correlation))] == 7


def test_each_of_several_inputs_is_named():
    rng = np.random.default_rng(3)
    u = rng.standard_normal((900, 3))
    y = signal.lfilter(B, A, u[:, 0]) + signal.lfilter(B, A, u[:, 1])
    late = np.concatenate([np.zeros(60), u[:-60, 1]])  # a path that no second-order model has
    split = np.repeat(["train", "test"], [600, 300])
    names = ("valve", "heat_er", "door")
    found = compare(
        make_record(u, y + late + 0.1 * rng.standard_normal(900), 0.1, inputs=names, split=split),
        order=2,
        delay=1,
        ports=False,
    )
    follows = dataclasses.replace(found.tests["whiteness"], p_value=1e-6)
    found = dataclasses.replace(found, tests=found.tests | {"input_residual_heat_er": follows})
    said = found.sentences()
    assert "No linear trace of 'valve' or 'door' is left in the residual on test." in said
    assert any(s.startswith("The residual on test still follows 'heat_er' linearly (") for s in said)
    assert not any("sysid diagnose" in s for s in said)
    coloured = dataclasses.replace(found, tests=found.tests | {"whiteness": follows})
    assert "looked for by sysid diagnose" in coloured.sentences()[-1]
    before = dataclasses.replace(follows, lags=follows.lags - follows.lags[-1] - 1)
    later = dataclasses.replace(found, tests=found.tests | {"input_residual_heat_er": before}).sentences()
    (told,) = (s for s in later if "still follows" in s)
    assert re.search(r"\(most the input \d+ samples? after it, as a slow input, feedback or columns", told)
    figure, _, reading = correlations(found, WIDE, 2.4)
    assert [axes.get_ylabel() for axes in figure.axes][2] == "heat_er with residual"
    assert "it still follows heat_er linearly" in reading


def test_cross_correlation_is_that_of_numpy():
    rng = np.random.default_rng(6)
    u, e = rng.standard_normal((2, 300))
    test = input_independence(u, e)
    uc, ec = u - u.mean(), e - e.mean()
    full = np.correlate(ec, uc, mode="full") / np.linalg.norm(uc) / np.linalg.norm(ec)
    np.testing.assert_allclose(test.correlation, full[299 - 25 : 299 + 26], atol=1e-12)


# Comparison


def test_comparison_speaks_and_scores(comparison):
    entry = comparison.score_of("test")
    assert entry.free_run.rmse == pytest.approx(0.1, rel=0.1)
    assert (entry.n_rows, entry.first_row, entry.last_row, entry.unit) == (300, 601, 900, "m")
    first = comparison.sentences()[0]
    assert "second-order linear model" in first
    assert " mm RMSE" in first
    assert comparison.tests["whiteness"].passed
    assert comparison.tests["input_residual"].passed
    assert [s.name for s in comparison.scores] == ["train", "validation", "test"]
    assert comparison.score_of("validation").fitted_on == "estimation rows"
    assert "plant" in repr(comparison)


def test_json_is_strict_and_has_the_agreed_form(comparison):
    text = json.dumps(comparison.to_json(), allow_nan=False)
    content = json.loads(text)
    assert content["schema"] == 1
    assert {"model", "scores", "noise_floor", "where", "tests", "ports", "warnings"} <= set(content)
    assert {"name", "order", "delay", "parameters"} <= set(content["model"])
    assert content["model"]["parameters"]["b1"]["unit"] == "m/V"
    assert set(content["model"]["parameters"]["a1"]) == {"value", "std_error", "unit"}
    assert {"nrmse", "method"} <= set(content["noise_floor"])
    assert {"residual_squared_input", "distortion", "whiteness"} <= set(content["tests"])
    assert content["where"] == []
    assert {"time", "input u", "output", "velocity", "velocity-sign", "frequency"} <= set(content["shares"])
    for bars in content["shares"].values():
        assert all({"region", "error_share", "data_share", "p_value"} <= set(bar) for bar in bars)
    assert sum(bar["error_share"] for bar in content["shares"]["time"]) == pytest.approx(1.0)
    wanted = {"rmse", "nrmse", "fit", "vaf", "unit", "interval", "window", "initial_state", "one_step"}
    assert wanted <= set(content["scores"]["test"])


def test_several_test_sets_missing_output_and_skip():
    rng = np.random.default_rng(8)
    u = rng.standard_normal(1000)
    y = signal.lfilter(B, A, u) + 0.05 * rng.standard_normal(1000)
    split = np.repeat(["est", "val", "test_a", "test_b", "test_c"], 200)
    y[600:650] = np.nan
    y[800:] = np.nan
    result = compare(make_record(u, y, 1.0, split=split, skip={"test_a": 10}), order=2, delay=1)
    assert [s.name for s in result.scores] == ["est", "validation", "test_a", "test_b"]
    assert (result.score_of("test_a").n_rows, result.score_of("test_b").n_rows) == (190, 150)
    assert any("'test_c' has no measured output" in warning for warning in result.warnings)
    assert np.isfinite(result.prediction.free_run).all()
    json.dumps(result.to_json(), allow_nan=False)


def test_record_without_test_rows_is_judged_on_validation():
    rng = np.random.default_rng(9)
    u = rng.standard_normal(400)
    y = signal.lfilter(B, A, u) + 0.05 * rng.standard_normal(400)
    result = compare(make_record(u, y, 1.0), order=2, delay=1)
    assert result.judged == "validation"
    assert any("no test rows" in warning for warning in result.warnings)


def test_unknown_model_is_refused():
    with pytest.raises(UsageError, match="model 'duffing' is not known"):
        compare(record(), model="duffing")


# Figures and page


def test_envelope_keeps_the_extremes():
    rng = np.random.default_rng(0)
    x = rng.standard_normal(100_000)
    x[54_321] = 9.0
    x[10:20] = np.nan
    t, low, high = envelope(np.arange(x.size, dtype=float), x)
    assert t.size == low.size == high.size == 600
    assert (high.max(), low.min()) == (np.nanmax(x), np.nanmin(x))
    assert (low <= high).all()


@pytest.mark.parametrize("length", [256, 255])
def test_spectrum_is_that_of_scipy(length):
    x = np.random.default_rng(1).standard_normal(3000)
    frequency, power = signal.welch(x, 10.0, nperseg=length)
    ours = power_density(x, 0.1, length)
    np.testing.assert_allclose(ours[0], frequency, rtol=1e-12)
    np.testing.assert_allclose(ours[1], power, rtol=1e-9, atol=1e-12)


def test_options_in_a_page_stay_in_one_piece_and_marks_are_escaped():
    from sysid.diagnosis.pages.page import _tied

    written = _tied("3 % of <b>: give --effects-file, thorough=True or --fix.")
    option = '<code class="option">{}</code>'
    assert written == (
        f"3\N{NO-BREAK SPACE}% of &lt;b&gt;: give {option.format('--effects-file')}, thorough=True or "
        f"{option.format('--fix')}."
    )
    assert _tied("a well--known e-mail") == "a well--known e-mail"


def test_page_is_self_contained_and_safe():
    rng = np.random.default_rng(10)
    u = rng.standard_normal(300)
    y = signal.lfilter(B, A, u) + 0.1 * rng.standard_normal(300)
    split = np.repeat(["train", "test<script>"], [200, 100])
    html = compare(make_record(u, y, 1.0, name="a & <b>", split=split), order=2, delay=1).to_html()
    assert "<script" not in html
    assert "a &amp; &lt;b&gt;" in html
    assert not re.search(r"(?:src|href|srcset)=\"(?!data:)", html)
    assert "url(http" not in html
    assert html.count("<figure>") >= 4
    assert len(html) < 2_000_000


def test_page_is_the_same_for_the_same_record(comparison, page):
    from sysid.diagnosis.pages.content import content_of
    from sysid.diagnosis.pages.page import render

    assert render(content_of(comparison)) == page  # drawn anew


def test_pdf_has_the_content_of_the_page_and_is_repeatable(comparison):
    document = comparison.to_pdf()
    assert document.startswith(b"%PDF-")
    assert document == comparison.to_pdf()
    headings = [section.heading for section in comparison.content.sections]
    assert headings[:3] == ["Scores", "Measured and modelled", "Where it fails"]
    assert all(f"<h2>{heading}</h2>" in comparison.to_html() for heading in headings)


def test_free_form_curves_are_listed_where_there_are_any(comparison):
    class Curve:
        sentence = "A static map at the input would explain at most 61 % of the error."
        explains_at_most = 0.61

        def to_json(self):
            return {"port": "input", "explains_at_most": 0.61, "curve": []}

    with_port = dataclasses.replace(comparison, ports=(Curve(),))
    assert with_port.to_json()["ports"] == [{"port": "input", "explains_at_most": 0.61, "curve": []}]
    assert Curve.sentence in with_port.sentences()


@pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed")
@pytest.mark.parametrize("width", [1280, 500])
def test_page_in_a_browser(page, tmp_path, width):
    file, picture = tmp_path / "page.html", tmp_path / "page.png"
    file.write_text(page, encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    options += [f"--user-data-dir={tmp_path / 'profile'}", f"--window-size={width},3000"]
    shot = subprocess.run(
        ["chromium", *options, f"--screenshot={picture}", str(file)],
        capture_output=True,
        timeout=120,
        check=True,
    )
    assert b"CONSOLE" not in shot.stderr
    assert picture.stat().st_size > 30_000  # a blank page has a few kB


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"order": "2"}, "order is '2': give a whole number"),
        ({"order": 2.5}, "order is 2.5"),
        ({"delay": "1"}, "delay is '1'"),
        ({"constant": "yes"}, "constant is 'yes': give True, False or None"),
        ({"record": np.zeros(60)}, "record is of type ndarray: make one with"),
    ],
)
def test_arguments_of_the_wrong_kind_are_told(arguments, message):
    with pytest.raises(UsageError, match=message):
        compare(**{"record": record(120), "order": 1} | arguments)


@pytest.mark.parametrize("scored", [2, 5, 19])
def test_few_test_rows_are_scored_and_not_tested(scored):
    rec = record(300, split=["train"] * 280 + ["test"] * 20, skip=20 - scored)
    comparison = compare(rec, order=2)
    assert comparison.score_of("test").n_rows == scored
    assert f"The {scored} samples of test are too few to tell" in " ".join(comparison.sentences())
    if scored == 5:
        assert "Spectrum" not in comparison.to_html()


def test_constant_output_on_test_has_no_share_explained():
    u, y = record(300).u[:, 0], record(300).y[:, 0].copy()
    y[200:] = 0.1  # a mean of equal values that differs from them by rounding
    comparison = compare(make_record(u, y, 0.1, split=["train"] * 200 + ["test"] * 100), order=2)
    assert np.isnan(comparison.score_of("test").free_run.nrmse)
    assert comparison.to_json()["scores"]["test"]["nrmse"] is None
    assert "where 'y' is constant and has no variance to explain" in comparison.sentences()[0]
    assert "nan" not in comparison.to_html().split("<style>")[0] + " ".join(comparison.sentences())


def test_names_of_any_kind_are_drawn_as_they_are():
    rec = record(300, split=["train"] * 200 + ["test[/x]"] * 100)
    odd = make_record(rec.u, rec.y, 0.1, split=rec.split, inputs=[r"$\foo$"], outputs=["量"])
    page = compare(odd, order=2).to_html()
    assert r"$\foo$ [" in page


def test_estimation_rows_of_both_names_are_scored_together():
    rec = record(300, split=["train", "est"] * 100 + ["test"] * 100)
    assert compare(rec, order=2).score_of("train").n_rows == 200


# The command


def write(folder, n=600):
    rng = np.random.default_rng(11)
    u = rng.standard_normal(n)
    y = signal.lfilter(B, A, u) + 0.1 * rng.standard_normal(n)
    lines = [f"{u[k]:.6f},{y[k]:.6f},{'train' if k < 400 else 'test'}" for k in range(n)]
    path = folder / "pump.csv"
    path.write_text("u,y,set\n" + "\n".join(lines) + "\n")
    return path


def test_command_writes_page_and_json_and_answers(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path)
    before = path.read_bytes()
    options = [
        "--model",
        "linear",
        "--input",
        "u",
        "--output",
        "y",
        "--split-column",
        "set",
        "--period",
        "0.1",
    ]
    results = ["--json", "out/pump.json", "--pdf", "out/pump.pdf"]
    assert main(["compare", "pump.csv", *options, "--order", "2", *results]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("A second-order linear model explains ")
    assert "Page: sysid-out/pump.compare.html" in out
    assert err == ""
    assert "<svg" not in out
    content = json.loads(Path("out/pump.json").read_text())
    assert content["model"]["order"] == 2
    assert content["scores"]["test"]["window"]["skip"] == 0
    assert Path("sysid-out/pump.compare.html").stat().st_size > 50_000
    assert Path("out/pump.pdf").read_bytes().startswith(b"%PDF-")
    assert "PDF: out/pump.pdf" in out
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--period", "0.1", "--input", "v"], "no column 'v'"),
        (["--period", "0.1", "--order", "0"], "order is 0"),
        (["--period", "0.1", "--skip", "-2"], "--skip is -2"),
        (["--period", "0.1", "--skip", "500"], "skip is 500 for the set 'test', which has 200 rows"),
        (["--period", "0.1", "--model", "magic"], "'magic' is not known: choose one of linear"),
        (["--period", "0"], "positive number"),
        ([], "sampling period is not known"),
        (["--period", "0.1", "--html", "pump.csv"], "is the measurement file"),
        (["--period", "0.1", "--json", "."], "is a folder"),
        (["--period", "0.1", "--json", "pump.json"], "pump.json holds notes on the measurements"),
        (["--period", "0.1", "--json", "p", "--html", "./p"], "p is named for two results"),
        (["--period", "0.1", "--json", "pump.csv/p.json"], "pump.csv is a file): choose another place"),
        (["--period", "0.1", "--html", "p" * 300], "(File name too long): choose another place"),
        (["--period", "0.1", "--output", "y", "--output", "y"], "--output is given 'y' twice"),
    ],
)
def test_bad_use_ends_in_one_sentence(tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    write(tmp_path)
    Path("pump.json").write_text('{"units": {"u": "V"}}')
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert main(["compare", "pump.csv", "--split-column", "set", *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.skipif("SYSID_DATA" not in os.environ, reason="SYSID_DATA names no folder of real records")
def test_real_record_from_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = Path(os.environ["SYSID_DATA"]) / "hair_dryer" / "hair_dryer.csv"
    options = ["--split-column", "split", "--experiment-column", "experiment", "--period", "0.08"]
    assert main(["compare", str(path), "--json", "h.json", *options]) == 0
    content = json.loads(Path("h.json").read_text())
    assert content["model"]["delay"] == 3  # its dead time
    assert content["scores"]["test"]["nrmse"] == pytest.approx(0.15, abs=0.01)
    assert "in the model the input acts after 3 samples" in capsys.readouterr().out.lower()
