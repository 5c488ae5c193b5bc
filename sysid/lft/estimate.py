"""The prediction-error estimate of an LFT model by separable least squares."""

from dataclasses import replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.data.record import Mask
from sysid.errors import IdentifiabilityError, UsageError
from sysid.lft.initial import first_direction, split_linear
from sysid.lft.model import LftFit
from sysid.lft.problem import LftProblem, to_bsplines
from sysid.lft.signals import Data, Signals, signals_of, usable_rows
from sysid.lft.structure import LftStructure, lag_name
from sysid.lft.threads import one_thread
from sysid.nonlinearities.spline import Spline
from sysid.separable import SeparableFit, fit, project
from sysid.separable.factor import RANK_TOLERANCE, triangle

Floats = NDArray[np.float64]
Jacobian = Literal["exact", "kaufman"]

# Searches agree when their costs differ by less than this share.
_AGREEMENT = 1e-6


class Start(Protocol):
    """Anything with a direction d and a numerator g, such as `InitialEstimate` and `LftFit`."""

    @property
    def d(self) -> Floats:
        """Coefficients of D."""

    @property
    def g(self) -> Floats:
        """Coefficients of G, the leading 1 included."""


def fit_lft(
    data: Data,
    structure: LftStructure,
    *,
    rows: Mask | None = None,
    start: Start | tuple[ArrayLike, ArrayLike] | None = None,
    jacobian: Jacobian = "exact",
    starts: int = 1,
    seed: int = 0,
    tolerance: float = 1e-10,
    max_evaluations: int = 200,
) -> LftFit:
    """Fit an LFT model by its one-step prediction error, eq. (4.30) of Pepona (2009).

    A, B and the map are eliminated; d moves on the sphere, g freely, from the estimate of section
    4.3.1 and, if asked for, from random ones.

    Parameters
    ----------
    data : Record, or pair of array_like (u, y)
    structure : LftStructure
    rows : ndarray of bool, shape (n_samples,), optional
        Rows of the fit; estimation and validation rows by default.
    start : optional
        An `InitialEstimate`, an earlier `LftFit`, or a pair (d, g) with g0 = 1 included; d keeps its
        sign.  Without it, d gets the sign with which the map rises on the whole.
    jacobian : {"exact", "kaufman"}
        Golub and Pereyra's, or the approximation of eq. (4.31).
    starts : int
        Searches; those behind the first begin at random d and g.
    seed : int
        Of the random starts.
    tolerance, max_evaluations : float, int
        See `sysid.separable.descend`.

    Returns
    -------
    LftFit

    Raises
    ------
    ModelError
        If a lag acts in A or B and through the map, and ``structure.overlap`` is "reject".
    IdentifiabilityError
        If the rows are too few, a tap is constant, or part of the map has no data.

    Examples
    --------
    >>> import numpy as np
    >>> from sysid.lft import LftStructure, lags
    >>> rng = np.random.default_rng(0)
    >>> u = rng.uniform(-2.5, 2.5, 800)
    >>> y = np.zeros(800)
    >>> w = np.zeros(800)
    >>> for k in range(2, 800):
    ...     w[k] = np.arctan(0.8 * u[k - 1] - 0.6 * u[k - 2])
    ...     y[k] = 0.4 * y[k - 1] + w[k] - 0.5 * w[k - 1] + 0.001 * rng.standard_normal()
    >>> fitted = fit_lft((u, y), LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=20))
    >>> [f"{name} {value:.2f}" for name, (value, _) in fitted.parameters().items()]
    ['a1 -0.40', 'g1 -0.50', 'd1 0.80', 'd2 -0.60']
    >>> bool(abs(fitted.map(1.0) - np.arctan(1.0)) < 0.01)
    True
    """
    if jacobian not in ("exact", "kaufman"):
        raise UsageError(f"jacobian is {jacobian!r}: choose exact or kaufman")
    if starts < 1:
        raise UsageError(f"starts is {starts}: give at least 1")
    signals = signals_of(data)
    problem = LftProblem.of(signals, structure, usable_rows(signals, structure, rows))
    with one_thread():  # factors are narrow: further threads only wait for one another
        begin = [first_start(problem) if start is None else given_start(problem, start)]
        begin += _random_starts(problem, starts - 1, seed)
        found = [_search(problem, d, g, jacobian, tolerance, max_evaluations) for d, g in begin]
        costs = [search.cost for _, search in found]
        best, search = found[int(np.argmin(costs))]
        agree = int(np.sum(np.array(costs) <= min(costs) * (1.0 + _AGREEMENT)))
        model = _model(signals, best, search, agree, starts)
    reference = model.d * _rise(model) if start is None else begin[0][0]
    return model.oriented(reference)


