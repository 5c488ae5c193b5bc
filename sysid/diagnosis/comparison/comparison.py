"""What a comparison hands on: a model with its scores, tests and findings on held-out rows."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from sysid.data import Record
from sysid.diagnosis.comparison.noise import NoiseFloor
from sysid.diagnosis.comparison.periods import Distortion
from sysid.diagnosis.comparison.residuals import CorrelationTest
from sysid.diagnosis.comparison.scores import SetScore
from sysid.diagnosis.comparison.series import Series
from sysid.diagnosis.comparison.summary import data_json, model_json, sentences
from sysid.diagnosis.comparison.where import Finding, Location
from sysid.diagnosis.models.fitted_model import FittedModel

if TYPE_CHECKING:
    from sysid.diagnosis.models.fitted_model import PortView
    from sysid.diagnosis.pages.content import Content
    from sysid.linear.simulation import Prediction


@dataclass(frozen=True)
class Comparison:
    """A model beside the measurements it was not fitted to.

    Attributes
    ----------
    record : Record
    model : FittedModel
    prediction : Prediction
        Of the final model, over all rows.
    scores : tuple of SetScore
        Estimation, validation, and each test set.
    judged : str
        The set of rows that the sentences, tests and findings speak of: the first test set or,
        without any, the validation rows.
    noise_floor : NoiseFloor
    series : Series
        Residual and signals on the judged rows.
    tests : mapping of str to CorrelationTest
    distortion : Distortion
        Even and odd nonlinear distortion, where the input is periodic and leaves lines out.
    location : Location
        Where the error lies: findings, and the shares that are drawn.
    warnings : tuple of str
    ports : tuple of PortView
        Free-form curves at the ports of the model, if they were explored.
    """

    record: Record
    model: FittedModel
    prediction: "Prediction"
    scores: tuple[SetScore, ...]
    judged: str
    noise_floor: NoiseFloor
    series: Series
    tests: dict[str, CorrelationTest]
    distortion: Distortion
    location: Location
    warnings: tuple[str, ...]
    ports: "tuple[PortView, ...]" = ()

    @property
    def where(self) -> tuple[Finding, ...]:
        """Findings: where the error is concentrated, beyond chance and by enough to matter."""
        return self.location.findings

    def score_of(self, name: str) -> SetScore:
        """Return the scores of one set of rows."""
        return next(s for s in self.scores if s.name == name)

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
