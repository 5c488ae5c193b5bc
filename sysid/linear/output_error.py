"""Output-error fit of a linear model: y = B/A u + constant, judged by its free run."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear.forms import (
    Complexes,
    Floats,
    denominator,
    kautz_numerators,
    poles_of,
    reflections_from_poles,
)
from sysid.linear.reduction import Segment, Structure
from sysid.linear.restarts import COARSE_STEP, search_from_many
from sysid.linear.search import search_poles
from sysid.linear.uncertainty import Uncertainty, parameter_uncertainty

INITIAL_STATES = ("estimate", "rest")
# A search stops when its next step is below this share of a standard error.
FINE_STEP = 1e-3
MAXIMUM_ORDER = 40


@dataclass(frozen=True)
class OutputErrorFit:
    """A fitted linear output-error model.

    A(q) y = B(q) u + constant, with A = 1 + a1 q^-1 + ... and B from q^-delay on.

    Attributes
    ----------
    structure : Structure
        Order, delay, constant, initial state.
    a : ndarray, shape (order + 1,)
        Coefficients of A, the leading 1 included.
    b : ndarray, shape (n_inputs, n_numerator)
        Coefficients of B for each input, the first belongs to q^-delay.
    constant : float
        Constant in the difference equation, 0 if there is none.
    poles : ndarray of complex, shape (order,)
    uncertainty : Uncertainty
        Standard errors and the colour of the residual.
    period : float
        Sampling period [s].
    inputs, outputs : tuple of str
    rms : float
        Root mean square of the free-run residual on the rows of the fit.
    output_std : float
        Standard deviation of the output on these rows.
    n_rows : int
        Rows of the fit.
    converged : bool
    restarts_agree : bool
        Whether at least two searches from different starts ended at the same error with the same output.
    status : str
        One sentence: how the search ended.
    reflections, weights : ndarray
        The well-conditioned form the model was fitted in and is simulated in.
    """

    structure: Structure
    a: Floats
    b: Floats
    constant: float
    poles: Complexes
    uncertainty: Uncertainty
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    rms: float
    output_std: float
    n_rows: int
    converged: bool
    restarts_agree: bool
    status: str
    reflections: Floats
    weights: Floats

    @property
    def order(self) -> int:
        """Degree of A."""
        return self.structure.order

    @property
    def delay(self) -> int:
        """Samples from input to output; 0 is a direct term."""
        return self.structure.delay

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard error of each coefficient: a1, ..., b1, ..., constant."""
        names = parameter_names(self.structure, len(self.inputs))
        values = [*self.a[1:], *self.b.ravel(), *([self.constant] if self.structure.constant else [])]
        errors = self.uncertainty.standard_errors
        return {n: (float(v), float(e)) for n, v, e in zip(names, values, errors, strict=True)}

    def __repr__(self) -> str:
        lines = [
            f"OutputErrorFit: order {self.order}, delay {self.delay}, "
            f"rms {self.rms:.4g} on {self.n_rows} rows"
        ]
        lines += [
            f"  {name:9s} {value: .6g} ± {error:.2g}" for name, (value, error) in self.parameters().items()
        ]
        lines += ["  poles     " + ", ".join(f"{pole:.5g}" for pole in self.poles), f"  {self.status}"]
        return "\n".join(lines)


def fit_output_error(
    record: Record,
    order: int,
    *,
    delay: int = 1,
    constant: bool | None = None,
    initial_state: str = "estimate",
    rows: Mask | None = None,
    extra_starts: Sequence[Complexes] = (),
    start: Complexes | None = None,
    precise: bool = True,
) -> OutputErrorFit:
    """Fit a linear model by its free-run error, from several starts.

    Parameters
    ----------
    record : Record
        With one output.
    order : int
        Degree of A, at least 1.
    delay : int
        First power of q^-1 in B; 0 gives a direct term besides.
    constant : bool, optional
        Whether a constant acts in the difference equation; by default yes with
        ``initial_state="estimate"`` and no with ``"rest"``.
    initial_state : {"estimate", "rest"}
        Whether each experiment starts from a state of its own or from rest.
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    extra_starts : sequence of ndarray of complex
        Further poles from which to search.
    start : ndarray of complex, shape (order,), optional
        Poles of a model to be refitted: the only start, so that it stays the same model.
    precise : bool
        Whether to search to the last digit and compute standard errors; a trial does with less.

    Returns
    -------
    OutputErrorFit

    Raises
    ------
    UsageError
        If the structure makes no sense.
    DataError, IdentifiabilityError
        If the record has too few rows, several outputs or missing outputs.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> u = np.sign(np.sin(np.arange(200.0) ** 1.5))
    >>> y = np.zeros(200)
    >>> for k in range(1, 200):
    ...     y[k] = 0.8 * y[k - 1] + 0.5 * u[k - 1]
    >>> fit = fit_output_error(make_record(u, y, period=0.1), order=1, initial_state="rest")
    >>> np.round([fit.a[1], fit.b[0, 0]], 6)
    array([-0.8,  0.5])
    """
    from threadpoolctl import threadpool_limits

    structure = _structure(order, delay, constant, initial_state)
    segments = make_segments(check_record(record), rows)
    n_rows = sum(int(segment.used.sum()) for segment in segments)
    _check_enough(structure, segments, n_rows)
    step = FINE_STEP if precise else COARSE_STEP
    with threadpool_limits(1):  # blocks are small: further threads only wait for one another
        if start is None:
            found = search_from_many(segments, structure, extra_starts, step)
            search, agree, message = found.search, found.agreeing > 1, found.sentence
        else:
            search = search_poles(
                segments, structure, reflections_from_poles(_checked_start(start, order)), step
            )
            agree, message = True, "refitted from one start"
        uncertainty = parameter_uncertainty(segments, structure, search, skip=not precise)
    a, b, constant_value = coefficients(
        structure, search.reflections, search.projection.shared, segments[0].u.shape[1]
    )
    return OutputErrorFit(
        structure=structure,
        a=a,
        b=b,
        constant=constant_value,
        poles=poles_of(search.reflections),
        uncertainty=uncertainty,
        period=record.period,
        inputs=record.inputs,
        outputs=record.outputs,
        rms=float(np.sqrt(search.cost / n_rows)),
        output_std=float(np.std(np.concatenate([segment.y[segment.used] for segment in segments]))),
        n_rows=n_rows,
        converged=search.converged,
        restarts_agree=agree,
        status=f"{search.message}; {message}",
        reflections=search.reflections,
        weights=search.projection.shared,
    )


