"""Columns of Parquet files."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.variables import Variable, refused


def variables(path: Path) -> Sequence[tuple[str, Variable]]:
    """List the columns of a Parquet file."""
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        rows = file.metadata.num_rows
        return [(field.name, _variable(path, field, rows)) for field in file.schema_arrow]


def _variable(path: Path, field: Any, rows: int) -> Variable:
    import pyarrow.types as types

    kind = field.type.value_type if types.is_dictionary(field.type) else field.type
    if types.is_temporal(kind):
        return refused("holds dates: save the time as a number of seconds", (rows,))
    number = (
        types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or types.is_boolean(kind)
    )
    text = types.is_string(kind) or types.is_large_string(kind)
    if not (number or text or types.is_null(kind)):
        return refused(f"is of type {field.type}: a column holds plain numbers or text", (rows,))
    return Variable((rows,), _loader(path, field.name, as_text=text))


def _loader(path: Path, name: str, *, as_text: bool) -> Callable[[], NDArray[Any]]:
    def load() -> NDArray[Any]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        with pq.ParquetFile(path) as file:
            column = file.read(columns=[name]).column(name)
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if as_text:
            return np.asarray(["" if cell is None else cell for cell in column.to_pylist()], dtype=str)
        # Whole numbers beyond 2^53 lose digits here, as they do in a text table.
        values: NDArray[Any] = column.cast(pa.float64(), safe=False).to_numpy()
        return values

    return load
