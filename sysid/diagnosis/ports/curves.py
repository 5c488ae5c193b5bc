"""Free-form curves: what map is missing at each port of a model, and how much it would explain."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.ports.loop import Loop
from sysid.diagnosis.ports.opening import plant_of
from sysid.diagnosis.ports.plants import PORTS, Port
from sysid.diagnosis.ports.reversals import change_at_reversal
from sysid.diagnosis.ports.search import PortFit, enough_rows, fit_baseline, fit_port
from sysid.diagnosis.ports.stretches import make_stretches
from sysid.diagnosis.ports.uncertainty import Shape, explained, judged_errors, shape_of, with_bias
from sysid.diagnosis.wording import NORMAL_95, percent, quantity
from sysid.errors import UsageError
from sysid.linear.forms import Floats
from sysid.result_files import finite

if TYPE_CHECKING:
    from sysid.linear.output_error import OutputErrorFit
    from sysid.physics.fitted import PhysicsFit

# Below this share a port is said to explain nothing.
NOTHING = 0.02
# A coarser or another curve is shown instead if it removes so much more of the judged error.
CLEARLY_MORE = 0.05
# A map takes more off the error it is fitted to even by chance: a search that ends with less went nowhere.
NO_PROGRESS = 1e-5
# A fit on so many times fewer knots tells what the spline that is shown leaves out.
FEWER = 1.5


@dataclass(frozen=True, eq=False)
class PortCurve:
    """The map that a model lacks at one port.

    Attributes
    ----------
    port : {"input", "output", "position", "velocity"}
    channel : str
        Name of the signal that the map changes or stands for.
    quantity, unit : str
        What the map depends on.
    result, result_unit : str
        What the map gives.
    explains_at_most : float
        Share of the model's squared free-run error that the map removes on rows it was not fitted to,
        between 0 and 1.
    interval : tuple of float
        Its 95 % interval by a block bootstrap.
    value, centre, lower, upper : ndarray, shape (n_points,)
        The curve and its pointwise 95 % band; straight lines that the linear part can take over are
        left out.
    density : ndarray, shape (n_points,)
        Share of the data for each unit of ``value``.
    knots : ndarray
    status : str
        One sentence on the fit.
    sentence : str
        One sentence for the reader.
    left : float or None
        Mean squared error on the judged rows that the map leaves; None where no map was fitted, or where
        a long record is looked at through windows, each of which has a start of its own.
    left_fitted : float or None
        The same on the rows that the map was fitted to.
    """

    port: str
    channel: str
    quantity: str
    unit: str
    result: str
    result_unit: str
    explains_at_most: float
    interval: tuple[float, float]
    value: Floats
    centre: Floats
    lower: Floats
    upper: Floats
    density: Floats
    knots: Floats
    status: str
    sentence: str
    left: float | None = None
    left_fitted: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return plain values; one that is not finite becomes null."""
        columns = (self.value, self.centre, self.lower, self.upper, self.density)
        names = ("value", "centre", "lower", "upper", "density")
        return {
            "port": self.port,
            "channel": self.channel,
            "explains_at_most": finite(self.explains_at_most),
            "interval": [finite(bound) for bound in self.interval],
            "quantity": self.quantity,
            "unit": self.unit,
            "result": self.result,
            "result_unit": self.result_unit,
            "curve": [
                {name: finite(number) for name, number in zip(names, point, strict=True)}
                for point in zip(*columns, strict=True)
            ],
            "knots": [float(knot) for knot in self.knots],
            "status": self.status,
            "sentence": self.sentence,
        }

    def __repr__(self) -> str:
        return f"PortCurve({self.port!r}, {self.channel!r}: {self.sentence})"


