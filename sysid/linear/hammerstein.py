"""Hammerstein models fitted by their free run: a hard map of the input, then a linear output-error model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask, check_record
from sysid.errors import IdentifiabilityError, UsageError
from sysid.linear.forms import Complexes, Floats, poles_of, reflections_from_poles
from sysid.linear.output_error import (
    INITIAL_STATES,
    OutputErrorFit,
    fit_output_error,
    make_segments,
    whole_number,
)
from sysid.linear.reduction import Reduction, Segment, Structure
from sysid.linear.responses import responses
from sysid.linear.restarts import same_error, same_output, shortened
from sysid.linear.search import search_poles
from sysid.linear.uncertainty import Uncertainty, parameter_uncertainty
from sysid.nonlinearities import Nonlinearity, nonlinearity

if TYPE_CHECKING:
    from sysid.linear.simulation import Prediction

# Values of a parameter that are tried: quantiles of the input's size, and for a pair of parameters fewer.
GRID, PAIR_GRID = 25, 8
# A jump that is added to the input may be larger than it.
LARGEST_JUMP = 5.0
GRID_ROWS = 3_000
REFINED_ROWS = 20_000
COARSE_STEP, COARSE_EVALUATIONS = 0.1, 12
FINE_STEP, FINE_EVALUATIONS = 1e-3, 40
REFINED_STARTS, MOST_STARTS = 3, 9
EVALUATIONS, ROUNDS = 80, 6
# Tolerances on a parameter as shares of its range, first for several places, then for the best.
ROUGH, PRECISE = 1e-3, 1e-7


@dataclass(frozen=True)
class HammersteinFit:
    """A fitted Hammerstein model: A(q) y = B(q) N(u, parameters) + constant.

    Attributes
    ----------
    nonlinearity : Nonlinearity
        The map N, of unit gain.
    thresholds : tuple of float
        Its parameters, in the unit of the input.
    linear : OutputErrorFit
        The linear part, from the map's output to y; its standard errors hold the map's parameters fixed.
    uncertainty : Uncertainty
        Standard errors of all coefficients together, those of the map first; NaN for one on which the output
        depends in steps.
    converged, restarts_agree : bool
    status : str
    """

    nonlinearity: Nonlinearity
    thresholds: tuple[float, ...]
    linear: OutputErrorFit
    uncertainty: Uncertainty
    converged: bool
    restarts_agree: bool
    status: str

    @property
    def name(self) -> str:
        """Name of the model, ``hammerstein-saturation`` for one."""
        return f"hammerstein-{self.nonlinearity.name}"

    @property
    def order(self) -> int:
        """Degree of A."""
        return self.linear.order

    @property
    def structure(self) -> Structure:
        """Order, delay, constant and initial state of the linear part."""
        return self.linear.structure

    @property
    def poles(self) -> Complexes:
        """Poles of the linear part."""
        return self.linear.poles

    @property
    def period(self) -> float:
        """Sampling period [s]."""
        return self.linear.period

    @property
    def inputs(self) -> tuple[str, ...]:
        """Name of the input."""
        return self.linear.inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """Name of the output."""
        return self.linear.outputs

    @property
    def rms(self) -> float:
        """Root mean square of the free-run residual on the rows of the fit."""
        return self.linear.rms

    @property
    def output_std(self) -> float:
        """Standard deviation of the output on the rows of the fit."""
        return self.linear.output_std

    @property
    def n_rows(self) -> int:
        """Rows of the fit."""
        return self.linear.n_rows

    @property
    def threshold_names(self) -> tuple[str, ...]:
        """Names of the map's parameters, apart from those of A and B."""
        count = len(self.thresholds)
        return ("threshold",) if count == 1 else tuple(f"threshold{i + 1}" for i in range(count))

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Return value and standard error of the map's parameters and of each coefficient."""
        names = [*self.threshold_names, *self.linear.parameters()]
        values = [*self.thresholds, *(value for value, _ in self.linear.parameters().values())]
        errors = self.uncertainty.standard_errors
        return {n: (float(v), float(e)) for n, v, e in zip(names, values, errors, strict=True)}

    def predict(self, record: Record, rows: Mask | None = None) -> "Prediction":
        """Predict every row of a record; see `sysid.linear.simulation.predict`."""
        from sysid.linear.simulation import check_fits, predict

        check_fits(check_record(record), self.inputs, self.outputs, self.period)
        return predict(self.linear, mapped(record, self.nonlinearity, self.thresholds), rows)

    def __repr__(self) -> str:
        lines = [f"HammersteinFit with a {self.nonlinearity.title}: order {self.order}, rms {self.rms:.4g}"]
        lines += [f"  {name:9s} {v: .6g} ± {e:.2g}" for name, (v, e) in self.parameters().items()]
        return "\n".join([*lines, f"  {self.status}"])


