"""A diagnosis as it is handed on: in words, as JSON, as a page, as files."""

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.diagnosis.effects.base import Effect
from sysid.diagnosis.ladder import DiagnosedModel
from sysid.diagnosis.outcome import Outcome
from sysid.diagnosis.pages.report_words import sentences
from sysid.result_files import finite

if TYPE_CHECKING:
    from pathlib import Path

    from sysid.diagnosis.pages.content import Content


class Diagnosis(Outcome):
    """What a model lacks, with the evidence; its data are those of `sysid.diagnosis.outcome.Outcome`."""

    def add(self, *effects: str | Effect) -> DiagnosedModel:
        """Return the final model with further effects, to be fitted by ``.fit()``."""
        return self.final.add(*effects)

    def sentences(self) -> list[str]:
        """Say what was found, the main thing first."""
        return sentences(self)

    def to_html(self) -> str:
        """Return the page as one self-contained HTML text."""
        from sysid.diagnosis.pages.page import render

        return render(self.content)

    def to_pdf(self) -> bytes:
        """Return the same content as a PDF."""
        from sysid.diagnosis.pages.document import render_pdf

        return render_pdf(self.content)

    @cached_property
    def content(self) -> "Content":
        """What page and PDF show, its figures drawn once."""
        from sysid.diagnosis.pages.diagnose_page import content_of

        return content_of(self)

    def to_json(self) -> dict[str, Any]:
        """Return what the JSON file holds: plain values, no NaN."""
        from sysid import __version__

        record = self.record
        spread = float(np.std(record.y[record.learning, 0])) or 1.0
        return {
            "schema": 1,
            "verdict": self.verdict,
            "accepted": list(self.accepted),
            "ranked": self.ranked(),
            "tie": list(self.decision.tie),
            "ladder": [rung.to_json() for rung in self.ladder],
            "noise_floor": {
                "rmse": finite(self.noise_floor),
                "nrmse": finite(self.noise_floor / spread),
                "method": "what neither the final model nor any probe of it explains",
            },
            "where": [finding.to_json() for finding in self.where],
            "ports": [port.to_json() for port in self.ports],
            "advice": self.advice,
            "search": {"complete": not self.decision.cut_short},
            "left": {
                "p_value": finite(self.decision.left_p_value),
                "share": finite(self.decision.left_share),
                "rejected": list(self.decision.rejected),
            },
            "sentences": self.sentences(),
            "warnings": list(record.warnings),
            "seconds": self.seconds,
            "versions": {"sysid": __version__, "numpy": np.__version__},
        }

    def draft(self) -> str:
        """Return the best free-form curve as an effect in TOML, to be edited; empty if there is none."""
        from sysid.diagnosis.drafts import draft_of

        return draft_of(self.ports, self.record, self.structure)

    def write_predictions(self, path: "Path") -> None:
        """Write the predictions as CSV: k, measured, baseline, final, one row for each row of the file."""
        from sysid.result_files import to_csv_text, write_text

        columns = {name: values.tolist() for name, values in self.predictions().items()}
        write_text(path, to_csv_text(columns, self.record.left_out))

    def __repr__(self) -> str:
        return "\n".join(
            [f"Diagnosis of {self.record.name!r}: {self.verdict}", *("  " + s for s in self.sentences())]
        )
