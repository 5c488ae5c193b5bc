"""A zero of the sensor: the one constant that separates a model of motions from a measured level.

A physical model says what departs from rest, and a sensor may read something at rest.  Left out, that
constant does not only stay in the error: it bends the parameters that are fitted.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.wording import percent, quantity
from sysid.errors import ModelError
from sysid.physics import Model, PhysicsFit, fit_physics, refit_physics
from sysid.physics.expressions import symbols
from sysid.physics.model import Parameter

NAME = "sensor_zero"
# A model that was named is left as it is unless the error on the validation rows falls by this share at
# least, and the zero is so many of its standard errors, which know the colour of the residual.
WORTH, SURE = 0.02, 4.0


def with_sensor_zero(model: Model) -> Model:
    """Return the model with a constant in each output, known as well as its other parameters.

    Examples
    --------
    >>> from sysid.physics import load_model
    >>> print(with_sensor_zero(load_model("two-tanks")).outputs[0])
    y = x2 + sensor_zero
    """
    searched = [p for p in model.parameters if p.status != "fixed"]
    status = "uncertain" if searched and all(p.status == "uncertain" for p in searched) else "free"
    for output in model.outputs:
        name = NAME if len(model.outputs) == 1 else f"{NAME}_{output.name}"
        while name in model.names:
            name += "_"
        zero = Parameter(name, output.unit, 0.0, status=status, meaning="reading of the sensor at rest")
        model = model.with_term(output.name, "zero of the sensor", name, (zero,))
    return model


def has_constant(model: Model) -> bool:
    """Tell whether an output has a constant of its own that is not fixed at zero."""
    zero = {p.name for p in model.parameters if p.status == "fixed" and p.start == 0.0}
    moving = {variable.name for variable in (*model.states, *model.inputs)}
    terms = (symbols(term.expression) for output in model.outputs for term in output.terms)
    return any(not names & moving and not names <= zero for names in terms)


def fit_with_zero(
    record: Record,
    fit: PhysicsFit,
    asked: bool,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[PhysicsFit, str]:
    """Return the fit with zeros of the sensors where these are asked for or told by the validation rows.

    Parameters
    ----------
    record : Record
    fit : PhysicsFit
        Of the estimation rows, without.
    asked : bool
        Whether the constant is to be there, whatever the validation rows say.
    progress : callable, optional

    Returns
    -------
    fit : PhysicsFit
    note : str
        Why there is a zero; empty where there is none.
    """
    if has_constant(fit.model) or not (asked or record.validation.any()):
        return fit, ""
    model = with_sensor_zero(fit.model)
    added = model.parameters[len(fit.model.parameters) :]
    start = replace(fit, model=model, values={**fit.values, **{p.name: p.start for p in added}})
    try:
        near = refit_physics(record, start, rows=record.estimation)
        if not asked and not _told(record, fit, near, tuple(p.name for p in added)):
            return fit, ""
        found = fit_physics(
            record,
            near.model,
            initial_state=fit.initial_state,
            rows=record.estimation,
            hold=fit.hold,
            progress=progress,
        )
    except ModelError:  # diverges
        return fit, ""
    found = found if found.rms <= near.rms else replace(near, restarts_agree=found.restarts_agree)
    return found, _note(record, found, _rms(record, fit), _rms(record, found), tuple(p.name for p in added))


def _told(record: Record, without: PhysicsFit, near: PhysicsFit, names: tuple[str, ...]) -> bool:
    """Tell whether the error on the validation rows falls by enough, and a zero is surely not naught."""
    if not _rms(record, near) < (1.0 - WORTH) * _rms(record, without):
        return False
    found = near.parameters()
    # An undetermined parameter has an infinite standard error.
    return any(abs(found[name][0]) > SURE * found[name][1] for name in names)


def _rms(record: Record, fit: PhysicsFit) -> float:
    """Return the free-run error on the validation rows."""
    return free_run_rms(record, fit, record.validation) if record.validation.any() else float("nan")


def free_run_rms(record: Record, fit: PhysicsFit, rows: Mask) -> float:
    """Return the root mean square of the error of a fit of the estimation rows on others.

    Of several outputs it is that relative to the standard deviation of each.
    """
    free_run = fit.predict(record, rows=record.estimation).free_run.reshape(record.y.shape)
    error = (free_run - record.y)[rows]
    scale = 1.0 if error.shape[1] == 1 else np.maximum(fit.output_std, 1e-300)
    return float(np.sqrt(np.mean((error / scale) ** 2)))


def _note(record: Record, fit: PhysicsFit, without: float, own: float, names: tuple[str, ...]) -> str:
    units = [record.unit(output) for output in record.outputs]
    readings = [quantity(fit.values[name], unit) for name, unit in zip(names, units, strict=True)]
    reads = f"sensor reads {readings[0]}" if len(names) == 1 else f"sensors read {', '.join(readings)}"
    before, after = (
        quantity(rms, units[0]) if len(units) == 1 else f"{percent(rms)} of the signals"
        for rms in (without, own)
    )
    return (
        f"The {reads} at rest in this model ({', '.join(names)}): with that constant the free-run error on "
        f"the validation rows is {after}, without it {before}; --constant no leaves it out."
    )
