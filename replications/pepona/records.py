"""The Wiener-Hammerstein benchmark: fitted on demand, outside the time of a default replication."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid.replication import Session

RECORD = "wiener_hammerstein"
NUMBER = "wiener_hammerstein_test_rmse_mv"
PUBLISHED_MV: Mapping[str, float] = {
    "best linear approximation": 44.4,
    "gated recurrent network (2024)": 3.97,
    "nonlinear LFR state space, encoder start": 0.294,
    "deep encoder network, Beintema, Tóth, Schoukens (2021)": 0.241,
}
"""Published free-run errors on the test data [mV]; windows differ by a few samples."""


@dataclass(frozen=True)
class RecordResult:
    """What real records give.

    Attributes
    ----------
    numbers : mapping
        None where a number could not be computed.
    notes : mapping
        Why, by number.
    tables : mapping
        What the report shows.
    """

    numbers: Mapping[str, float | None]
    notes: Mapping[str, str] = field(default_factory=dict)
    tables: Mapping[str, Any] = field(default_factory=dict)


def record_result(session: Session) -> RecordResult:
    """Fit the benchmark if records were asked for and this one is at hand."""
    from sysid.data.registry import local_table

    if not session.with_records:
        return RecordResult({NUMBER: None}, {NUMBER: "not computed: add --with-records"})
    if local_table(RECORD) is None:
        note = f"the record is not at hand: `sysid data fetch {RECORD}`, or let SYSID_DATA name its folder"
        return RecordResult({NUMBER: None}, {NUMBER: note})
    with session.timed("record"):
        return _fitted()


def _fitted() -> RecordResult:
    """Choose and fit a model on the training rows, and score its free run on the test rows."""
    from sysid.data import read_record
    from sysid.lft import fit_wiener_hammerstein

    record = read_record(RECORD)
    # The record begins in the middle of a measurement, so that the state at its start is not rest.
    fit = fit_wiener_hammerstein(record, initial_state="estimate")
    rows = record.scored_rows("test")
    error = record.y[rows, 0] - fit.predict(record).free_run[rows]
    rmse = 1e3 * float(np.sqrt(np.mean(error**2)))
    z = np.linspace(fit.map.knots[0], fit.map.knots[-1], 201)
    table = {
        "rmse_mv": rmse,
        "largest_mv": 1e3 * float(np.max(np.abs(error))),
        "orders": list(fit.orders),
        "knots": int(fit.map.knots.size),
        "parameters": fit.n_parameters,
        "status": fit.status,
        "restarts_agree": fit.restarts_agree,
        "rows": int(rows.sum()),
        "z": z.tolist(),
        "map": fit.map(z).tolist(),
    }
    return RecordResult({NUMBER: rmse}, tables={"wiener-hammerstein": table})
