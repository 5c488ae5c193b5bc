"""Figures of the comparison page."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

from sysid.diagnosis.comparison.summary import FEWEST_TESTED_ROWS
from sysid.diagnosis.models.fitted_model import Mapped, Responding
from sysid.diagnosis.pages.drawing import Picture, drawn_picture
from sysid.diagnosis.pages.figures_blocks import blocks_figure
from sysid.diagnosis.pages.figures_residual import correlations, orders, spectrum
from sysid.diagnosis.pages.figures_run import overview, worst_stretch
from sysid.diagnosis.pages.figures_where import (
    further_windows,
    new_error_curves,
    residual_curves,
    shares,
    worst_windows,
)

if TYPE_CHECKING:
    from sysid.diagnosis.comparison.judgement import Judgement
    from sysid.diagnosis.models.fitted_model import FittedModel, PortView


def pictures(comparison: "Judgement") -> dict[str, list[Picture]]:
    """Draw all figures of the page, by section."""
    found: dict[str, list[Picture]] = {
        "run": [_picture(comparison, overview, 4.3), _picture(comparison, worst_stretch, 4.6)],
        "maps": map_pictures(comparison.model),
        "blocks": block_pictures(comparison.model),
        "where": [],
        "ports": port_pictures(comparison.ports),
        "tests": [],
        "model": [],
    }
    if comparison.location.shares:
        found["where"] = [
            _picture(comparison, draw, 4.0) for draw in (shares, residual_curves, new_error_curves)
        ]
    if further_windows(comparison):
        found["where"].append(_picture(comparison, worst_windows, 3.6))
    if comparison.score_of(comparison.judged).n_rows >= FEWEST_TESTED_ROWS:
        found["tests"] = [_picture(comparison, draw, 3.1) for draw in (spectrum, correlations)]
    if len({c.order for c in comparison.model.candidates}) > 1:
        found["model"] = [_picture(comparison, orders, 3.0)]
    return found


def port_pictures(ports: "tuple[PortView, ...]") -> list[Picture]:
    """Draw the free-form curves, if there are any."""
    from sysid.diagnosis.pages.figures_ports import ports_picture
    from sysid.diagnosis.ports import PortCurve

    curves = [port for port in ports if isinstance(port, PortCurve) and port.value.size]
    return [ports_picture(curves)] if curves else []


def map_pictures(model: "FittedModel") -> list[Picture]:
    """Draw the maps that are part of the model, if there are any."""
    from sysid.diagnosis.pages.figures_ports import map_figure

    if not isinstance(model, Mapped):
        return []
    return [drawn_picture(partial(map_figure, view)) for view in model.maps()]


def block_pictures(model: "FittedModel") -> list[Picture]:
    """Draw the frequency responses of the model's linear blocks, if it has several."""
    if not isinstance(model, Responding):
        return []
    return [drawn_picture(partial(blocks_figure, model.responses()))]


Drawer = Callable[["Judgement", float, float], tuple[Any, str, str]]


def _picture(comparison: "Judgement", draw: Drawer, height: float) -> Picture:
    return drawn_picture(lambda width: draw(comparison, width, height))