def explore_ports(
    record: Record,
    model: "OutputErrorFit | PhysicsFit",
    *,
    rows: Mask | None = None,
    ports: Sequence[str] = PORTS,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[PortCurve, ...]:
    """Fit a free-form map at each port of a model and say how much of the error it removes.

    A cubic spline stands before the linear part (``"input"``), behind it (``"output"``), or feeds a
    force back from the output (``"position"``) or its rate of change (``"velocity"``); spline and
    linear part are fitted together on the free-run error, the model alone on the same rows.  Long
    records are looked at through windows.

    Parameters
    ----------
    record : Record
    model : OutputErrorFit or PhysicsFit
    rows : ndarray of bool, shape (n_samples,), optional
        Rows on which the maps are judged; the other estimation and validation rows are fitted.
        Validation rows by default.
    ports : sequence of {"input", "output", "position", "velocity"}
    progress : callable, optional
        Called with the number of ports done and to do.

    Returns
    -------
    tuple of PortCurve
        The one that explains most first.

    Raises
    ------
    UsageError
        If a port or the model is not known.
    ModelError
        If a physical model is not linear in state and input.
    DataError
        If there are no rows to fit or to judge.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> from sysid.linear import fit_output_error
    >>> rng = np.random.default_rng(0)
    >>> u = rng.uniform(-2.0, 2.0, 800)
    >>> y = np.zeros(800)
    >>> for k in range(1, 800):
    ...     y[k] = 0.8 * y[k - 1] + np.clip(u[k - 1], -1.0, 1.0)
    >>> record = make_record(u, y + 0.02 * rng.standard_normal(800), period=0.1)
    >>> curves = explore_ports(record, fit_output_error(record, 1), ports=("input", "velocity"))
    >>> curves[0].port, curves[0].explains_at_most > 0.9
    ('input', True)
    """
    from threadpoolctl import threadpool_limits

    unknown = [kind for kind in ports if kind not in PORTS]
    if unknown:
        raise UsageError(f"port {unknown[0]!r} is not known: choose among {', '.join(PORTS)}")
    plant = plant_of(model)
    judged = record.validation if rows is None else np.asarray(rows, bool)
    stretches = make_stretches(record, plant, judged)
    n_judged = int(np.sum(judged & np.isfinite(record.y[:, 0])))
    found = plant.ports(record, ports)
    curves, known = [], None
    with threadpool_limits(1):  # blocks are small: further threads only wait for one another
        for number, port in enumerate(found):
            if progress is not None:
                progress(number, len(found))
            if not enough_rows(plant, stretches):
                curves.append(_blank(record, port, "it has too few rows"))
                continue
            baseline = fit_baseline(plant, port, stretches, known)
            known = baseline[1]
            curves.append(_curve(record, port, baseline, fit_port(port, baseline), n_judged))
    if progress is not None:
        progress(len(found), len(found))
    return tuple(sorted(curves, key=lambda curve: -curve.explains_at_most))


def _blank(record: Record, port: Port, reason: str) -> PortCurve:
    """Return what is known of a port at which no curve was fitted."""
    empty = np.zeros(0)
    return PortCurve(
        port=port.kind,
        channel=record.outputs[0] if port.kind == "output" else record.inputs[port.channel],
        quantity=port.quantity,
        unit=port.unit,
        result=port.value,
        result_unit=port.value_unit,
        explains_at_most=0.0,
        interval=(0.0, 0.0),
        value=empty,
        centre=empty,
        lower=empty,
        upper=empty,
        density=empty,
        knots=empty,
        status=f"not fitted: {reason}",
        sentence=f"No curve could be fitted at the {port.kind} ({port.quantity}): {reason}.",
    )


def _curve(
    record: Record, port: Port, baseline: tuple[Loop, Floats], fits: list[PortFit], n_judged: int
) -> PortCurve:
    if not fits:
        return _blank(record, port, "what it depends on does not vary, or the run diverges")
    fit, share, interval = _best_judged(baseline, fits)
    errors = np.concatenate(judged_errors(fit.loop, fit.point, baseline))
    n_fitted = sum(int(stretch.fitted.sum()) for stretch in fit.loop.stretches)
    whole = errors.size == n_judged
    shape = shape_of(fit)
    coarser = [other for other in fits if fit.loop.knots.size / other.loop.knots.size >= FEWER]
    if coarser:
        nearest = max(coarser, key=lambda other: (other.loop.knots.size, -other.loop.error(other.point)))
        shape = with_bias(shape, fit, nearest)
    return replace(
        _blank(record, port, ""),
        explains_at_most=share,
        interval=interval,
        value=shape.value,
        centre=shape.centre,
        lower=shape.centre - NORMAL_95 * shape.spread,
        upper=shape.centre + NORMAL_95 * shape.spread,
        density=shape.density,
        knots=fit.loop.knots,
        status=_status(fit, moved := _improves(fit, baseline)),
        sentence=_sentence(port, share, interval[0], shape) if moved else _nothing_found(port),
        left=float(np.mean(errors**2)) if whole else None,
        left_fitted=fit.loop.error(fit.point) / n_fitted if whole else None,
    )


def _improves(fit: PortFit, baseline: tuple[Loop, Floats]) -> bool:
    """Tell whether the map lowers the error on the very rows it was fitted to."""
    alone, point = baseline
    return fit.loop.error(fit.point) < (1.0 - NO_PROGRESS) * alone.error(point)


def _best_judged(
    baseline: tuple[Loop, Floats], fits: list[PortFit]
) -> tuple[PortFit, float, tuple[float, float]]:
    """Return the fit to be shown: the first one unless another removes clearly more of the judged error."""
    alone = judged_errors(*baseline)
    judged = [explained(alone, judged_errors(fit.loop, fit.point, baseline)) for fit in fits]
    best = max(range(len(fits)), key=lambda number: judged[number][0])
    chosen = best if judged[best][0] > judged[0][0] + CLEARLY_MORE else 0
    return fits[chosen], *judged[chosen]


def _status(fit: PortFit, moved: bool) -> str:
    if not moved:
        return "the search found no curve that lowers the error on the rows it was fitted to"
    if fit.converged:
        return "the fit converged"
    return "the fit stopped before it converged: a better curve may exist"


def _place(port: Port) -> str:
    return {
        "input": "static curve at the input" + ("" if port.quantity == port.kind else f" {port.quantity}"),
        "output": "static curve at the output",
        "position": f"force that depends on the position{_unless_same(port)}",
        "velocity": f"force that depends on the velocity{_unless_same(port)}",
    }[port.kind]


def _unless_same(port: Port) -> str:
    return "" if port.quantity == port.kind else f" ({port.quantity})"


def _nothing_found(port: Port) -> str:
    return (
        f"No {_place(port)} was found that lowers the error even on the rows it was fitted to: "
        "what it could remove is not known."
    )


def _sentence(port: Port, share: float, lowest: float, shape: Shape) -> str:
    place = f"A {_place(port)}"
    if share < NOTHING:
        return f"{place} removes none of the error."
    chance = ", which may be chance" if lowest <= 0.0 else ""
    text = f"{place} removes at most {percent(share)} of the error{chance}."
    if port.kind == "velocity" and not chance and (found := change_at_reversal(shape)) is not None:
        change, speed = quantity(found[0], port.value_unit), quantity(found[1], port.unit)
        text += f" It changes by {change} where the velocity changes its sign (within ±{speed})."
    return text
