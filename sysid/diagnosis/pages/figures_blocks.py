"""Frequency responses of the linear blocks of a model."""

from typing import TYPE_CHECKING, Any

from sysid.diagnosis.models.fitted_model import BlockResponse
from sysid.diagnosis.pages.drawing import WIDE, legend
from sysid.reporting.style import COLOURS, LINE_STYLES, subplots

if TYPE_CHECKING:
    pass

HEIGHT = 3.1
# Decades that the gains reach down from the largest one.
DECADES = 5


def blocks_figure(responses: tuple[BlockResponse, ...], width: float = WIDE) -> tuple[Any, str, str]:
    """Draw the gains of the blocks with their 95 % bands.

    Parameters
    ----------
    responses : tuple of BlockResponse
    width : float
        Width of the figure [inch].
    """
    figure, axes = subplots(1, 1, width=width, height=HEIGHT)
    top = max(float(response.upper.max()) for response in responses)
    for number, response in enumerate(responses):
        floor = top * 10.0 ** (-DECADES - 1)
        lower, upper = (band.clip(min=floor) for band in (response.lower, response.upper))
        axes.fill_between(response.frequency, lower, upper, color=COLOURS[number], alpha=0.25, linewidth=0)
        axes.loglog(
            response.frequency,
            response.gain,
            color=COLOURS[number],
            linestyle=LINE_STYLES[number],
            label=response.name,
        )
    axes.set_ylim(top * 10.0**-DECADES, 2.0 * top)
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("gain")
    legend(axes)
    reading = "Shaded: 95 % bands; the gains are one at zero frequency by convention."
    return figure, "Frequency responses of the linear blocks", reading