def fit_hammerstein(
    record: Record,
    kind: str | Nonlinearity,
    order: int,
    *,
    delay: int = 1,
    constant: bool | None = None,
    initial_state: str = "estimate",
    rows: Mask | None = None,
) -> HammersteinFit:
    """Fit a Hammerstein model with a map of known form by its free-run error.

    For given parameters of the map the rest is an output-error fit, so only these are searched: over a
    grid of quantiles of the input first, as the error has kinks and local minima in them, then closer
    about the best ones.

    Parameters
    ----------
    record : Record
        With one input and one output.
    kind : str or Nonlinearity
        A map, or its name in `sysid.nonlinearities.NONLINEARITIES`.
    order : int
        Degree of A.
    delay, constant, initial_state, rows
        See `sysid.linear.fit_output_error`.

    Returns
    -------
    HammersteinFit

    Raises
    ------
    UsageError, DataError, IdentifiabilityError
        If an option makes no sense or the record does not determine the model.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.data import make_record
    >>> from sysid.linear import simulate_polynomial
    >>> u = np.random.default_rng(0).uniform(-2.0, 2.0, 400)
    >>> y = simulate_polynomial([0.0, 0.5], [1.0, -0.8], np.clip(u, -0.7, 0.7))
    >>> fit = fit_hammerstein(make_record(u, y, period=1.0), "saturation", order=1, initial_state="rest")
    >>> round(fit.thresholds[0], 5), round(float(fit.linear.a[1]), 5)
    (0.7, -0.8)
    """
    from threadpoolctl import threadpool_limits

    chosen = nonlinearity(kind) if isinstance(kind, str) else kind
    if not isinstance(chosen, Nonlinearity):
        raise UsageError(f"kind is {kind!r}: give the name of a map of sysid.nonlinearities, or the map")
    if check_record(record).u.shape[1] != 1:
        raise UsageError(
            f"the record has {record.u.shape[1]} inputs ({', '.join(record.inputs)}): choose one for the map"
        )
    order, delay = whole_number("order", order), whole_number("delay", delay)
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    free = initial_state == "estimate"
    constant = free if constant is None else constant
    segments = make_segments(record, rows)
    fitted = partial(
        fit_output_error, order=order, delay=delay, constant=constant, initial_state=initial_state, rows=rows
    )
    with threadpool_limits(1):
        linear = fitted(record, precise=False)
        search = _Search(segments, chosen, linear.structure, linear.poles)
        thresholds, agree = search.best()
        fit = fitted(mapped(record, chosen, thresholds), start=search.poles[thresholds])
        uncertainty = _uncertainty(segments, chosen, thresholds, fit)
    agreement = (
        "searches from different parameters of the map agree in error and output"
        if agree
        else "searches from different parameters of the map end at different errors or outputs"
    )
    return HammersteinFit(
        chosen,
        thresholds,
        fit,
        uncertainty,
        fit.converged,
        agree,
        f"the map's parameters searched over {search.tried} values; {agreement}",
    )


