"""Text tables as instruments, loggers and spreadsheets write them."""

import numpy as np
import pytest

from sysid.data import read_record
from sysid.errors import DataError, UsageError

ROWS = 40


def lines(separator=",", decimal=".", end="", n=ROWS):
    """Rows of a time, an input and an output."""
    cells = ((f"{0.1 * k:.1f}", f"{k % 3}.5", f"{k % 5}.25") for k in range(n))
    return "".join(separator.join(row).replace(".", decimal) + end + "\n" for row in cells)


LABVIEW = (
    "LabVIEW Measurement\nWriter_Version\t2\nReader_Version\t2\nDate\t2019/05/03\n***End_of_Header***\t\t\n\n"
)


@pytest.mark.parametrize(
    ("above", "separator", "decimal", "end"),
    [
        (LABVIEW, "\t", ".", "\t"),
        ("Operator,J. Smith\nDate,2019-05-03\nChannels,2\n\n", ",", ".", ""),
        ("Messung 12; Achse 3\nAbtastzeit;0,1\n", ";", ",", ";"),
        ("Place;Hall;4\nRun;by;hand\n\nDate;May;3\n", ";", ",", ""),
        ("Made by rig 7, see notes\n", r" ", ".", ""),
        ("", ",", ".", ""),
    ],
)
@pytest.mark.parametrize("units", ["", "s,V,rad/s"])
def test_a_table_below_other_lines_is_found(tmp_path, above, separator, decimal, end, units):
    path = tmp_path / "rig.csv"
    header = separator.join(["time", "u", "y"]) + "\n" + (units and units.replace(",", separator) + "\n")
    path.write_text(above + header + lines(separator, decimal, end))
    record = read_record(path, time="time")
    assert (record.n_samples, record.period) == (ROWS, pytest.approx(0.1))
    np.testing.assert_array_equal(record.y[:3, 0], [0.25, 1.25, 2.25])
    assert record.unit("u") == ("V" if units else "")


@pytest.mark.parametrize(("separator", "decimal"), [(",", "."), (" ", "."), (";", ","), ("\t", ".")])
def test_columns_without_header_are_named_by_their_place(tmp_path, separator, decimal):
    path = tmp_path / "arm.dat"
    path.write_text(lines(separator, decimal))
    record = read_record(path, inputs="2", outputs="3", time="1")
    assert record.n_samples == ROWS
    assert record.u[:2, 0].tolist() == [0.5, 1.5]
    with pytest.raises(UsageError, match="no column 'u': its first row is all numbers, so its 3 columns"):
        read_record(path, time="1")


def test_a_header_that_counts_the_columns_is_one(tmp_path):
    path = tmp_path / "frame.csv"
    path.write_text("0,1,2\n" + lines())
    assert read_record(path, inputs="1", outputs="2", time="0").n_samples == ROWS


@pytest.mark.parametrize("tail", [";;\n" * 3, "9,0;1,5;\n", ";;\n9,0;NaN;\n"])
def test_rows_without_values_at_the_end_are_left_out(tmp_path, tail):
    path = tmp_path / "sheet.csv"
    path.write_text("t;u;y\n" + lines(";", ",") + tail)
    record = read_record(path, time="t")
    assert record.n_samples == ROWS
    assert any("left out, the record ends with row 40" in warning for warning in record.warnings)


def test_outputs_that_test_rows_lack_at_the_end_stay(tmp_path):
    path = tmp_path / "sheet.csv"
    marked = lines().replace("\n", ",est\n")
    path.write_text("t,u,y,set\n" + marked + "4.0,1,,test\n4.1,1,,test\n,,,\n")
    record = read_record(path, time="t", split="set")
    assert record.n_samples == ROWS + 2
    assert np.isnan(record.y[-1, 0])
    path.write_text("t,u,y,set\n4.0,1,,est\n" + marked)
    with pytest.raises(DataError, match="row 1, column 'y': the value is missing"):
        read_record(path, period=0.1, split="set")


@pytest.mark.parametrize(
    "clock",
    [
        "{day:02d}.02.2023 10:{minute:02d}",
        "02/{day:02d}/2023 10:{minute:02d}:00",
        "{day:02d}/02/2023 10:{minute:02d}",
    ],
)
def test_dates_may_have_the_day_or_the_month_first(tmp_path, clock):
    path = tmp_path / "historian.csv"
    stamps = [clock.format(day=1 + k // 144 * 0 + 3, minute=k) for k in range(ROWS)]
    path.write_text("stamp,u,y\n" + "".join(f"{s},{k % 3},{k % 5}\n" for k, s in enumerate(stamps)))
    assert read_record(path, time="stamp").period == 60.0


def test_the_order_of_day_and_month_is_the_one_with_uniform_steps(tmp_path):
    path = tmp_path / "days.csv"
    rows = "".join(f"{1 + k:02d}/03/2022 00:00,{k % 3},{k % 5}\n" for k in range(28))
    path.write_text("stamp,u,y\n" + rows)
    assert read_record(path, time="stamp").period == 86400.0
    hours = "".join(
        f"{11 + k // 24:02d}/03/2022 {k % 24:02d}:00,{k % 3},{k % 5}\n" for k in range(40)
    )  # 11 and 12 could be months
    path.write_text("stamp,u,y\n" + hours)
    assert read_record(path, time="stamp").period == 3600.0


@pytest.mark.parametrize("name", ["time (ms)", "t_ms", "millis", "time [ms]"])
def test_times_in_milliseconds_are_known_by_their_column(tmp_path, name):
    path = tmp_path / "board.csv"
    rows = "".join(f"{1200 + 20 * k};{k % 3};{k % 5}\n" for k in range(ROWS))
    path.write_text(f"{name};u (V);y (rad/s)\n" + rows)
    record = read_record(path, time=name.split(" ")[0])
    assert record.period == pytest.approx(0.02, rel=1e-12)
    assert record.unit("y") == "rad/s"
    assert any("were brought to seconds" in warning for warning in record.warnings)


@pytest.mark.parametrize("name", ["t", "t [s]"])
def test_a_gap_is_told_where_the_period_is_given(tmp_path, name):
    """The given period takes all rows as evenly spaced; a coarse or an even clock is no gap."""

    def warned(times):
        path = tmp_path / "gap.csv"
        rows = "".join(f"{t:.2f},{k % 3},{k % 5}\n" for k, t in enumerate(times))
        path.write_text(f"{name},u,y\n{rows}")
        return read_record(path, period=0.1).warnings

    even = 0.1 * np.arange(300)
    (gap,) = warned(even + 0.5 * (even > 20.0))
    assert gap.startswith(f"The time in '{name}' jumps by 0.6 at row 202 where the other steps are 0.1")
    (back,) = warned(even - 0.1 * (even > 20.0))
    assert "goes from 20 to 20 at row 202" in back
    assert "sort the rows" in back
    assert warned(even) == warned(0.13 * even) == ()


def test_a_time_column_is_named_where_no_period_is_given(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("t [s],u,y\n" + lines())
    with pytest.raises(UsageError, match=r"\(--time 't \[s\]'\)"):
        read_record(path)
    assert read_record(path, time="t [s]").period == pytest.approx(0.1)