def first_start(problem: LftProblem) -> tuple[Floats, Floats]:
    """Return (d, g) by the better of both readings of section 4.3.1, step 3 without or with a constant."""
    g = np.concatenate([[1.0], np.zeros(problem.structure.n_g)])
    if problem.n_tangents == 0:
        return np.ones(1), g
    found = [first_direction(problem, centred=centred)[2] for centred in (False, True)]
    eta = np.zeros(problem.n_tangents + problem.structure.n_g)
    costs = [project(problem.around(d).regressors(eta), problem.y).cost for d in found]
    return found[int(np.argmin(costs))], g


def given_start(problem: LftProblem, start: Start | tuple[ArrayLike, ArrayLike]) -> tuple[Floats, Floats]:
    """Return (d, g) of a start that was given, d scaled to length 1."""
    pair = start if isinstance(start, tuple) else (start.d, start.g)
    d, g = (np.atleast_1d(np.asarray(part, dtype=float)) for part in pair)
    n_d, n_g = problem.centre.size, problem.structure.n_g + 1
    if d.shape != (n_d,) or g.shape != (n_g,) or g[0] != 1.0 or not np.any(d):
        raise UsageError(
            f"start has d = {d.tolist()} and g = {g.tolist()}: give {n_d} taps that are not all zero, and "
            f"{n_g} coefficients of G, the first of them 1"
        )
    return d / np.linalg.norm(d), g


def _random_starts(problem: LftProblem, count: int, seed: int) -> list[tuple[Floats, Floats]]:
    rng = np.random.default_rng(seed)
    scale = np.std(problem.taps, axis=0)
    found = []
    for _ in range(count):
        d = rng.standard_normal(scale.size) / scale
        g = np.concatenate([[1.0], rng.uniform(-0.8, 0.8, problem.structure.n_g)])
        found.append((d / np.linalg.norm(d), g))
    return found


def _search(
    problem: LftProblem, d: Floats, g: Floats, jacobian: Jacobian, tolerance: float, limit: int
) -> tuple[LftProblem, SeparableFit]:
    """Descend from one start; the search is centred anew at what it finds until it stays there."""
    kind: Literal["golub-pereyra", "kaufman"] = "golub-pereyra" if jacobian == "exact" else "kaufman"
    costs: tuple[float, ...] = ()
    for _ in range(4):
        problem = problem.around(d)
        eta = np.concatenate([np.zeros(problem.n_tangents), g[1:]])
        search = fit(problem, problem.y, eta, jacobian=kind, tolerance=tolerance, max_evaluations=limit)
        costs = (*costs, *search.costs[1 if costs else 0 :])
        turn = float(np.linalg.norm(search.eta[: problem.n_tangents]))
        d, g = problem.direction(search.eta), problem.numerator(search.eta)
        if turn <= 1e-6:
            break
    return problem, replace(search, costs=costs)


def _model(
    signals: Signals, problem: LftProblem, search: SeparableFit, agreeing: int, searches: int
) -> LftFit:
    structure = problem.structure
    _check_rank(problem, search)
    basis = problem.place(search.eta)
    a, b = split_linear(problem, search.theta[: problem.n_fixed])
    change = to_bsplines(structure)
    ends = np.linspace(basis.low, basis.low + basis.width, structure.knots)
    length = float(np.linalg.norm(problem.centre + problem.tangents @ search.eta[: problem.n_tangents]))
    names = (
        *(lag_name("ab", lag, structure) for lag in problem.fixed_lags),
        *(f"g{i}" for i in range(1, structure.n_g + 1)),
        *(lag_name("d", lag, structure) for lag in structure.z_lags),
        *(f"c{i}" for i in range(1, change.shape[0] + 1)),
    )
    d = problem.direction(search.eta)
    told = f"; {agreeing} of {searches} searches ended at this cost" if searches > 1 else ""
    return LftFit(
        structure=structure,
        inputs=signals.inputs,
        output=signals.output,
        a=a,
        b=b,
        g=problem.numerator(search.eta),
        d=d,
        map=Spline(
            ends / length, change @ search.theta[problem.n_fixed :], structure.degree, structure.extrapolation
        ),
        names=names,
        covariance=_covariance(problem, search, change),
        noise_std=float(np.sqrt(search.noise_variance)),
        residual=search.residual,
        times=problem.times,
        z=problem.taps @ d,
        end_taps=problem.taps[list(basis.ends)],
        straight_rms=_straight_rms(problem, search.eta),
        costs=search.costs,
        agreeing=agreeing,
        searches=searches,
        converged=search.status.converged,
        status=search.status.value + told,
        notes=_notes(problem),
    )


