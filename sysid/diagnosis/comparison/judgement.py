"""What judging a model comes to: scores, tests and findings on held-out rows, as plain data."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sysid.data import Record
from sysid.diagnosis.comparison.noise import NoiseFloor
from sysid.diagnosis.comparison.periods import Distortion
from sysid.diagnosis.comparison.scores import SetScore
from sysid.diagnosis.comparison.series import Series
from sysid.diagnosis.comparison.where import Finding, Location
from sysid.diagnosis.models.fitted_model import FittedModel
from sysid.diagnosis.residuals import EXACT, CorrelationTest

if TYPE_CHECKING:
    from sysid.diagnosis.models.fitted_model import PortView
    from sysid.linear.simulation import Prediction


@dataclass(frozen=True)
class Judgement:
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
        exact = self.score_of(self.judged).free_run.nrmse < EXACT
        return () if exact else self.location.findings

    def score_of(self, name: str) -> SetScore:
        """Return the scores of one set of rows."""
        return next(s for s in self.scores if s.name == name)
