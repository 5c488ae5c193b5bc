"""Rows without values that spreadsheets and loggers leave at the end of a table."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.data.columns import Wanted
from sysid.data.labels import TEST_PREFIX

if TYPE_CHECKING:
    import pandas as pd


def without_empty_end(table: "pd.DataFrame", wanted: Wanted, remarks: list[str]) -> "pd.DataFrame":
    """Return a table without the rows at its end that lack an input or an output; add a remark.

    Nothing that was measured depends on them.  Rows of a test set may lack the output: it is predicted there.

    Parameters
    ----------
    table : DataFrame
    wanted : Wanted
        Its columns, by their names in the table.
    remarks : list of str
        What is said about the record.
    """
    lacks = {name: _is_empty(table[name]) for name in (*wanted.inputs, *wanted.outputs)}
    without_input = np.any([lacks[name] for name in wanted.inputs], axis=0)
    unusable = np.any([lacks[name] for name in wanted.outputs], axis=0)
    if wanted.split is not None:
        unusable &= ~table[wanted.split].astype(str).str.strip().str.startswith(TEST_PREFIX).to_numpy(
            dtype=bool
        )
    usable = np.flatnonzero(~(without_input | unusable))
    count = len(table) - 1 - int(usable[-1]) if usable.size else 0
    if count == 0:
        return table
    names = ", ".join(repr(name) for name, empty in lacks.items() if empty[-count:].any())
    rows = f"The last {count} rows lack" if count > 1 else "The last row lacks"
    remarks.append(f"{rows} {names}: left out, the record ends with row {len(table) - count}.")
    return table.iloc[: len(table) - count]


def _is_empty(column: "pd.Series") -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    missing = column.isna().to_numpy(dtype=bool)
    if column.dtype.kind in "biuf":
        return missing
    texts = column.astype(str).str.strip().str.lower()
    return np.asarray(missing | texts.isin(["", "nan"]).to_numpy(dtype=bool))
