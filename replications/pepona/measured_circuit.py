"""The measured Wiener-Hammerstein circuit: free-run error on its test rows, beside published values.

The record is the SYSID 2009 benchmark (Schoukens, Suykens and Ljung, 2009): a diode-resistor circuit between
two filters of third order.  Orders, knots and oversampling are chosen on validation rows, the last quarter of
the training rows; the test rows are looked at once, for the score.
"""

from collections.abc import Mapping

import numpy as np

from sysid.data import Record, read_record
from sysid.data.registry import local_table
from sysid.lft import WienerHammersteinFit, fit_wiener_hammerstein

RECORD = "wiener_hammerstein"
NUMBER = "wiener_hammerstein_test_rmse_mv"
# Free-run errors on the test rows that others have published [mV].
LITERATURE: Mapping[str, float] = {
    "linear": 43.0,
    "LSTM (Champneys et al., 2024)": 4.446,
    "NL-LFR (Beintema)": 0.294,
    "best known": 0.241,
}


def wiener_hammerstein_test_rmse_mv(record: Record, fit: WienerHammersteinFit | None = None) -> float:
    """Return the free-run RMSE on the scored test rows [mV].

    Parameters
    ----------
    record : Record
        Training rows followed by the set ``test``; its skipped rows are not scored.
    fit : WienerHammersteinFit, optional
        Fitted to the training rows; by default all is chosen and fitted here.
    """
    fit = fit_wiener_hammerstein(record) if fit is None else fit
    error = record.y[:, 0] - fit.predict(record).free_run
    return 1e3 * float(np.sqrt(np.mean(error[record.scored_rows("test")] ** 2)))


def record_number(with_records: bool) -> tuple[dict[str, float | None], dict[str, str]]:
    """Return the number of the results, and a note where it could not be had.

    Parameters
    ----------
    with_records : bool
        Whether the replication is one with records; otherwise nothing is fitted.
    """
    if not with_records:
        return {NUMBER: None}, {NUMBER: "needs a measured record: sysid replicate pepona --with-records"}
    table = local_table(RECORD)
    if table is None:
        return {NUMBER: None}, {NUMBER: f"no local copy of the record {RECORD}: SYSID_DATA names the folder"}
    return {NUMBER: wiener_hammerstein_test_rmse_mv(read_record(table, split="split"))}, {}
