"""Effects at a port that need no more than the sample they map."""

from collections.abc import Sequence

from sysid.diagnosis.structures.structure import Choice
from sysid.errors import ModelError

MEMORY = ("in_backlash", "in_delay", "in_rate_limit", "in_hysteresis", "out_delay", "out_lowpass")
TIMED = ("out_drift", "time_variation")


def check_pointwise(choices: Sequence[Choice]) -> None:
    """Raise ModelError if an effect at a port needs more than the sample it maps."""
    for choice in choices:
        if choice.effect.port == "parallel" or choice.name in (*MEMORY, *TIMED):
            raise ModelError(
                f"effect {choice.name!r} has a memory of its own: use simulate of the saved model instead"
            )
