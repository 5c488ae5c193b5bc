"""Where a diagnosed model falls short, and free-form curves of what no candidate explains."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sysid.data.record import Mask
from sysid.diagnosis.comparison.series import judged_series
from sysid.diagnosis.comparison.where import Finding, locate
from sysid.diagnosis.decide.decision import NOISE_EFFECT, Decision
from sysid.diagnosis.decide.residual_evidence import SEEN_P_VALUE
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.ports.plants import PORTS
from sysid.diagnosis.structures.pointwise import MEMORY, TIMED
from sysid.diagnosis.structures.structure import Choice, Structure, StructureFit
from sysid.errors import SysidError
from sysid.physics.expressions import symbols
from sysid.physics.grammar import parse

if TYPE_CHECKING:
    from sysid.data import Record
    from sysid.diagnosis.ports import PortCurve

# At the place of a law a curve of free form that leaves less than this share of its error is another law.
RESEMBLED = 0.9
# Every curve holds these: a constant, which is most of what a slow drift does over a set of rows.
CONSTANTS, ANYWHERE = ("out_offset", "constant_force", "out_drift"), "anywhere"


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
    before, *_, after = _errors(record, decision, record.validation)
    return any(_left(curve, before) < after for curve in curves)


def is_doubtful(decision: Decision) -> bool:
    """Tell whether the names that were found are held against curves of free form.

    Two or more may share out between them what one law is, and noise with a memory may be what a law leaves
    of another, as may a rest that is not quite what noise leaves.
    """
    if decision.given or not decision.fits:
        return False
    several, coloured = len(decision.fits) > 1, NOISE_EFFECT in decision.accepted
    return several or coloured or decision.left_p_value < SEEN_P_VALUE


def resembled(record: "Record", decision: Decision, curves: "Sequence[PortCurve]") -> "PortCurve | None":
    """Return the curve that says that the named effects only resemble what is missing, if one does.

    At the place of a true law no curve of free form does better, but for chance: there it must leave clearly
    less on held-out rows.  Where effects are at several places no single curve leaves about what all leave,
    and less than all but one, unless they share out between them what it is.  A curve that holds the true law
    does so on the rows it was fitted to as well: held-out rows alone are few, and it may be lucky on them.

    Parameters
    ----------
    record : Record
    decision : Decision
        That effects are missing.
    curves : sequence of PortCurve
        Of the model without effects.
    """
    held_out = _errors(record, decision, record.validation)
    fitted = _errors(record, decision, record.estimation)
    places = {_port_of(choice) for choice in decision.final.choices} - {ANYWHERE}
    if all(curve.port != "position" for curve in curves):  # the motion that forces depend on is one
        places = {"velocity" if place == "position" else place for place in places}

    def is_better(curve: "PortCurve") -> bool:
        own = len(decision.fits) == 1 or places <= {curve.port}
        follows = curve.left_fitted is None or curve.left_fitted < _most_left(fitted, own)
        return bool(follows and _left(curve, held_out[0]) < _most_left(held_out, own))

    return next(filter(is_better, curves), None)


def _most_left(errors: Floats, own: bool) -> float:
    """Return what a curve may leave to stand for the true law; ``own`` where all names are at its place."""
    if own:
        return float(RESEMBLED * errors[-1])
    return float(max(min(np.sqrt(errors[-2] * errors[-1]), errors[-1] / RESEMBLED), errors[-1]))


def _port_of(choice: Choice) -> str:
    """Return the port at which a curve of free form holds an effect, empty for none."""
    effect, form = choice.effect, choice.form
    if choice.name in CONSTANTS:
        return ANYWHERE
    if effect.port in ("input", "output"):
        return "" if choice.name in (*MEMORY, *TIMED) else effect.port
    if effect.port != "force" or form.state:
        return ""
    law = parse(form.expression, {"x", "v", *(parameter.name for parameter in form.parameters)})
    depends = symbols(law) & {"x", "v"}
    return "" if len(depends) != 1 else {"x": "position", "v": "velocity"}[min(depends)]


def each_counts(record: "Record", decision: Decision) -> bool:
    """Tell whether each effect in its turn takes more off the held-out error than what is left unexplained.

    One that does less is no finding beside it: it may as well be part of what follows the unexplained.
    """
    errors = _errors(record, decision, record.validation)
    gains = -np.diff(errors)[len(decision.given) :]
    return bool((gains > decision.left_share * errors[0]).all())


def _errors(record: "Record", decision: Decision, rows: Mask) -> Floats:
    """Return the mean squared errors on rows: without effects, with one, two, ..."""
    y, fits = record.y[:, 0], (decision.baseline, *(decision.fits or (decision.baseline,)))
    return np.array([np.mean((y - fit.output)[rows] ** 2) for fit in fits])


def _left(curve: "PortCurve", before: float) -> float:
    """Return the mean squared error that a curve leaves on validation rows; ``before`` without effects.

    The model that it was fitted beside is another one, and may be lost on these rows where the baseline is
    not: what it takes off that model's error says little, and counts through windows alone.
    """
    return (1.0 - curve.explains_at_most) * before if curve.left is None else curve.left


def curves_at_ports(
    structure: Structure, baseline: StructureFit, ports: Sequence[str] = PORTS
) -> "tuple[PortCurve, ...]":
    """Fit a free-form curve at ports of the model without effects, what explains most first.

    Models whose ports cannot be opened have none.

    Parameters
    ----------
    structure : Structure
        Of a linear or physical model.
    baseline : StructureFit
        The model without effects.
    ports : sequence of {"input", "output", "position", "velocity"}

    Returns
    -------
    tuple of PortCurve
    """
    from sysid.diagnosis.physics.structure import PhysicsStructure
    from sysid.diagnosis.ports import explore_ports

    record = structure.record
    try:
        if isinstance(structure, PhysicsStructure):
            from sysid.physics.fit import fit_physics_near

            start = "estimate" if structure.free_start else "rest"
            values, hold = structure.values(baseline), structure.plant.hold
            physical = fit_physics_near(record, structure.model, values, initial_state=start, hold=hold)
            return explore_ports(record, physical, ports=ports)
        from sysid.diagnosis.linear.structure import LinearStructure
        from sysid.linear import fit_output_error

        if isinstance(structure, LinearStructure):
            start = "estimate" if structure.free_start else "rest"
            linear = fit_output_error(record, structure.order, initial_state=start)
            return explore_ports(record, linear, ports=ports)
    except SysidError:
        return ()
    return ()
