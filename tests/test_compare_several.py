"""Several outputs and models in one call of `sysid compare`: files of their own, one table at the end."""

import json
from pathlib import Path

import numpy as np
import pytest

from sysid.cli import main


def write(path, n=240):
    rng = np.random.default_rng(0)
    u, a, b = rng.standard_normal(n), np.zeros(n), np.zeros(n)
    for k in range(1, n):
        a[k] = 0.8 * a[k - 1] + 0.3 * u[k - 1]
        b[k] = 0.5 * b[k - 1] + np.tanh(u[k - 1])
    noise = 0.02 * rng.standard_normal((n, 2))
    split = ["train"] * (n - 100) + ["test"] * 100
    columns = zip(u, a + noise[:, 0], b + noise[:, 1], split, strict=True)
    rows = [f"{x:.6f},{y:.6f},{z:.6f},{s}" for x, y, z, s in columns]
    Path(path).write_text("u,speed,temp [K],set\n" + "\n".join(rows) + "\n")


def test_each_output_has_its_own_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write("two.csv")
    options = ["--period", "0.1", "--split-column", "set", "--order", "1", "--html", "page.html"]
    outputs = ["--output", "speed", "--output", "temp [K]", "--json", "r.json"]
    assert main(["compare", "two.csv", *options, *outputs]) == 0
    shown = capsys.readouterr().out
    assert "== speed, model linear" in shown
    assert "== temp [K], model linear" in shown
    assert "Side by side, free run:" in shown
    errors = [
        json.loads(Path(f"r.{name}.json").read_text())["scores"]["test"] for name in ("speed", "temp__K_")
    ]
    assert errors[0]["nrmse"] < errors[1]["nrmse"]
    assert {path.name for path in tmp_path.glob("*.html")} == {"page.speed.html", "page.temp__K_.html"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--output", "a", "--output", "a"], "--output is given 'a' twice"),
        (["--also", "linear"], "a model is given 'linear' twice"),
        (["--also", "nothing"], "model 'nothing' is not known"),
        (["--output", "a b", "--output", "a_b"], "is named for two results"),
    ],
)
def test_wrong_combinations_are_refused_before_anything_is_read(options, message, capsys):
    assert main(["compare", "none.csv", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
