"""What the data say of the law of an effect without knowing it."""

from dataclasses import replace

import numpy as np

from sysid.diagnosis.effect_views.view import PER_SAMPLE, EffectView, FreeCurve
from sysid.diagnosis.shortfall import curves_at_ports
from sysid.diagnosis.structures.structure import Structure, StructureFit


def with_free_curve(view: EffectView, structure: Structure, baseline: StructureFit) -> EffectView:
    """Return the view of the only effect of a model with what the data say of its law without knowing it.

    A straight line in a curve of free form cannot be told from the model's own gain, stiffness or damping,
    so its line is that of the law.  A jump, as of dry friction, is none that a smooth curve can show.

    Parameters
    ----------
    view : EffectView
    structure : Structure
    baseline : StructureFit
        The model without the effect.
    """
    curves = curves_at_ports(structure, baseline, [view.port]) if view.port else ()
    if not curves or not curves[0].value.size:
        return view
    (curve,) = curves
    value, weight = curve.value, np.sqrt(curve.density)
    if view.quantity == PER_SAMPLE:
        value = value * structure.record.period
    law = np.interp(value, view.value, view.law)
    known, sloped = curve.centre, value
    if view.port == "input":  # the slope of the line is a gain, through which the curve passes, too
        known, sloped = np.zeros(value.size), value + curve.centre
    columns = np.column_stack([np.ones(value.size), sloped])
    line = np.linalg.lstsq(columns * weight[:, np.newaxis], (law - known) * weight, rcond=None)[0]
    centre, gain = columns @ line + known, abs(line[1]) if view.port == "input" else 1.0
    lower, upper = (centre + gain * (edge - curve.centre) for edge in (curve.lower, curve.upper))
    return replace(view, free=FreeCurve(value, centre, lower, upper))
