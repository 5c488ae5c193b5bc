"""Predictions files: one row for each row of the measurement file, in its order, whatever the record took."""

import contextlib
import csv
import io

import numpy as np
import pandas as pd
import pytest

from sysid import read_record
from sysid.cli import main
from sysid.result_files import to_csv_text

FIRST, SECOND, EMPTY = 90, 70, 3


def table():
    """Two experiments, the second measured in part, and rows without values behind them."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal((FIRST + SECOND) // 5), 5)
    y = np.zeros(u.size)
    for k in range(1, u.size):
        y[k] = 0.0 if k == FIRST else 0.7 * y[k - 1] + 0.4 * u[k - 1]
    y += 0.01 * rng.standard_normal(u.size)
    y[-10:] = np.nan
    nothing = np.full(EMPTY, np.nan)
    kinds = ["est"] * FIRST + ["val"] * (SECOND - 30) + ["test"] * 30 + [""] * EMPTY
    run = [1.0] * FIRST + [2.0] * SECOND + [np.nan] * EMPTY
    return {"u": np.append(u, nothing), "y": np.append(y, nothing), "run": np.array(run), "set": kinds}


def written(folder, ending):
    """Write the table in a format and return its path."""
    columns = table()
    path = folder / f"rig.{ending}"
    if ending == "npz":
        np.savez(path, **columns)
    elif ending == "parquet":
        pd.DataFrame(columns).to_parquet(path)
    else:
        text = pd.DataFrame(columns).to_csv(index=False, header=False)
        path.write_text("Rig 7\nOperator,J. Smith\n\nu,y,run,set\nV,rad/s,,\n" + text)
    return path


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("ending", ["csv", "npz", "parquet"])
def test_each_row_of_the_file_has_one(tmp_path, ending):
    path, answer = written(tmp_path, ending), tmp_path / "answer.csv"
    with contextlib.redirect_stdout(io.StringIO()):
        code = main(["diagnose", str(path), "--model=linear", "--order=1", "--initial-state=rest",
                     "--period=0.1", "--split-column=set", "--experiment-column=run",
                     "--effects=in_saturation", f"--predictions={answer}"])  # fmt: skip
    assert code == 0
    rows, columns = rows_of(answer), table()
    assert [int(row["k"]) for row in rows] == list(range(FIRST + SECOND + EMPTY))
    measured = np.array([float(row["measured"] or "nan") for row in rows])
    np.testing.assert_array_equal(measured, columns["y"])
    final = [row["final"] for row in rows]
    assert all(final[: FIRST + SECOND])
    assert float(final[FIRST]) == 0.0  # an experiment begins at rest in its own first row
    assert rows[-1] == {"k": str(FIRST + SECOND + EMPTY - 1), "measured": "", "baseline": "", "final": ""}


def test_rows_at_another_period_are_those_of_the_record(tmp_path):
    columns = {"period": 0.1, "split": "set", "experiment": "run"}
    record = read_record(written(tmp_path, "csv"), **columns)
    assert (record.n_samples, record.left_out) == (FIRST + SECOND, EMPTY)
    assert read_record(written(tmp_path, "csv"), **columns, resample=0.2).left_out == 0


def test_what_is_not_finite_is_an_empty_cell():
    assert to_csv_text({"a": [1.0, float("inf")], "b": [float("nan"), 2.5]}) == "k,a,b\n0,1.0,\n1,,2.5\n"
