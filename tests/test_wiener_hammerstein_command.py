"""`sysid fit --structure wiener-hammerstein` and `sysid compare --model wiener-hammerstein`."""

import json

import numpy as np
import pytest

from sysid.cli import main
from sysid.data import make_record
from sysid.diagnosis.models.resolution import fit_model, resolve_model
from sysid.diagnosis.models.wiener_hammerstein import fit_wiener_hammerstein_structure
from sysid.errors import UsageError
from sysid.lft import LinearBlock, WienerHammerstein, load
from sysid.nonlinearities.spline import Spline

NOISE = 0.02


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(0)
    z = np.linspace(-8.0, 8.0, 50)
    truth = WienerHammerstein(
        LinearBlock.from_polynomials([0.4, 0.0], [1.0, -0.6]),
        Spline.fitted(z, np.tanh(z), np.linspace(-8.0, 8.0, 30)),
        LinearBlock.from_polynomials([0.0, 0.3], [1.0, -0.7]),
    )
    u = rng.standard_normal(900)
    y = truth.simulate(u) + NOISE * rng.standard_normal(900)
    split = np.repeat(["train", "test"], [600, 300])
    return make_record(u, y, period=0.01, split=split, units={"u": "V", "y": "A"})


def test_command_writes_page_model_and_numbers(record, tmp_path, capsys):
    table = tmp_path / "circuit.csv"
    rows = np.column_stack([record.u[:, 0], record.y[:, 0]]).tolist()
    text = [f"{u!r},{y!r},{label}" for (u, y), label in zip(rows, record.split, strict=True)]
    table.write_text("\n".join(["u,y,set", *text]) + "\n")
    files = {name: tmp_path / f"out.{name}" for name in ("html", "json", "save")}
    options = ["--structure", "wiener-hammerstein", "--orders", "1,1", "--knots", "8", "--oversampling", "1"]
    places = [part for name, path in files.items() for part in (f"--{name}", str(path))]
    data = ["fit", str(table), "--period", "0.01", "--split-column", "set"]
    assert main([*data, *options, *places]) == 0
    told = capsys.readouterr().out
    assert "A Wiener-Hammerstein model of orders 1 and 1" in told
    assert "back_a1" in told
    page = files["html"].read_text()
    assert "Frequency responses of the linear blocks" in page
    assert "95 % band" in page
    numbers = json.loads(files["json"].read_text())
    assert numbers["scores"]["test"]["rmse"] < 1.15 * NOISE
    model = load(files["save"])
    free_run = model.simulate(record.u[:, 0])
    assert np.sqrt(np.mean((record.y[600:, 0] - free_run[600:]) ** 2)) == pytest.approx(
        numbers["scores"]["test"]["rmse"], rel=1e-6
    )
    assert main([*data, *options, "--z", "u:1"]) == 2
    assert "--z does not belong to the structure wiener-hammerstein" in capsys.readouterr().err
    assert main([*data, "--structure", "wiener-hammerstein", "--orders", "1,1,1"]) == 2
    assert "front and the back block" in capsys.readouterr().err


def test_compare_knows_it_by_name(record):
    # What `sysid compare --model wiener-hammerstein --order 1` fits; the page is that of `sysid fit`.
    assert resolve_model("wiener-hammerstein", order=1) == "wiener-hammerstein"
    model = fit_model(record, "wiener-hammerstein", 1)
    assert model.fit.orders == (1, 1)
    free_run = model.predict(record).free_run
    assert np.sqrt(np.mean((record.y[600:, 0] - free_run[600:]) ** 2)) < 1.15 * NOISE
    with pytest.raises(UsageError, match="constant belongs to the linear model"):
        fit_model(record, "wiener-hammerstein", 1, constant=True)


def test_views_hold_what_the_fit_says(record):
    judged = fit_wiener_hammerstein_structure(record, {"orders": (1, 1), "knots": 8, "oversampling": 1})
    (view,) = judged.maps()
    centre, error = judged.fit.map_band(view.value)
    np.testing.assert_allclose(view.upper - view.lower, 2 * 1.959963984540054 * error)
    np.testing.assert_allclose(view.centre, centre)
    # Nearest where the data are: what is beyond the line has neither mean nor slope there.
    weighted = view.density * view.bend
    assert abs(weighted.sum()) < 1e-9 * np.abs(weighted).sum()
    assert abs((weighted * view.value).sum()) < 1e-9 * np.abs(weighted * view.value).sum()
    front, back = judged.responses()
    block = judged.fit.back
    angle = 2 * np.pi * back.frequency * record.period
    np.testing.assert_allclose(back.gain, np.abs(block.response(angle)))
    assert (front.lower <= front.gain).all()
    assert judged.details()["tried"]
    assert "rises throughout" in judged.notes[0]
