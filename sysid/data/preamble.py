"""Where the table begins in a text that has more than the table: what instruments write above it."""

import csv
from collections.abc import Sequence
from typing import NamedTuple

SEPARATORS = (";", "\t", ",", "|")
WHITE_SPACE = r"\s+"
# So many rows of numbers make a table.
ROWS = 3


class Table(NamedTuple):
    """First line of a table, its header if it has one, and what separates its cells."""

    first: int
    separator: str


def found_table(
    lines: Sequence[str], before: int, separators: Sequence[str], decimal: str | None
) -> Table | None:
    """Return where a table of numbers begins, its header with it; None where there is no such thing.

    Parameters
    ----------
    lines : sequence of str
        Whole lines from the beginning of the file.
    before : int
        Lines that are known not to belong to it.
    separators : sequence of str
    decimal : str, optional
        Decimal sign, if it is known.

    Examples
    --------
    >>> lines = ["Operator,J. Smith", "Date,2019-05-03", "", "t,u,y", "0,1,2", "1,1,2", "2,0,2"]
    >>> found_table(lines, 0, SEPARATORS, None)
    Table(first=3, separator=',')
    >>> found_table(lines[3:], 0, SEPARATORS, None)
    Table(first=0, separator=',')
    """
    for separator in (*separators, WHITE_SPACE):
        sizes = [_size(line, separator, decimal) for line in lines]
        first = _first_row(sizes, before)
        if first is None:
            continue
        header = _header(lines, sizes, before, first)
        return Table(header, separator)
    return None


class _Size(NamedTuple):
    """Cells of a line, those before the empty ones at its end, and those that are numbers."""

    cells: int
    filled: int
    numbers: int

    def as_wide_as(self, other: "_Size") -> bool:
        return self.cells == other.cells or self.filled == other.filled


def _header(lines: Sequence[str], sizes: Sequence[_Size], before: int, first: int) -> int:
    """Return the header above a first row, or the first of the rows of numbers if there is none."""
    top = first
    names: list[int] = []
    for i in reversed([i for i in range(before, first) if lines[i].strip()]):
        if not sizes[i].as_wide_as(sizes[first]) or (names and sizes[i].numbers):
            break
        if sizes[i].numbers:
            top = i
        else:
            names.append(i)
    # A header and a row of units below it; of more such lines all but the last are none of the table's.
    return names[-1] if len(names) in (1, 2) else names[0] if names else top


def _first_row(sizes: Sequence[_Size], before: int) -> int | None:
    """Return the first of the rows of numbers that go on to the end: as many cells, as many numbers."""
    for i in range(before, len(sizes) - ROWS + 1):
        size = sizes[i]
        if size.filled > 1 and size.numbers and all(size == other for other in sizes[i : i + ROWS]):
            return i
    return None


def _size(line: str, separator: str, decimal: str | None) -> _Size:
    if separator == WHITE_SPACE:
        cells = line.split()
    else:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    filled = max((place for place, cell in enumerate(cells, start=1) if cell.strip()), default=0)
    comma = "," if decimal is None and separator != "," else decimal or "."
    return _Size(len(cells), filled, sum(is_number(cell.strip().replace(comma, ".")) for cell in cells))


def is_number(cell: str) -> bool:
    """Tell whether a cell holds a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
