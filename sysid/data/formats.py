"""Tables that are no text: Parquet, MATLAB and npz files."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sysid.data.variables import Variable
from sysid.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

TEXT_SUFFIXES = frozenset({".csv", ".txt", ".tsv", ".dat", ".gz"})
SUFFIXES = {".parquet": "parquet", ".pq": "parquet", ".mat": "mat", ".npz": "npz"}
# First bytes of each format, for names that do not tell.  A MATLAB 7.3 file is HDF5 behind 512 bytes of text.
PARQUET, ZIP, HDF5, MATLAB_5, MATLAB_73 = (
    b"PAR1",
    b"PK\x03\x04",
    b"\x89HDF\r\n\x1a\n",
    b"MATLAB 5",
    b"MATLAB 7",
)
# Scalars that tell the sampling period, and those that tell its inverse.
PERIOD_NAMES = frozenset({"ts", "dt", "period", "sampling_period", "sampling_time"})
RATE_NAMES = frozenset({"fs", "sampling_rate", "sampling_frequency"})
PERIODS_AGREE = 1e-6
LISTED = 20


@dataclass(frozen=True)
class StoredTable:
    """The variables of a file, some of which are columns of one table.

    Attributes
    ----------
    path : Path
    variables : sequence of (str, Variable)
        In the order of the file; a name may come twice.
    """

    path: Path
    variables: Sequence[tuple[str, Variable]]

    def columns(self, wanted: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the columns of the table that has the wanted ones.

        Raises
        ------
        DataError
            If a wanted variable can be no column or has another length than the others.
        """
        usable = [(name, variable) for name, variable in self.variables if not variable.objection]
        if not usable:
            held = ", ".join(name for name, _ in self.variables[:LISTED]) or "nothing"
            raise DataError(
                f"{self.path.name} holds no column ({held}): "
                "a column is a variable of n x 1 numbers, one value for each row"
            )
        known = dict(self.variables)
        found = [(name, known[name]) for name in wanted if name in known]
        for name, variable in found:
            if variable.objection:
                raise DataError(f"{self.path.name}: variable {name!r} {variable.objection}")
        for name, variable in found[1:]:
            if variable.length != found[0][1].length:
                raise DataError(
                    f"{self.path.name}: {found[0][0]!r} has {found[0][1].length} values and {name!r} has "
                    f"{variable.length}: columns of one record must have one length"
                )
        return tuple(
            name
            for name, variable in usable
            if len(found) < len(wanted) or variable.length == found[0][1].length
        )

    def read(self, names: Sequence[str], texts: Sequence[str]) -> "pd.DataFrame":
        """Return columns as a table; those in `texts` as text.

        Raises
        ------
        DataError
            If the file is damaged.
        """
        import pandas as pd

        known = dict(self.variables)
        table = {}
        for name in dict.fromkeys(names):
            values = guarded(self.path, known[name].load).reshape(-1)
            table[name] = _as_text(values) if name in texts else _as_numbers(values)
        return pd.DataFrame(table)

    def period(self) -> float | None:
        """Return the sampling period [s] that scalars such as ``Ts``, ``dt`` or ``fs`` tell.

        Raises
        ------
        DataError
            If two of them differ or one is no positive number.
        """
        found: list[tuple[str, float]] = []
        for name, variable in self.variables:
            short = name.rsplit(".", 1)[-1].lower()
            if variable.unusable or variable.length != 1 or short not in PERIOD_NAMES | RATE_NAMES:
                continue
            values = guarded(self.path, variable.load).reshape(-1)
            value = float(values[0]) if values.dtype.kind in "biuf" else np.nan
            if not (np.isfinite(value) and value > 0.0):
                raise DataError(
                    f"{self.path.name}: {name!r} is {values[0]} and should tell the sampling: it must be a "
                    "positive number; give the period in seconds (--period 0.01)"
                )
            found.append((name, 1.0 / value if short in RATE_NAMES else value))
        for name, period in found[1:]:
            if abs(period - found[0][1]) > PERIODS_AGREE * period:
                raise DataError(
                    f"{self.path.name}: {found[0][0]!r} tells a sampling period of {found[0][1]:g} s and "
                    f"{name!r} one of {period:g} s: give the period in seconds (--period 0.01)"
                )
        return found[0][1] if found else None


def stored_table(path: Path) -> StoredTable | None:
    """Open a Parquet, MATLAB or npz file; None for a text table or where there is no file.

    The suffix decides; the first bytes do for a suffix that is not known, and between the forms of
    MATLAB files.

    Raises
    ------
    DataError
        If the file is damaged or not what its name says.
    """
    if not path.is_file() or path.suffix.lower() in TEXT_SUFFIXES:
        return None
    head = guarded(path, lambda: _head(path))
    kind = SUFFIXES.get(path.suffix.lower()) or _sniffed(head)
    if kind is None:
        return None
    variables = guarded(path, lambda: _reader(kind, head)(path))
    return StoredTable(path, variables)


def guarded(path: Path, action: Callable[[], Any]) -> Any:
    """Do what reads a file; whatever a damaged one makes the reader raise becomes a `DataError`."""
    try:
        return action()
    except DataError:
        raise
    except Exception as problem:
        reason = " ".join(str(problem).split())[:160] or type(problem).__name__
        raise DataError(
            f"{path} cannot be read ({reason}): it is damaged, cut short or not what its name says; "
            "save it again"
        ) from None


def _head(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(600)


def _sniffed(head: bytes) -> str | None:
    if head.startswith(PARQUET):
        return "parquet"
    if head.startswith((MATLAB_5, MATLAB_73, HDF5)):
        return "mat"
    # Many formats are zip archives; the first member of an npz file is an array.
    name_size = int.from_bytes(head[26:28], "little")
    if head.startswith(ZIP) and head[30 : 30 + name_size].endswith(b".npy"):
        return "npz"
    return None


def _reader(kind: str, head: bytes) -> Callable[[Path], Sequence[tuple[str, Variable]]]:
    """Return what lists the variables; each format is imported when it is needed."""
    if kind == "parquet":
        from sysid.data.parquet import variables as read
    elif kind == "npz":
        from sysid.data.npz import variables as read
    elif HDF5 in (head[:8], head[512:520]):
        from sysid.data.matlab_hdf5 import variables as read
    else:
        from sysid.data.matlab import variables as read
    return read


def _as_numbers(values: NDArray[Any]) -> Any:
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    return values.astype(str).astype(object)


def _as_text(values: NDArray[Any]) -> Any:
    """Return text as a text table would hold it: whole numbers without a point."""
    if values.dtype.kind == "f" and np.isfinite(values).all() and (values == np.round(values)).all():
        return values.astype(np.int64).astype(str).astype(object)
    return values.astype(str).astype(object)