def make_segments(record: Record, rows: Mask | None) -> tuple[Segment, ...]:
    """Cut the experiments that hold chosen rows, each from its first row to its last chosen one.

    Estimation and validation rows are chosen by default.
    """
    rows = record.learning if rows is None else _checked_rows(record, rows)
    if record.y.shape[1] != 1:
        raise UsageError(
            f"the record has {record.y.shape[1]} outputs ({', '.join(record.outputs)}): "
            "choose one output for the fit"
        )
    segments = []
    for part in record.slices:
        used = rows[part]
        if not used.any():
            continue
        end = int(np.flatnonzero(used)[-1]) + 1
        y = record.y[part, 0][:end]
        if not np.isfinite(y[used[:end]]).all():
            row = (part.start or 0) + int(np.flatnonzero(used[:end] & ~np.isfinite(y))[0])
            raise DataError(
                f"row {row + 1}: the output is missing and cannot be fitted: leave the row out of the fit"
            )
        segments.append(Segment(record.u[part][:end], np.where(used[:end], y, 0.0), used[:end]))
    if not segments:
        raise DataError("no row is chosen for the fit: mark rows as train, est or val")
    return tuple(segments)


def _checked_rows(record: Record, rows: Mask) -> Mask:
    flags = np.asarray(rows)
    if flags.dtype != np.bool_ or flags.shape != (record.n_samples,):
        raise UsageError(
            f"rows is an array of {flags.dtype} of shape {flags.shape}: give one True or False for each of "
            f"the {record.n_samples} rows"
        )
    return flags


def coefficients(
    structure: Structure, reflections: Floats, weights: Floats, n_inputs: int
) -> tuple[Floats, Floats, float]:
    """Return A, B of each input and the constant from the form of the search."""
    a = denominator(reflections)
    order = structure.order
    numerators = kautz_numerators(reflections)
    b = np.zeros((n_inputs, structure.n_numerator))
    for channel in range(n_inputs):
        b[channel, int(structure.direct) :] = weights[channel * order : (channel + 1) * order] @ numerators
        if structure.direct:
            b[channel] += weights[n_inputs * order + channel] * a
    return a, b, float(weights[-1]) if structure.constant else 0.0


def parameter_names(structure: Structure, n_inputs: int) -> list[str]:
    """Return the names of the coefficients: b is numbered by its power of q^-1."""
    powers = range(structure.delay, structure.delay + structure.n_numerator)
    names = [f"a{i}" for i in range(1, structure.order + 1)]
    for channel in range(n_inputs):
        suffix = f"_{channel + 1}" if n_inputs > 1 else ""
        names += [f"b{i}{suffix}" for i in powers]
    return names + (["constant"] if structure.constant else [])


def _structure(order: int, delay: int, constant: bool | None, initial_state: str) -> Structure:
    order, delay = whole_number("order", order), whole_number("delay", delay)
    if not 1 <= order <= MAXIMUM_ORDER:
        raise UsageError(f"order is {order}: give a number from 1 to {MAXIMUM_ORDER}")
    if delay < 0:
        raise UsageError(f"delay is {delay} samples: give 0 (direct term), 1 or more")
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    if not (constant is None or isinstance(constant, bool | np.bool_)):
        raise UsageError(f"constant is {constant!r}: give True, False or None")
    free = initial_state == "estimate"
    return Structure(order, delay, free if constant is None else constant, free)


def _checked_start(poles: Complexes, order: int) -> Complexes:
    start = np.asarray(poles, dtype=np.complex128)
    if start.shape != (order,) or not np.isfinite(start).all():
        raise UsageError(
            f"start holds {start.size} poles ({start}): give {order} finite ones, one for each order"
        )
    return start


def whole_number(name: str, value: int) -> int:
    """Return a whole number; UsageError if it is none."""
    try:
        return operator.index(value)
    except TypeError:
        raise UsageError(f"{name} is {value!r}: give a whole number") from None


def _check_enough(structure: Structure, segments: tuple[Segment, ...], n_rows: int) -> None:
    unknowns = structure.n_parameters(segments[0].u.shape[1])
    unknowns += structure.order * len(segments) * structure.free_start
    if n_rows < 2 * unknowns + structure.delay:
        raise IdentifiabilityError(
            f"{n_rows} rows cannot determine {unknowns} unknowns (order {structure.order}, {len(segments)} "
            f"experiments): at least {2 * unknowns + structure.delay} rows are needed; lower the order"
        )
