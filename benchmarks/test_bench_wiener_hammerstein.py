"""One linearisation of a Wiener-Hammerstein model, and a fit, beside the same with scipy's filters.

Only ratios of times in one run mean anything; no time is asserted.  The figures are kept in ``extra_info``.
"""

import time

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from sysid.data import make_record
from sysid.lft import LinearBlock, WienerHammerstein, fit_wiener_hammerstein
from sysid.lft.wiener_hammerstein.columns import Columns
from sysid.lft.wiener_hammerstein.reduction import Point, Problem
from sysid.linear.reduction import Segment
from sysid.nonlinearities.spline import Spline, spline_basis

REPEATS = 5


def seconds(function, repeats=REPEATS):
    function()  # compiled and in the cache
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        function()
        times.append(time.process_time() - begin)
    return times


def ratio(slow, fast):
    """Median of the ratios of runs side by side, with its quartiles."""
    return tuple(float(q) for q in np.quantile(np.divide(slow, fast), [0.5, 0.25, 0.75]))


@pytest.fixture(autouse=True)
def one_blas_thread():
    """Compare algorithms, not numbers of threads."""
    with threadpool_limits(1):
        yield


@pytest.fixture
def table(capsys):
    """Print a line of a table past pytest's capture."""

    def line(text):
        with capsys.disabled():
            print(text)

    return line


def circuit():
    """Return a system like the measured circuit: two blocks of third order, a one-sided bend."""
    front_poles = np.array([0.72, 0.73 + 0.44j, 0.73 - 0.44j])
    back_poles = np.array([0.82, 0.89 + 0.17j, 0.89 - 0.17j])
    front = LinearBlock.from_poles(front_poles, np.array([0.01, 0.03, 0.03, 0.01]))
    back = LinearBlock.from_poles(back_poles, np.array([0.01, 0.0, 0.01, 0.01]))
    z = np.linspace(-4.0, 4.0, 400)
    bend = Spline.fitted(z, np.where(z < 0.5, z, 0.5 + 0.1 * (z - 0.5)), np.linspace(-4.0, 4.0, 24))
    return WienerHammerstein(front.scaled(1 / front.response([0.0])[0].real), bend, back)


def scipy_columns(model, u):
    """The same derivatives by one scipy filter a column: numerators and denominators as polynomials."""
    front, back = model.front, model.back
    z = lfilter(front.b, front.a, u)
    slope = model.map.slope(z)
    one = np.array([1.0])
    by_a = lfilter(one, front.a, -z)
    by_b = lfilter(one, front.a, u)
    inner = [slope * np.roll(by_a, i) for i in range(1, front.order + 1)]
    inner += [slope * np.roll(by_b, i) for i in range(front.order + 1)]
    basis = spline_basis(z, model.map.knots)
    w = basis @ model.map.coefficients
    y = lfilter(back.b, back.a, w)
    through = lfilter(back.b, back.a, np.column_stack([basis, *inner]), axis=0)
    outer = [np.roll(lfilter(one, back.a, -y), i) for i in range(1, back.order + 1)]
    outer += [np.roll(lfilter(one, back.a, w), i) for i in range(back.order + 1)]
    return np.column_stack([through, *outer])


@pytest.mark.parametrize("n_rows", [20_000, 100_000])
def test_linearisation_against_scipy_filters(benchmark, table, n_rows):
    """All columns and their triangular factor: streaming kernels and blocked QR, or filters and one QR."""
    rng = np.random.default_rng(0)
    model, u = circuit(), rng.standard_normal(n_rows)
    y = model.simulate(u)
    problem = Problem((Segment(u[:, np.newaxis], y, np.ones(n_rows, bool)),), model)

    def plain():
        return np.linalg.qr(np.column_stack([scipy_columns(model, u), y]), mode="r")

    def ours():
        point = Point(problem, problem.start)
        point._projection = (0.0, model.map.coefficients)  # the map is known here, as it is to the other
        return point.triangle

    columns = Columns(model, u, derivatives=True).next_rows(n_rows)
    # Equal spans: the residual of one set of columns on the other is rounding.
    theirs = scipy_columns(model, u)[200:]
    left = theirs - columns[200:] @ np.linalg.lstsq(columns[200:], theirs, rcond=None)[0]
    assert np.abs(left).max() < 1e-6 * np.abs(theirs).max()
    slow, fast = seconds(plain), seconds(ours)
    middle, low, high = ratio(slow, fast)
    benchmark.extra_info.update(ratio=middle, quartiles=[low, high], rows=n_rows)
    table(
        f"linearisation, {n_rows} rows: scipy's filters and QR take {middle:.1f} ({low:.1f}-{high:.1f}) "
        "times as long"
    )
    benchmark.pedantic(ours, rounds=3)


def test_map_between_samples_costs(benchmark, table):
    """A map at two points a sampling period, against one at samples."""
    from dataclasses import replace

    rng = np.random.default_rng(1)
    u = rng.standard_normal(50_000)
    points = {}
    for oversampling in (1, 2):
        model = replace(circuit(), oversampling=oversampling)
        problem = Problem((Segment(u[:, np.newaxis], u, np.ones(u.size, bool)),), model)
        points[oversampling] = lambda problem=problem: Point(problem, problem.start).triangle
    slow, fast = seconds(points[2]), seconds(points[1])
    middle, low, high = ratio(slow, fast)
    benchmark.extra_info.update(ratio=middle, quartiles=[low, high])
    table(f"linearisation, map at two points a period: {middle:.1f} ({low:.1f}-{high:.1f}) times as long")
    benchmark.pedantic(points[2], rounds=2)


def test_fit_against_scipy_least_squares(benchmark, table):
    """A whole fit from a start near the truth: map eliminated, exact derivatives, or all by differences."""
    rng = np.random.default_rng(2)
    truth, u = circuit(), rng.standard_normal(4_000)
    y = truth.simulate(u) + 1e-3 * rng.standard_normal(u.size)
    record = make_record(u, y, period=1.0)
    spread = 1.0 + 0.002 * rng.standard_normal(truth.vector.size)
    start = truth.with_vector(truth.vector * spread)

    def ours():
        return fit_wiener_hammerstein(record, start=start, knots=23)

    def plain():
        def residual(vector):
            return truth.with_vector(vector).simulate(u)[200:] - y[200:]

        return least_squares(residual, start.vector, method="lm", max_nfev=3_000)

    begin = time.process_time()
    found = plain()
    slow = time.process_time() - begin
    fast = float(np.median(seconds(ours, 3)))
    fit = ours()
    plain_rms = float(np.sqrt(2.0 * found.cost / (u.size - 200)))
    benchmark.extra_info.update(ratio=slow / fast, rms=fit.rms, plain_rms=plain_rms)
    table(
        f"fit: scipy.optimize.least_squares with differences takes {slow / fast:.0f} times as long "
        f"(rms {plain_rms:.3g} against {fit.rms:.3g}, noise 1e-3)"
    )
    benchmark.pedantic(ours, rounds=2)
