"""What the point of a linear model says to a reader: named parameters, their errors, the equation."""

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Effect, EffectParameter, Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum
from sysid.diagnosis.linear.modes import errors_over_minima
from sysid.diagnosis.linear.profile import MOST_ROWS, profile_of
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.cells import read_cells
from sysid.diagnosis.structures.equation_words import Signals, effect_line
from sysid.diagnosis.structures.plain_errors import plain_errors
from sysid.diagnosis.structures.structure import WHITE, FittedParameter

# Of the diagonal of R, columns scaled to unit length: below it the unknowns cannot be told apart.
DEPENDENT = 1e-10


def units_of(record: Record) -> dict[str, str]:
    """Return the units of a linear model: a force acts at the input, a speed is a change in a sample."""
    u_unit, y_unit = (record.unit(names[0]) for names in (record.inputs, record.outputs))
    return {"u": u_unit, "y": y_unit, "x": y_unit, "v": y_unit, "F": u_unit}


def named_parameters(
    record: Record, chain: Chain, data: Data, point: Floats, errors: Floats
) -> tuple[FittedParameter, ...]:
    """Return the parameters of a point with their units and standard errors."""
    units = units_of(record)
    gain = EffectParameter("b", "[y]/[u]", "").unit_with(units)
    names = [(f"a{i}", "") for i in range(1, chain.order + 1)]
    names += [(f"b{i}", gain) for i in range(1, chain.order + 1)]
    names += [("constant", units["y"])] * chain.constant
    found = [
        FittedParameter(name, float(value), float(error), unit)
        for (name, unit), value, error in zip(names, point, errors, strict=False)
    ]
    for choice, place in zip(chain.choices, chain.places(data), strict=True):
        found += [
            FittedParameter(p.name, float(value), float(error), p.unit_with(units), choice.name)
            for p, value, error in zip(choice.form.parameters, point[place], errors[place], strict=True)
        ]
    return tuple(found)


def standard_errors(
    chain: Chain, data: Data, point: Floats, noise: Floats, cost: float, *, closely: bool = False
) -> tuple[Floats, Floats | None]:
    """Return the standard error of each unknown of a point; NaN where the output does not tell.

    Parameters
    ----------
    chain : Chain
    data : Data
    point : ndarray, shape (n_unknowns,)
    noise : ndarray
        D(q) of the noise.
    cost : float
        Sum of squares at the point.
    closely : bool
        Whether to follow the likelihood where slopes do not hold; the point is a minimum then.

    Returns
    -------
    ndarray, shape (n_unknowns,)
    ndarray or None
        A point that is far more likely, if one was met.
    """
    errors, lower = np.full(point.size, np.nan), None
    run = chain.run(data, point)
    if run is None:
        return errors, None
    J = chain.slopes(data, point, run, noise).T
    scale = np.linalg.norm(J, axis=0)
    read = read_cells(chain.choices, chain.places(data), point, data.y[data.used])
    # A threshold moves within its cell without any change, or with what a jump behind it is then given.
    used = (scale > 0.0) & (chain.smooth(data) | (read is not None))
    R = np.linalg.qr(J[:, used] / scale[used], mode="r")
    variance = cost / max(J.shape[0] - point.size, 1)
    if np.abs(np.diag(R)).min(initial=1.0) > DEPENDENT:
        root = np.linalg.inv(R) / scale[used, np.newaxis]
        inverse = np.full((point.size, point.size), np.nan)
        inverse[np.ix_(used, used)] = root @ root.T
        errors = np.sqrt(variance * np.diag(inverse))
        if closely and variance > 0.0 and read is None and data.u.size <= MOST_ROWS:
            profile = profile_of(chain, data, noise, Minimum(point, cost, True), inverse, variance)
            errors, lower = profile.standard_errors(_own(chain, data)), profile.lower
        errors = errors_over_minima(chain, data, point, noise, cost, variance, errors)
    else:  # some are known only together, the others as well as ever
        rows = [slice(0, J.shape[0])]
        told = plain_errors(J[:, used], chain.error(data, run, noise), rows, WHITE)
        errors[used] = np.where(np.isfinite(told), told, np.nan)
    if read is not None:
        cells, place = read
        errors *= cells.widening(point.size, np.sqrt(variance))
        errors[place] = cells.step_error
    return errors, lower


def _own(chain: Chain, data: Data) -> Mask:
    """Tell which unknowns a reader sees and the output follows smoothly: no starts, no thresholds."""
    own = np.ones(chain.size(data), dtype=bool)
    own[2 * chain.order + int(chain.constant) : chain.n_linear(data)] = False
    return own & chain.smooth(data)


def widened_by_memory(chain: Chain, data: Data, point: Floats, noise: Floats) -> Floats:
    """Return by how much a fit that took coloured noise for white knows each unknown less well."""
    run = chain.run(data, point)
    if run is None:
        return np.ones(point.size)
    J = chain.slopes(data, point, run, WHITE).T
    residual = (run.y - data.y)[data.used]
    kept = np.concatenate([[0], np.cumsum(data.used)])
    edges = kept[data.begin].tolist()
    runs = [slice(first, end) for first, end in itertools.pairwise(edges) if end > first]
    coloured, white = (plain_errors(J, residual, runs, d) for d in (noise, WHITE))
    known = np.isfinite(white) & (white > 0.0)
    return np.where(known, coloured / np.where(known, white, 1.0), 1.0)


def equation_text(
    order: int, constant: bool, point: Floats, effects: Sequence[tuple[Effect, Mapping[str, float]]]
) -> str:
    """Return the difference equation and below it a line for each effect, for a reader.

    Where an effect stands before it, it is driven by x and not by the input u; where one stands behind it,
    its own output is z and not y.
    """
    ports = {effect.port for effect, _ in effects}
    x = "x" if ports & {"input", "gain"} else "u"
    z = "z" if ports & {"output", "parallel"} else "y"
    a, b = point[:order], point[order : 2 * order]
    left = f"{z}(k)" + "".join(f" {_signed(value)} {z}(k-{i})" for i, value in enumerate(a, 1))
    right = "".join(f" {_signed(value)} {x}(k-{i})" for i, value in enumerate(b, 1)).lstrip("+ ")
    if constant:
        right += f" {_signed(point[2 * order])}"
    signals = Signals("u", z, z, f"the change of {z} in a sample", f"taken off {x}")
    return "\n".join([f"{left} = {right}", *(effect_line(*each, signals) for each in effects)])


def _signed(value: float) -> str:
    return f"{'-' if value < 0 else '+'} {abs(value):.4g}"