def mapped(record: Record, kind: Nonlinearity, thresholds: Sequence[float]) -> Record:
    """Return the record with the output of a map as its input, each experiment from its own start."""
    parts = [kind(record.u[part, 0], *thresholds) for part in record.slices]
    x = np.concatenate(parts)[:, np.newaxis]
    x.setflags(write=False)
    return replace(record, u=x)


class _Search:
    """Error of the best linear part as a function of the map's parameters."""

    def __init__(
        self, segments: tuple[Segment, ...], kind: Nonlinearity, structure: Structure, poles: Complexes
    ) -> None:
        self.kind, self.structure = kind, structure
        self.coarse = shortened(segments, GRID_ROWS)
        self.fine = shortened(segments, REFINED_ROWS)
        self.first = poles
        self.poles: dict[tuple[float, ...], Complexes] = {}
        self.tried = 0
        self.size = float(np.sum([np.max(np.abs(s.y[s.used])) for s in segments])) or 1.0
        size = np.concatenate([np.abs(segment.u[segment.used, 0]) for segment in segments])
        quantiles = np.quantile(size, np.linspace(0.0, 0.99, PAIR_GRID if len(kind.parameters) > 1 else GRID))
        self.largest = float(size.max())
        jump = "preload" in kind.name
        more = self.largest * np.geomspace(1.0, LARGEST_JUMP, 5) if jump else np.empty(0)
        self.grid = np.unique(np.concatenate([quantiles, more]))
        self.upper = LARGEST_JUMP * self.largest if jump else self.largest

    def best(self) -> tuple[tuple[float, ...], bool]:
        """Return the best parameters, and whether searches from different ones agree."""
        count = len(self.kind.parameters)
        meshes = np.meshgrid(*[self.grid] * count, indexing="ij")
        points = np.column_stack([mesh.ravel() for mesh in meshes])
        costs = np.array([self._cost(tuple(point), self.coarse, self.first, coarse=True) for point in points])
        if not np.isfinite(costs).any():
            raise IdentifiabilityError(
                f"no parameter of the {self.kind.name} gives a model: its output is constant on this input"
            )
        ends: list[tuple[float, tuple[float, ...]]] = []
        ranked = [place for place in np.argsort(costs)[:MOST_STARTS] if np.isfinite(costs[place])]
        for first in range(0, len(ranked), REFINED_STARTS):  # on to the next ones until two agree
            batch = ranked[first : first + REFINED_STARTS]
            ends += [self._refined(points[place], self.coarse, ROUGH) for place in batch]
            ends.sort(key=lambda end: end[0])
            if agree := self._agree(ends):
                break
        return self._refined(np.array(ends[0][1]), self.fine, PRECISE)[1], agree

    def _agree(self, ends: Sequence[tuple[float, tuple[float, ...]]]) -> bool:
        """Tell whether a second search ended at the error and the output of the best one."""
        cost, best = ends[0]
        near = [thresholds for other, thresholds in ends[1:] if same_error(cost, other, 1.0)]
        outputs = [self._output(thresholds) for thresholds in [best] * bool(near) + near]
        return any(same_output(outputs[0], other, cost, 1.0) for other in outputs[1:])

    def _output(self, thresholds: tuple[float, ...]) -> Floats:
        """Return the output on the rows of the coarse search, relative to its size."""
        behind = self._behind(thresholds, self.coarse)
        reduction = Reduction(behind, self.structure, reflections_from_poles(self.poles[thresholds]))
        return reduction.output(reduction.projection) / self.size

    def _behind(self, thresholds: tuple[float, ...], segments: Sequence[Segment]) -> tuple[Segment, ...]:
        """Return the rows with the output of the map as their input."""
        return tuple(replace(s, u=self.kind(s.u[:, 0], *thresholds)[:, np.newaxis]) for s in segments)

    def _refined(
        self, point: Floats, segments: tuple[Segment, ...], tolerance: float
    ) -> tuple[float, tuple[float, ...]]:
        """Search about a place, one parameter after the other, between its neighbours on the grid."""
        poles = self.poles.get(tuple(point.tolist()), self.first)
        now = point.tolist()
        best = self._cost(tuple(now), segments, poles)
        for _ in range(1 if len(now) == 1 else ROUNDS):
            before = best
            for j in range(len(now)):
                best = self._line(now, j, best, segments, poles, tolerance)
            if before - best <= 1e-3 * tolerance * before:
                break
        return best, tuple(now)

    def _neighbours(self, value: float) -> tuple[float, float]:
        """Return the values of the grid below and above."""
        below, above = self.grid[self.grid < value], self.grid[self.grid > value]
        return float(below[-1]) if below.size else 0.0, float(above[0]) if above.size else self.upper

    def _line(
        self,
        now: list[float],
        j: int,
        best: float,
        segments: tuple[Segment, ...],
        poles: Complexes,
        tolerance: float,
    ) -> float:
        """Minimise over one parameter to both sides of where it is; a step keeps what is better."""
        from scipy.optimize import minimize_scalar

        def cost(value: float) -> float:
            return self._cost((*now[:j], float(value), *now[j + 1 :]), segments, poles)

        lower, upper = self._neighbours(now[j])
        for low, high in ((lower, now[j]), (now[j], upper)):
            if high - low <= 1e-12 * self.upper:
                continue
            end = minimize_scalar(
                cost,
                bounds=(low, high),
                method="bounded",
                options={"xatol": tolerance * self.upper, "maxiter": EVALUATIONS},
            )
            if end.fun < best:
                best, now[j] = float(end.fun), float(end.x)
        return best

    def _cost(
        self,
        thresholds: tuple[float, ...],
        segments: Sequence[Segment],
        poles: Complexes,
        *,
        coarse: bool = False,
    ) -> float:
        """Return the sum of squared errors, relative to the output's size, of the best linear part."""
        thresholds = tuple(float(value) for value in thresholds)
        self.tried += 1
        behind = self._behind(thresholds, segments)
        if all(np.ptp(s.u[s.used]) == 0.0 for s in behind):
            return float("inf")
        step, evaluations = (COARSE_STEP, COARSE_EVALUATIONS) if coarse else (FINE_STEP, FINE_EVALUATIONS)
        search = search_poles(behind, self.structure, reflections_from_poles(poles), step, evaluations)
        self.poles[thresholds] = poles_of(search.reflections)
        return search.cost / self.size**2