def _covariance(problem: LftProblem, search: SeparableFit, change: Floats) -> Floats:
    """Turn the covariance of (tangents, g, A and B, basis) into that of (A and B, g, d, B-splines)."""
    t, n_g, f = problem.n_tangents, problem.structure.n_g, problem.n_fixed
    size = search.covariance.shape[0]
    by_tangent = problem.tangents - np.outer(problem.centre, problem.centre @ problem.tangents)
    rows = [
        np.eye(size)[t + n_g : t + n_g + f],
        np.eye(size)[t : t + n_g],
        np.column_stack([by_tangent, np.zeros((problem.centre.size, size - t))]),
        np.column_stack([np.zeros((change.shape[0], t + n_g + f)), change]),
    ]
    turn = np.vstack(rows)
    # A coefficient that the data leave open (NaN) must not spoil the others.
    open_ones = np.isnan(np.diag(search.covariance))
    covariance: Floats = turn @ np.where(np.isnan(search.covariance), 0.0, search.covariance) @ turn.T
    lost = np.any(turn[:, open_ones] != 0.0, axis=1)
    covariance[lost, :] = np.nan
    covariance[:, lost] = np.nan
    return covariance


def _straight_rms(problem: LftProblem, eta: Floats) -> float:
    """Return the residual's root mean square with a straight line in place of the map."""
    z = problem.taps @ problem.direction(eta)
    filtered = problem.filtered(np.column_stack([z, np.ones_like(z)]), eta)
    line = project(np.column_stack([problem.fixed, filtered]), problem.y)
    return float(np.sqrt(line.cost / problem.y.size))


def _check_rank(problem: LftProblem, search: SeparableFit) -> None:
    """Refuse a fit in which part of the map, or a lag, is not seen by the data."""
    from sysid.lft.problem import map_basis

    structure = problem.structure
    if structure.basis == "thesis" and structure.degree != 3:
        return  # its functions are not independent of each other
    # The factor's last columns hold R of the regressors, once what the first ones turned is turned back.
    factor = triangle(search.jacobian_factor[:, search.eta.size :])
    norms = np.linalg.norm(factor, axis=0)
    independent = bool(np.all(np.abs(np.diag(factor)) > RANK_TOLERANCE * norms))
    if independent or abs(float(problem.numerator(search.eta).sum())) < 1e-6:
        return
    seen = map_basis(problem.place(search.eta).x, structure)[0]
    missing = structure.n_coefficients - int(np.linalg.matrix_rank(seen))
    if missing:
        raise IdentifiabilityError(
            f"{missing} of {structure.n_coefficients} coefficients of the map have no data, for z "
            f"leaves gaps between the {structure.knots} knots: take fewer knots"
        )
    names = [lag_name("ab", lag, structure) for lag in problem.fixed_lags]
    raise IdentifiabilityError(
        f"the columns of {', '.join(names)} and of the map depend on each other on these rows: take a lag "
        "out, or give an input that excites it"
    )


def _notes(problem: LftProblem) -> tuple[str, ...]:
    structure = problem.structure
    notes = []
    if problem.centre.size > 1:
        notes.append("the sign of d is a convention: -d with the mirrored map is the same model")
    notes.append(
        "the mean of the output is in the map's offset: a constant beside it would be redundant"
        if structure.n_a == 0 and structure.n_g == 0
        else "the mean of the output is in the map's offset, through A(1) and G(1): a constant beside it "
        "would be redundant"
    )
    gone = structure.left_out()
    if gone:
        names = ", ".join(lag_name("ab", lag, structure) for lag in gone)
        notes.append(f"left out, since the slope of the map does the same: {names}")
    return tuple(notes)


def _rise(model: LftFit) -> float:
    """Return -1 if the map falls on the whole over its data."""
    w = model.map(model.z)
    centred = model.z - model.z.mean()
    return -1.0 if float(centred @ (w - w.mean())) < 0.0 else 1.0
