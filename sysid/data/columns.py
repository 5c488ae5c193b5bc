"""The columns of a table that a record is made of."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

from sysid.data.units import named_units
from sysid.errors import DataError, UsageError

TIME_COLUMN = "t"
LISTED_COLUMNS = 20


@dataclass(frozen=True)
class Wanted:
    """Names of the columns that are asked for.

    Attributes
    ----------
    inputs, outputs : tuple of str
    time, split, experiment : str or None
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    time: str | None = None
    split: str | None = None
    experiment: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        others = (self.time, self.split, self.experiment)
        return (*self.inputs, *self.outputs, *(name for name in others if name is not None))

    @property
    def texts(self) -> tuple[str, ...]:
        """Those that hold text."""
        return tuple(name for name in (self.split, self.experiment) if name is not None)

    def with_sets(self, split: str, experiment: str) -> "Wanted":
        """Return the same with columns of split and experiment where none is asked for."""
        return replace(self, split=self.split or split, experiment=self.experiment or experiment)

    def spelt(self, columns: Sequence[str]) -> "Wanted":
        """Return the same with names as a table has them, units included: ``u`` may stand as ``u [V]``.

        Examples
        --------
        >>> Wanted(("u",), ("y",)).spelt(["u [V]", "y", "y [m]"])
        Wanted(inputs=('u [V]',), outputs=('y',), time=None, split=None, experiment=None)
        """
        plain: dict[str, list[str]] = {}
        for name, unit in named_units(columns).items():
            plain.setdefault(name[:-1].rstrip().removesuffix(unit).rstrip(" [("), []).append(name)

        def found(name: str) -> str:
            same = plain.get(name, [])
            return same[0] if name not in columns and len(same) == 1 else name

        return Wanted(
            tuple(map(found, self.inputs)),
            tuple(map(found, self.outputs)),
            *(name and found(name) for name in (self.time, self.split, self.experiment)),
        )

    def found_in(self, path: Path, columns: Sequence[str]) -> tuple[tuple[str, ...], str | None]:
        """Return the names to be read, and the time column among them.

        A column ``t`` that is not asked for is taken along to tell where experiments restart.

        Raises
        ------
        DataError, UsageError
            If a column is not there, is there twice or is asked for twice.
        """
        for name in self.names:
            _check_present(path, name, columns)
        both = set(self.inputs) & set(self.outputs)
        if both:
            raise UsageError(f"column {both.pop()!r} is both input and output: choose one of the two")
        for name in self.inputs:
            if (times := self.inputs.count(name)) > 1:
                raise UsageError(f"column {name!r} is given {times} times as input: give it once")
        if self.time is not None:
            return self.names, self.time
        clock = Wanted((), (), TIME_COLUMN).spelt(columns).time
        if clock is not None and columns.count(clock) == 1 and clock not in self.names:
            return (*self.names, clock), clock
        return self.names, None


def _check_present(path: Path, name: str, columns: Sequence[str]) -> None:
    if name not in columns:
        if list(columns) == [str(1 + place) for place in range(len(columns))]:
            raise UsageError(
                f"{path.name} has no column {name!r}: its first row is all numbers, so its {len(columns)} "
                "columns are named by their place; choose them so, such as --input 1 --output 2, or add a "
                "header row"
            )
        near = _nearest(name, columns)
        guess = f"; did you mean {near!r}?" if near else ":"
        more = len(columns) - LISTED_COLUMNS
        listed = ", ".join(columns[:LISTED_COLUMNS]) + (f" and {more} more" if more > 0 else "")
        raise UsageError(f"{path.name} has no column {name!r}{guess} it has {listed}")
    if columns.count(name) > 1:
        raise DataError(f"{path.name} has {columns.count(name)} columns named {name!r}: rename one")


def _nearest(name: str, columns: Sequence[str]) -> str | None:
    """Return the column that was perhaps meant; upper and lower case count as equal."""
    folded = {column.casefold(): column for column in reversed(columns)}
    near = get_close_matches(name.casefold(), list(folded), n=1, cutoff=0.5)
    return folded[near[0]] if near else None