def _uncertainty(
    segments: tuple[Segment, ...], kind: Nonlinearity, thresholds: tuple[float, ...], fit: OutputErrorFit
) -> Uncertainty:
    """Return standard errors of the map's parameters and the coefficients together."""
    behind = tuple(replace(s, u=kind(s.u[:, 0], *thresholds)[:, np.newaxis]) for s in segments)
    search = search_poles(behind, fit.structure, fit.reflections, FINE_STEP, 1)
    # A change of the map's output passes through the linear part, from rest and without its constant.
    structure = replace(fit.structure, constant=False, free_start=False)
    weights = search.projection.shared[: structure.n_shared(1)]
    extra = []
    for segment in segments:
        slopes = np.asarray(kind.slope(segment.u[:, 0], *thresholds)).reshape(segment.y.size, -1)
        through = [
            responses(slope[:, np.newaxis].copy(), structure, fit.reflections, weights)[0]
            for slope in slopes.T
        ]
        extra.append(np.vstack(through))
    found = parameter_uncertainty(behind, fit.structure, search, extra=extra)
    moves = np.array([any(np.abs(rows[j]).max() > 0.0 for rows in extra) for j in range(len(thresholds))])
    errors = found.standard_errors.copy()
    count = len(thresholds)
    errors = np.concatenate([np.where(moves, errors[-count:], np.nan), errors[:-count]])
    return replace(found, standard_errors=errors)
