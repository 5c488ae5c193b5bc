"""A physical model fitted for a comparison: on the estimation rows, and again with the validation rows."""

from dataclasses import replace

from sysid.data import Record
from sysid.diagnosis.models.adapters import JointModel, PhysicalModel
from sysid.diagnosis.models.sensor_zero import fit_with_zero, free_run_rms
from sysid.diagnosis.models.unit_check import in_units_of
from sysid.diagnosis.physics.hold import SMOOTHER, band_limited
from sysid.diagnosis.wording import percent, quantity
from sysid.errors import ModelError
from sysid.physics import Model, PhysicsFit, fit_physics, refit_physics
from sysid.progress import Callback, part_of

# Percentage of the work that is done when the search from many starts is, and that with a zero of the sensor.
SEARCHED, SEARCHED_AGAIN = 50, 90


def fit_physical(
    record: Record,
    model: Model,
    initial_state: str,
    constant: bool | None = None,
    progress: Callback | None = None,
) -> PhysicalModel:
    """Search on the estimation rows from many starts; the refit with the validation rows goes on from there.

    The input is held between samples, unless it has no upper frequencies, as one that was held has, and a
    smooth course between samples lowers the error on the validation rows by much.  The sensor may have a
    zero of its own (``constant``); where nothing is said and experiments do not start at rest, the validation
    rows say so.  A column in another unit than the model's is told.
    """
    model, units = in_units_of(record, model)
    accepted = fit_physics(
        record,
        model,
        initial_state=initial_state,
        rows=record.estimation,
        progress=part_of(progress, 0, SEARCHED),
    )
    accepted, held = _held_or_smooth(record, accepted)
    zero = ""
    if constant or (constant is None and initial_state == "estimate"):
        again = part_of(progress, SEARCHED, SEARCHED_AGAIN)
        accepted, zero = fit_with_zero(record, accepted, bool(constant), again)
    fit = refit_physics(record, accepted)
    if progress is not None:
        progress(100, 100)
    return PhysicalModel(fit, accepted, tuple(note for note in (held, zero, units) if note))


def fit_jointly(
    record: Record,
    model: Model,
    initial_state: str,
    constant: bool | None = None,
    progress: Callback | None = None,
) -> tuple[JointModel, ...]:
    """Fit a physical model to several outputs together; return it once for each of them."""
    found = fit_physical(record, model, initial_state, constant, progress)
    left = ", ".join(
        f"{name} {quantity(size, record.unit(name))}"
        for name, size in zip(found.fit.outputs, found.fit.rms_of, strict=True)
    )
    note = f"The outputs were fitted together, the error of each weighed by what is left of it: {left}."
    remarks = (note, *found.remarks)
    return tuple(
        JointModel(found.fit, found.accepted, remarks, whole=record, place=place)
        for place in range(len(record.outputs))
    )


def _held_or_smooth(record: Record, held: PhysicsFit) -> tuple[PhysicsFit, str]:
    """Return the fit with the better course of the input between samples, and why it is not held."""
    if not band_limited(record, record.estimation):
        return held, ""
    try:
        smooth = refit_physics(record, held, rows=record.estimation, hold="smooth")
    except ModelError:  # diverges
        return held, ""
    share = _held_out_error(record, smooth) / max(_held_out_error(record, held), 1e-300)
    if not share <= SMOOTHER:
        return held, ""
    note = (
        "Between samples the input is taken to follow a smooth curve: unlike a held one it has no power near "
        f"half the sampling rate, and the error on the held-out rows falls to {percent(share)} of what it is "
        "for an input held between samples."
    )
    return replace(smooth, restarts_agree=held.restarts_agree), note


def _held_out_error(record: Record, fit: PhysicsFit) -> float:
    """Return the free-run error on validation rows, or on those of the fit."""
    rows = record.validation if record.validation.any() else record.estimation
    return free_run_rms(record, fit, rows)
