"""Where a diagnosed model falls short, and free-form curves of what no candidate explains."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sysid.diagnosis.comparison.series import judged_series
from sysid.diagnosis.comparison.where import Finding, locate
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.ports.plants import PORTS
from sysid.diagnosis.structures.structure import Choice, Structure
from sysid.errors import SysidError
from sysid.physics.expressions import symbols
from sysid.physics.grammar import parse

if TYPE_CHECKING:
    from sysid.data import Record
    from sysid.diagnosis.ports import PortCurve

# A curve of free form that leaves less than this share of what a named force leaves has found another law.
RESEMBLED = 0.8


def where_it_fails(record: "Record", free_run: Floats, judged: str) -> tuple[Finding, ...]:
    """Return where the error of a free run is concentrated, tested over all looks together.

    Parameters
    ----------
    record : Record
    free_run : ndarray, shape (n_samples,)
    judged : str
        A test set or ``"validation"``.

    Returns
    -------
    tuple of Finding
    """
    rows = record.validation if judged == "validation" else record.scored_rows(judged)
    return locate(judged_series(record, judged, rows, free_run, delay=1)).findings


def outdone(record: "Record", decision: Decision, curves: "Sequence[PortCurve]") -> bool:
    """Tell whether a single free-form curve at a port explains more of a record than the named effects.

    Then these only resemble it together, each in its part of the range: look-alikes.

    Parameters
    ----------
    record : Record
    decision : Decision
    curves : sequence of PortCurve
        Of the model without effects.
    """
    before, *_, after = _held_out_errors(record, decision)
    best = max((curve.explains_at_most for curve in curves), default=0.0)
    return bool(before > 0.0 and best > 1.0 - after / before)


def only_resembled(structure: Structure, decision: Decision) -> bool:
    """Tell whether a single named force only resembles what is missing, and noise was to explain the rest.

    At the place of the true law no curve of free form does better, but for chance; one that leaves clearly
    less on held-out rows says that the force depends on the same motion by another law.

    Parameters
    ----------
    structure : Structure
    decision : Decision
        That effects are missing.
    """
    port = _port_of(decision.final.choices[-1]) if len(decision.fits) == 1 else ""
    if decision.given or NOISE_EFFECT not in decision.accepted or not port:
        return False
    before, after = _held_out_errors(structure.record, decision)
    curves = curves_at_ports(structure, [port])
    return any((1.0 - curve.explains_at_most) * before < RESEMBLED * after for curve in curves)


def _port_of(choice: Choice) -> str:
    """Return the port at which a curve of free form holds the law of a force, empty for none."""
    form = choice.form
    if choice.effect.port != "force" or choice.effect.dry or form.state:
        return ""
    law = parse(form.expression, {"x", "v", *(parameter.name for parameter in form.parameters)})
    depends = symbols(law) & {"x", "v"}
    return "" if len(depends) != 1 else {"x": "position", "v": "velocity"}[min(depends)]


def each_counts(record: "Record", decision: Decision) -> bool:
    """Tell whether each effect in its turn takes more off the held-out error than what is left unexplained.

    One that does less is no finding beside it: it may as well be part of what follows the unexplained.
    """
    errors = _held_out_errors(record, decision)
    gains = -np.diff(errors)[len(decision.given) :]
    return bool((gains > decision.left_share * errors[0]).all())


def _held_out_errors(record: "Record", decision: Decision) -> Floats:
    """Return the sum of squared errors on validation rows: without effects, with one, two, ..."""
    rows, y = record.validation, record.y[:, 0]
    fits = (decision.baseline, *(decision.fits or (decision.baseline,)))
    return np.array([np.sum((y - fit.output)[rows] ** 2) for fit in fits])


def curves_at_ports(structure: Structure, ports: Sequence[str] = PORTS) -> "tuple[PortCurve, ...]":
    """Fit a free-form curve at ports of the model without effects, what explains most first.

    Models whose ports cannot be opened have none.

    Parameters
    ----------
    structure : Structure
        Of a linear or physical model.
    ports : sequence of {"input", "output", "position", "velocity"}

    Returns
    -------
    tuple of PortCurve
    """
    from sysid.diagnosis.linear.structure import LinearStructure
    from sysid.diagnosis.physics.structure import PhysicsStructure
    from sysid.diagnosis.ports import explore_ports
    from sysid.linear import fit_output_error
    from sysid.physics import fit_physics

    record = structure.record
    try:
        if isinstance(structure, LinearStructure):
            start = "estimate" if structure.free_start else "rest"
            linear = fit_output_error(record, structure.order, initial_state=start)
            return explore_ports(record, linear, ports=ports)
        if isinstance(structure, PhysicsStructure):
            start = "estimate" if structure.free_start else "rest"
            physical = fit_physics(record, structure.model, initial_state=start)
            return explore_ports(record, physical, ports=ports)
    except SysidError:
        return ()
    return ()
