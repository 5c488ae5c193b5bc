"""What the report says of the Wiener-Hammerstein benchmark."""

from collections.abc import Mapping
from typing import Any

from replications.pepona.records import NUMBER, PUBLISHED_MV
from sysid.reporting import display
from sysid.reporting.display import Display
from sysid.reporting.style import COLOURS

Results = Mapping[str, Any]


def benchmark(results: Results) -> Display:
    """Show the error on the test rows beside published ones, or say why there is none."""
    pepona = results["papers"]["pepona"]
    found = pepona["tables"].get("wiener-hammerstein")
    if found is None:
        return display.prose(f"No fit is shown here: {pepona['notes'][NUMBER]}.")
    rows: list[list[object]] = [[name, f"{value:g}"] for name, value in PUBLISHED_MV.items()]
    rows.append(["this library, Wiener-Hammerstein with a spline", f"{found['rmse_mv']:.3f}"])
    drawing, panel = display.subplots(height=2.7)
    panel.plot(found["z"], found["map"], color=COLOURS[0])
    panel.set_xlabel("output of the first block [V]")
    panel.set_ylabel("output of the map [V]")
    restarts = "agree" if found["restarts_agree"] else "do not agree"
    return display.group(
        display.table(
            rows,
            ["model", "RMSE [mV]"],
            align="lr",
            caption=f"Free-run error on the test rows of the benchmark ({found['rows']} samples).",
        ),
        display.figure(
            drawing,
            "The map of the benchmark's circuit as it was found, with both linear blocks of gain 1 at zero "
            "frequency.",
            "A diode limits one side.",
        ),
        display.prose(
            f"Chosen on held-out rows: orders {found['orders'][0]} and {found['orders'][1]}, "
            f"{found['knots']} knots, {found['parameters']} parameters. The largest error is "
            f"{found['largest_mv']:.2f} mV; the searches from different starts {restarts}."
        ),
    )
