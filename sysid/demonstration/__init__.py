"""Records with a hidden effect, to try the diagnosis on; simulators apart from the fitted models."""

from sysid.demonstration.cases import CANDIDATES, FURTHER, Case, Difficulty, draw_case, simulate
from sysid.demonstration.effects import FOREIGN, Hidden
from sysid.demonstration.plants import MODELS, Inside, Plant, draw_plant

__all__ = [
    "CANDIDATES",
    "FOREIGN",
    "FURTHER",
    "MODELS",
    "Case",
    "Difficulty",
    "Hidden",
    "Inside",
    "Plant",
    "draw_case",
    "draw_plant",
    "simulate",
]
