"""A comparison as it is handed on: in words, as JSON, as a page."""

from functools import cached_property
from typing import TYPE_CHECKING, Any

from sysid.diagnosis.comparison.judgement import Judgement
from sysid.diagnosis.comparison.summary import data_json, model_json, sentences

if TYPE_CHECKING:
    from sysid.diagnosis.pages.content import Content


class Comparison(Judgement):
    """A model beside the measurements it was not fitted to.

    Its data are those of `sysid.diagnosis.comparison.judgement.Judgement`.
    """

    @classmethod
    def of(cls, judgement: Judgement) -> "Comparison":
        """Return the comparison with the data of a judgement."""
        return cls(**vars(judgement))

    def sentences(self) -> list[str]:
        """Say what was found, the main thing first."""
        return sentences(self)

    def to_json(self) -> dict[str, Any]:
        """Return what the JSON file holds: plain values, no NaN."""
        return {
            "schema": 1,
            "model": model_json(self),
            "scores": {s.name: s.to_json() for s in self.scores},
            "noise_floor": self.noise_floor.to_json(),
            "where": [finding.to_json() for finding in self.where],
            "shares": self.location.to_json(),
            "tests": {name: test.to_json() for name, test in self.tests.items()}
            | {"distortion": self.distortion.to_json()},
            "ports": [port.to_json() for port in self.ports],
            "warnings": list(self.warnings),
            "data": data_json(self.record),
            "sentences": self.sentences(),
        }

    @cached_property
    def content(self) -> "Content":
        """What page and PDF show, its figures drawn once."""
        from sysid.diagnosis.pages.content import content_of

        return content_of(self)

    def to_html(self) -> str:
        """Return the page as one self-contained HTML text."""
        from sysid.diagnosis.pages.page import render

        return render(self.content)

    def to_pdf(self) -> bytes:
        """Return the same content as a PDF."""
        from sysid.diagnosis.pages.document import render_pdf

        return render_pdf(self.content)

    def __repr__(self) -> str:
        return "\n".join(
            [
                f"Comparison of {self.record.name!r} with model {self.model.name!r}",
                *("  " + s for s in self.sentences()),
            ]
        )
