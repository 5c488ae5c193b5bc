"""Printing errors of any paper: the record, its numbers, its gates and how the report shows it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid import gates as gate
from sysid.gates import Gate

if TYPE_CHECKING:
    from sysid.reporting.display import Display

CORRECTED_TOLERANCE = 1e-10
"""Corrected forms agree with their independent evaluation to this; quadrature is good to 1e-12."""


@dataclass(frozen=True)
class Erratum:
    """One printing error.

    Attributes
    ----------
    id, where : str
        Name, and place in the paper.
    printed, corrected : str
        The formulas, in LaTeX or words.
    measure : str
        What the two errors measure.
    printed_error, corrected_error : float
        How far the printed and the corrected form are from the independent evaluation.
    note : str
        What it means.
    """

    id: str
    where: str
    printed: str
    corrected: str
    measure: str
    printed_error: float
    corrected_error: float
    note: str

    def to_json(self) -> dict[str, object]:
        """Return the fields; an infinite error becomes the string "infinite"."""
        fields = dict(self.__dict__)
        if not np.isfinite(self.printed_error):
            fields["printed_error"] = "infinite"
        return fields


def erratum_numbers(found: Sequence[Erratum]) -> dict[str, float]:
    """Return the errors of printed and corrected forms by name."""
    numbers = {f"erratum/{erratum.id}/printed": erratum.printed_error for erratum in found}
    return numbers | {f"erratum/{erratum.id}/corrected": erratum.corrected_error for erratum in found}


def erratum_gates(found: Sequence[Erratum]) -> list[Gate]:
    """Require every printed form to be wrong and its correction right."""
    gates = []
    for erratum in found:
        name, measure = f"erratum/{erratum.id}", erratum.measure
        gates.append(
            gate.at_most(f"{name}/corrected", erratum.corrected_error, CORRECTED_TOLERANCE, "exact", measure)
        )
        printed = min(erratum.printed_error, np.finfo(float).max)
        gates.append(gate.at_least(f"{name}/printed", printed, 1e-2, "exact", measure))
    return gates


def show_errata(results: Mapping[str, Any], paper: str) -> "Display":
    """Show every printing error of a paper with its numbers."""
    from sysid.reporting import display

    parts = []
    for entry in results["papers"][paper]["tables"]["errata"]:
        printed = entry["printed_error"]
        parts.append(
            display.group(
                display.prose(
                    f"### {entry['where']}\n\nPrinted:\n\n$$ {entry['printed']} $$\n\n"
                    f"Right:\n\n$$ {entry['corrected']} $$"
                ),
                display.table(
                    [
                        [
                            printed if isinstance(printed, str) else float(printed),
                            float(entry["corrected_error"]),
                        ]
                    ],
                    ["as printed", "corrected"],
                    caption=f"{entry['measure'][0].upper()}{entry['measure'][1:]}.",
                    align="rr",
                    formats={"corrected": ".1e"},
                ),
                display.prose(entry["note"]),
            )
        )
    return display.group(*parts)
