"""Write a physical model with effects as Python source that needs NumPy alone.

The source holds the very functions that simulate the model here, uncompiled, with its coefficients.
"""

import inspect
from typing import Any

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.input_maps import SWITCHES
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel
from sysid.diagnosis.export.standalone import helpers_for, map_source
from sysid.errors import ModelError
from sysid.physics import forced_kernels as fk
from sysid.physics import linear_kernels
from sysid.physics.forced import MOST_STATES, ForcedPlant
from sysid.physics.own_laws import source_of

_LINEAR = ("multiplied", "exponential", "linear_runs")
_FORCED = (
    "sliding_friction", "smooth_force", "outflow", "rates", "spilled", "moved", "kept", "fourth_order_step",
    "called_step", "holding_force", "breaking_force", "margin", "mode_at_zero", "time_of_event", "cut_step",
    "forced_runs",
)  # fmt: skip
_NUMBERS = (
    "A", "STEADY", "DRIVE", "PUSH", "READ", "FRICTION_FORWARD", "FRICTION_BACK", "BREAKAWAY",
    "STRIBECK_SPEED", "DRAG", "CUBIC", "GRAVITY", "WAVE_NUMBER", "CONSTANT", "ELASTIC", "YIELD", "GAIN",
    "GAIN_SCALE", "FIRST_POWER", "SECOND_POWER", "FIRST_CAP", "SECOND_CAP", "CAUGHT", "LOOP_BEND", "OWN",
    "SIZE", "SMOOTH", "STUCK", "MOST_STATES", "MOST_EVENTS", "MOST_CHATTER", "ROOT_STEPS", "EVENT_TOLERANCE",
)  # fmt: skip


def source(saved: SavedPhysicalModel) -> str:
    """Return the source of ``simulate(u)``."""
    plant = saved.plant
    if not isinstance(plant, ForcedPlant) or plant.hold != "zero":
        kind = "is not linear in its states" if plant.hold == "zero" else "takes its input as smooth"
        raise ModelError(f"model {saved.model.name!r} {kind}: save it as JSON instead")
    values, laws = saved.values[np.newaxis], saved.law[np.newaxis]
    plants, by_input, direct = plant.coefficients(values, laws, saved.own_law)
    start = np.zeros(MOST_STATES)
    start[: plant.order] = np.array([state.rest for state in saved.model.states])[list(plant.states_first)]
    maps = {port: _maps(saved, port) for port in ("input", "parallel", "output")}
    module, names = (linear_kernels, _LINEAR) if saved.exact else (fk, _FORCED)
    lines = [
        '"""Simulation of an identified model; NumPy is all it needs."""\n',
        "from __future__ import annotations\n",
        "import math\n",
        "import numpy as np\n",
        f"T = {saved.period!r}",
        f"N, SUBSTEPS, SAME = {plant.order}, {saved.substeps}, {plant.same}",
        f"PLANT = np.array({_numbers(plants)})",
        f"BY_INPUT = np.array({_numbers(by_input)})",
        f"DIRECT = np.array({_numbers(direct)})",
        f"START = np.array([{_numbers(start)}])",
        *(f"{name} = {np.asarray(getattr(fk, name)).item()!r}" for name in _NUMBERS),
        "\n",
        *helpers_for("".join(maps.values())),
        *(_plain(getattr(module, name)) + "\n" for name in names),
        *([] if saved.exact else [_own(saved)]),
        _SIMULATE.format(
            inner=_RUN_LINEAR if saved.exact else _RUN_FORCED, **{k: v or "" for k, v in maps.items()}
        ),
    ]
    return "\n".join(lines)


_RUN_LINEAR = "linear_runs(PLANT, N, BY_INPUT, DIRECT, driven, START, T, y, inner)"
_RUN_FORCED = (
    "forced_runs(PLANT, N, SAME, BY_INPUT, DIRECT, driven, START, T / SUBSTEPS, SUBSTEPS, y, inner, own)"
)
_SIMULATE = '''
def simulate(u):
    """Return the output for an input, from rest; several inputs as columns."""
    u = np.asarray(u, dtype=float)
    columns = u.reshape(u.shape[0], -1)
    s = columns[:, 0]
{input}    acting = s
    driven = np.column_stack([acting, columns[:, 1:]])[np.newaxis]
    y, inner = np.empty((1, u.shape[0])), np.empty((1, 0, 4))
    {inner}
    y = y[0]
{parallel}    s = y
{output}    return s
'''


def _own(saved: SavedPhysicalModel) -> str:
    """Return the source of the user's own laws."""
    text = source_of(saved.own_law)
    return text[text.index("def ") :]


def _maps(saved: SavedPhysicalModel, port: str) -> str:
    lines = []
    for choice, p in zip(saved.choices, saved.own, strict=True):
        if choice.effect.port != port:
            continue
        levelled = choice.name in SWITCHES and choice.form.parameters[-1].name == "level"
        numbers = p[:-1].tolist() if levelled else p.tolist()
        text = map_source(choice)
        text = f"{p[-1]!r} * ({text})" if levelled else text
        lines += [f"    p = {numbers!r}", f"    s = {text}"]
        if port == "parallel":
            begins = "acting" if choice.form.behind else "columns[:, 0]"
            lines = [*lines[:-2], f"    s = {begins}", *lines[-2:], "    y = y + s"]
    return "".join(line + "\n" for line in lines)


def _numbers(values: Floats) -> str:
    return repr(values.tolist()).replace("inf", "np.inf").replace("nan", "np.nan")


def _plain(kernel: Any) -> str:
    """Return the source of a kernel without its decorator."""
    text = inspect.getsource(kernel.py_func)
    return text[text.index("def ") :]
