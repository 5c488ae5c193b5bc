"""Piecewise affine LFT models: structure, identifiability, smoothing, alternating and joint fits."""

import numpy as np
import pytest

from sysid.errors import DataError, IdentifiabilityError, ModelError, UsageError
from sysid.lft import (
    GivenRegions,
    PiecewiseLft,
    PiecewiseStructure,
    fit_alternating,
    fit_continuous,
    fit_given_partition,
    fit_joint,
    identifiability,
    inversion,
    rows_of,
    smooth,
)
from sysid.lft.boundaries import Boundaries, improve, middle, regions_of
from sysid.lft.joint import GivenPartition, jacobian
from sysid.nonlinearities.piecewise_affine import GlobalSearch, PiecewiseAffineMap

JUMP = PiecewiseStructure(1, (1,), 1, (("y", 2), ("u", 2)))
LONG = PiecewiseStructure(0, (), 4, (("y", 1), ("u", 1)))


def plant(structure=JUMP):
    if structure is JUMP:
        linear, theta, h = [-0.4, 1.2, -0.5], [[0.5, 1.0, -0.25], [-0.7, 1.5, 0.0]], [1.5, -0.5, 1.0]
    else:
        linear, theta, h = (-0.9) ** np.arange(1, 5), [[0.2, -0.8, -2.2], [-0.5, 0.2, 0.0]], [1.0, 0.0, 1.0]
    return PiecewiseLft.of(structure, linear, PiecewiseAffineMap(theta, [[0.0, 0.0, 0.0], h]))


def record(model, seed, n=1000, noise=0.25):
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, n)
    return u, model.simulate(u, rng.uniform(-noise, noise, n))


def plain_simulation(model, u, e):
    """The equations (5.5)-(5.7) word by word."""
    structure, y, w = model.structure, np.zeros(u.size), {}

    def value(signal, k):
        return signal[k] if k >= 0 else 0.0

    for k in range(-structure.first, u.size):
        z = [value(u if name == "u" else y, k - delay) for name, delay in structure.z_lags]
        w[k] = float(model.map(np.array([z]))[0])
        if k >= 0:
            y[k] = e[k] + w[k]
            y[k] -= sum(a * value(y, k - i) for i, a in enumerate(model.a, 1))
            y[k] += sum(b * value(u, k - d) for b, d in zip(model.b, structure.b_lags, strict=True))
            y[k] += sum(g * w.get(k - i, 0.0) for i, g in enumerate(model.g, 1))
    return y


@pytest.mark.parametrize("structure", [JUMP, LONG])
def test_the_compiled_run_is_the_model_word_by_word(structure):
    rng = np.random.default_rng(1)
    u, e = rng.uniform(-1, 1, 60), 0.1 * rng.standard_normal(60)
    # The same sums in another order: rounding.
    assert np.allclose(plant(structure).simulate(u, e), plain_simulation(plant(structure), u, e), atol=1e-12)


@pytest.mark.parametrize("structure", [JUMP, LONG])
def test_one_step_prediction_leaves_the_equation_error(structure):
    rng = np.random.default_rng(2)
    u, e = rng.uniform(-1, 1, 80), 0.1 * rng.standard_normal(80)
    model = plant(structure)
    y = model.simulate(u, e)
    left = (y - model.one_step(u, y))[structure.first :]
    assert np.allclose(left, e[structure.first :], atol=1e-12)
    assert np.isnan(model.one_step(u, y)[: structure.first]).all()


def test_a_run_goes_on_from_measured_outputs():
    rng = np.random.default_rng(3)
    u = rng.uniform(-1, 1, 50)
    model = plant()
    y = model.simulate(u)
    assert np.allclose(model.simulate(u, initial=y[:10]), y, atol=1e-12)


def test_several_records_give_the_rows_of_each():
    u, y = record(plant(), 4, 60)
    both = rows_of(JUMP, [u[:25], u[25:]], [y[:25], y[25:]])
    ones = [rows_of(JUMP, u[:25], y[:25]), rows_of(JUMP, u[25:], y[25:])]
    assert np.array_equal(both.y, np.concatenate([one.y for one in ones]))
    w = both.phi @ [1.0, 2.0, 3.0]
    expected = [one.delayed(one.phi @ [1.0, 2.0, 3.0], 1) for one in ones]
    assert np.array_equal(both.delayed(w, 1), np.concatenate(expected))
    assert both.lengths == (22, 32)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ((-1, (), 0, (("u", 0),)), "n_a is -1"),
        ((0, (), 0, ()), "no argument"),
        ((0, (1, 1), 0, (("u", 0),)), "a lag twice"),
        ((0, (), 0, (("y", 0),)), "not known at time k"),
        ((0, (-1,), 0, (("u", 0),)), "negative delay"),
    ],
)
def test_structures_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(ModelError, match=words):
        PiecewiseStructure(*settings)


def test_records_that_do_not_fit_are_refused():
    with pytest.raises(DataError, match="no prediction"):
        rows_of(JUMP, np.zeros(3), np.zeros(3))
    with pytest.raises(DataError, match="one value of each"):
        rows_of(JUMP, np.zeros(9), np.zeros(8))
    with pytest.raises(DataError, match="output 4 is nan"):
        rows_of(JUMP, np.zeros(9), np.array([0.0, 0, 0, 0, np.nan, 0, 0, 0, 0]))
    with pytest.raises(DataError, match="give fewer"):
        plant().simulate(np.zeros(3), initial=np.zeros(4))


def rank_deficiency(structure, g, theta, seed=0):
    """Columns of the Jacobian at a random point that depend on the others, by singular values."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(-1, 1, 3000)
    y = rng.standard_normal(3000)  # any regressors: the structure alone decides
    rows = rows_of(structure, u, y)
    h = np.append(rng.standard_normal(rows.phi.shape[1] - 1), 0.1)
    labels = (rows.phi @ h > 0).astype(int)
    linear = np.concatenate([np.zeros(structure.n_known), g])
    columns = jacobian(structure, rows, labels, linear, theta)
    sizes = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
    return int(np.sum(sizes < 1e-10 * sizes[0]))


@pytest.mark.parametrize(
    "structure",
    [
        JUMP,
        LONG,
        PiecewiseStructure(0, (1,), 0, (("y", 1), ("u", 1))),
        PiecewiseStructure(1, (), 1, (("y", 1),)),
        PiecewiseStructure(2, (), 1, (("y", 1),)),
        PiecewiseStructure(0, (2,), 1, (("u", 1),)),
        PiecewiseStructure(0, (1, 2), 1, (("u", 1),)),
        PiecewiseStructure(0, (1, 3), 1, (("u", 1), ("u", 2))),
    ],
)
def test_the_identifiability_condition_is_the_rank_of_the_jacobian(structure):
    rng = np.random.default_rng(6)
    g = rng.uniform(0.3, 0.8, structure.n_g)
    theta = rng.standard_normal((2, len(structure.z_lags) + 1))
    assert identifiability(structure, g).free.shape[0] == rank_deficiency(structure, g, theta)


def test_common_columns_are_named():
    found = identifiability(PiecewiseStructure(2, (), 1, (("y", 1),)))
    assert "y(k-1) appears in both A(q) y (a1) and w(k)" in str(found)
    assert "y(k-2) appears in both A(q) y (a2) and w(k-1)" in str(found)
    assert found.undetermined == ("y(k-1)",)


def test_lemma_5_1_is_not_necessary():
    found = identifiability(PiecewiseStructure(0, (2,), 1, (("u", 1),)))
    assert not found.lemma
    assert found.identifiable
    assert "although Lemma 5.1 fails" in str(found)


def test_a_filter_without_gain_leaves_the_offset_free():
    found = identifiability(PiecewiseStructure(0, (), 1, (("u", 1),)), g=[-1.0])
    assert not found.identifiable
    assert found.undetermined == ("1",)
    assert "G(1) = 0" in str(found)


def test_fits_refuse_a_structure_that_is_not_identifiable():
    structure = PiecewiseStructure(1, (), 0, (("y", 1),))
    with pytest.raises(IdentifiabilityError, match=r"y\(k-1\) appears in both A\(q\) y \(a1\) and w\(k\)"):
        fit_alternating(np.zeros(50), np.zeros(50), structure, GlobalSearch(2))


@pytest.mark.parametrize("g", [[], [0.5], [2.0], [-0.9, 0.81, -0.729, 0.6561], [2.5, 1.0]])
def test_smoothing_is_the_minimum_norm_solution(g):
    r = np.random.default_rng(7).standard_normal(40)
    matrix = np.array([np.convolve(np.append(1.0, g), row)[len(g) :] for row in np.eye(40 + len(g))]).T[:40]
    expected = np.linalg.lstsq(matrix, r)[0]
    # Both solve a system of condition below 1e2 squared.
    assert np.allclose(smooth(r, g), expected, atol=1e-11)


def test_smoothing_treats_experiments_apart():
    r = np.random.default_rng(8).standard_normal(30)
    apart = np.concatenate([smooth(r[:12], [0.7]), smooth(r[12:], [0.7])])
    assert np.array_equal(smooth(r, [0.7], [12, 18]), apart)


def test_smoothing_stays_bounded_where_a_recursion_blows_up():
    rng = np.random.default_rng(9)
    v = rng.standard_normal(5001)
    r = v[1:] + 2.0 * v[:-1]
    forward = 0.0
    for value in r[:200]:
        forward = value - 2.0 * forward
    assert abs(forward) > 1e50
    assert np.abs(smooth(r, [2.0])).max() < 10
    # Away from the ends the least-norm solution forgets them.
    assert np.allclose(smooth(r, [2.0])[:-60], v[:-60], atol=1e-10)


def test_it_is_said_where_the_zeros_lie():
    assert "nothing to invert" in str(inversion([]))
    assert "decay forward" in str(inversion([0.5]))
    assert "either direction" in str(inversion([2.5, 1.0]))
    assert "unit circle: v is not determined" in str(inversion([1.0]))


@pytest.mark.parametrize("structure", [JUMP, LONG])
def test_the_derivatives_are_those_of_the_predictions(structure):
    model = plant(structure)
    u, y = record(model, 10, 200)
    rows = rows_of(structure, u, y)
    labels, theta = model.map.mode(rows.z), model.map.theta
    found = jacobian(structure, rows, labels, model.linear, theta)
    point = np.concatenate([model.linear, theta.ravel()])

    def predicted(values):
        linear, flat = np.split(values, [structure.n_linear])
        map_ = PiecewiseAffineMap(flat.reshape(theta.shape), model.map.separators)
        return PiecewiseLft.of(structure, linear, map_).predict(rows)

    for i, step in enumerate(1e-6 * np.eye(point.size)):
        difference = (predicted(point + step) - predicted(point - step)) / 2e-6
        assert np.allclose(found[:, i], difference, atol=1e-8)  # rounding over the step


def test_variable_projection_reaches_the_minimum_of_all_parameters():
    model = plant()
    u, y = record(model, 11)
    rows = rows_of(JUMP, u, y)
    labels = model.map.mode(rows.z)
    linear, theta, found = fit_given_partition(JUMP, rows, labels, 2, [0.0])
    gradient = jacobian(JUMP, rows, labels, linear, theta).T @ found.residual
    assert np.abs(gradient).max() < 1e-5 * found.cost
    design = GivenPartition.of(rows, labels, 2)
    assert np.allclose(found.residual, rows.y - design.regressors(found.eta) @ found.theta, atol=1e-10)


def test_a_line_of_boundaries_is_minimised_exactly():
    model = plant()
    u, y = record(model, 12, 150)
    rows = rows_of(JUMP, u, y)
    target = rows.y - rows.known @ model.linear[:2]
    boundaries = Boundaries(rows, model.map.theta, np.append(1.0, model.g), target)
    rng = np.random.default_rng(13)
    for _ in range(10):
        separators, direction = rng.standard_normal((2, 3)), rng.standard_normal(3)
        step, cost = boundaries.line(separators, 1, direction)

        def at(t, separators=separators, direction=direction):
            moved = separators + np.outer([0.0, 1.0], t * direction)
            return float(np.sum(boundaries.residual(regions_of(moved, rows.phi)) ** 2))

        assert np.isclose(at(step), cost, rtol=1e-12)
        # No other cell is better: between any two thresholds, on a fine grid.
        assert cost <= min(at(t) for t in np.linspace(-20, 20, 801)) * (1 + 1e-12)


def test_three_modes_are_improved_too():
    structure = PiecewiseStructure(0, (), 1, (("u", 1),))
    stairs = PiecewiseAffineMap.of_breakpoints([[0.5, 1.0], [0.5, 0.0], [0.5, -1.5]], [-0.3, 0.4])
    model = PiecewiseLft.of(structure, [0.4], stairs)
    u, y = record(model, 14, 600, 0.1)
    off = PiecewiseAffineMap.of_breakpoints(stairs.theta, [-0.45, 0.55])
    found = fit_joint(u, y, PiecewiseLft.of(structure, [0.0], off))
    # Boundaries lie between neighbouring samples of u, 1/300 apart on the average.
    assert np.allclose(found.model.map.tau, [-0.3, 0.4], atol=0.02)
    assert np.array_equal(found.labels, stairs.mode(rows_of(structure, u, y).z))


def test_the_middle_leaves_every_sample_where_it_is():
    model = plant()
    rows = rows_of(JUMP, *record(model, 15, 300))
    moved = middle(model.map.separators, rows, np.random.default_rng(0))
    assert np.array_equal(regions_of(moved, rows.phi), regions_of(model.map.separators, rows.phi))


def test_improving_never_raises_the_cost():
    model = plant()
    rows = rows_of(JUMP, *record(model, 16, 300))
    target = rows.y - rows.known @ model.linear[:2]
    boundaries = Boundaries(rows, model.map.theta, np.append(1.0, model.g), target)
    start = model.map.separators + 0.3 * np.random.default_rng(1).standard_normal((2, 3))
    found = improve(boundaries, start, np.random.default_rng(2))
    cost = [float(np.sum(boundaries.residual(regions_of(s, rows.phi)) ** 2)) for s in (start, found)]
    assert cost[1] < 0.5 * cost[0]


@pytest.mark.parametrize("structure", [JUMP, LONG])
def test_the_joint_fit_equals_that_of_the_known_partition(structure):
    """Jumps are several times the noise, so that every sample finds its mode."""
    model = plant(structure)
    u, y = record(model, 17, noise=0.2)
    rows = rows_of(structure, u, y)
    rng = np.random.default_rng(18)
    off = PiecewiseAffineMap(
        model.map.theta + 0.1 * rng.standard_normal((2, 3)),
        model.map.separators + 0.15 * np.outer([0, 1], rng.standard_normal(3)),
    )
    found = fit_joint(u, y, PiecewiseLft.of(structure, 0.8 * model.linear, off))
    linear, theta, _ = fit_given_partition(structure, rows, model.map.mode(rows.z), 2, model.g)
    # Two searches that stop at a relative step of 1e-9, on parameters of condition below 1e3.
    assert np.allclose(found.model.linear, linear, atol=1e-5)
    assert np.allclose(found.model.map.theta, theta, atol=1e-5)
    assert list(found.costs) == sorted(found.costs, reverse=True)
    errors = np.array([found.model.values[name] - model.values[name] for name in model.values])
    assert np.abs(errors / np.sqrt(np.diag(found.covariance))).max() < 4.5  # ten estimates


def test_the_alternating_fit_is_biased_and_the_joint_fit_is_not():
    model = plant(LONG)
    u, y = record(model, 19, 20_000, 0.2)
    alternating = fit_alternating(
        u, y, LONG, GivenRegions(model.map), constant=True, threshold=1e-6, max_iterations=200
    )
    joint = fit_joint(u, y, alternating.model)
    error = joint.std_errors["theta1_1"]
    assert abs(joint.model.values["theta1_1"] - 0.2) < 4 * error
    assert alternating.model.values["theta1_1"] - 0.2 > 8 * error


def test_alternating_follows_its_stages_and_tells_its_stop():
    model = plant()
    u, y = record(model, 20)
    used = []

    def stage(name):
        def fit(z, w, rng):
            used.append(name)
            return GivenRegions(model.map)(z, w, rng)

        return fit

    found = fit_alternating(u, y, JUMP, [stage("first"), stage("later")], threshold=1e-2)
    assert used == ["first"] + ["later"] * (found.iterations - 1)
    assert found.converged
    assert "the fixed point is" in found.status
    short = fit_alternating(u, y, JUMP, stage("x"), max_iterations=2)
    assert not short.converged
    assert "raise max_iterations" in short.status


def test_a_free_constant_hastens_the_kink_and_moves_into_the_map():
    structure = PiecewiseStructure(1, (), 0, (("u", 0),))
    hinge = PiecewiseAffineMap.of_breakpoints([[-0.5, 0.0], [1.0, 0.0]], [0.0])
    rng = np.random.default_rng(21)
    u = rng.uniform(-2, 2, 300)
    y = PiecewiseLft.of(structure, [-0.8], hinge).simulate(u, rng.uniform(-0.2, 0.2, 300))
    settings = {"start": [-0.5], "max_iterations": 100}
    creeping = fit_alternating(u, y, structure, GlobalSearch(2), **settings)
    quick = fit_alternating(u, y, structure, GlobalSearch(2), constant=True, **settings)
    assert quick.iterations < 8 < creeping.iterations
    assert quick.cost < creeping.cost
    assert abs(quick.model.a[0] + 0.8) < 0.05


def test_alternating_refuses_what_it_cannot_use():
    u, y = record(plant(), 22, 60)
    with pytest.raises(UsageError, match="a1, b1, g1"):
        fit_alternating(u, y, JUMP, GlobalSearch(2), start=[0.0])
    with pytest.raises(UsageError, match="threshold"):
        fit_alternating(u, y, JUMP, GlobalSearch(2), threshold=0.0)


def test_a_mode_with_too_few_samples_is_refused():
    model = plant()
    u, y = record(model, 23, 60)
    empty = PiecewiseAffineMap(model.map.theta, [[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    with pytest.raises(ModelError, match="mode 2 holds 0 samples"):
        fit_joint(u, y, PiecewiseLft.of(JUMP, model.linear, empty))


def test_the_continuous_fit_has_honest_errors_and_a_continuous_map():
    structure = PiecewiseStructure(1, (), 1, (("u", 0),))
    hinge = PiecewiseAffineMap.of_breakpoints([[-0.5, 0.0], [1.0, 0.0]], [0.0])
    true = PiecewiseLft.of(structure, [-0.8, 0.3], hinge)
    scores = []
    for seed in range(60):
        rng = np.random.default_rng([24, seed])
        u = rng.uniform(-2, 2, 300)
        y = true.simulate(u, rng.uniform(-0.2, 0.2, 300))
        near = PiecewiseAffineMap.of_breakpoints(hinge.theta, [0.4])
        found = fit_continuous(u, y, PiecewiseLft.of(structure, [-0.6, 0.0], near))
        tau = found.model.map.tau[0]
        left, right = found.model.map.theta @ [tau, 1.0]
        assert np.isclose(left, right, atol=1e-12)
        values = np.concatenate([found.model.linear, found.model.map.theta.ravel(), found.hinges.ravel()])
        truth = np.array([-0.8, 0.3, -0.5, 0.0, 1.0, 0.0, 1.0, 0.0])
        sizes = np.sqrt(np.diag(found.covariance))
        assert sizes[6] == 0.0
        scores.append(((values - truth)[sizes > 0]) / sizes[sizes > 0])
    # Sixty runs: the standard deviation of a score is 1 within 4/sqrt(120), its mean 0 within 4/sqrt(60).
    assert np.all(np.abs(np.std(scores, axis=0) - 1) < 0.37)
    assert np.all(np.abs(np.mean(scores, axis=0)) < 0.52)


def test_a_kink_in_the_plane_is_found():
    structure = PiecewiseStructure(1, (), 1, (("u", 1), ("u", 2)))
    h = np.array([1.0, -0.5, 0.2])
    common = np.array([0.3, 0.6, -0.1])
    bent = PiecewiseAffineMap(np.vstack([common, common + 1.5 * h]), np.vstack([np.zeros(3), h]))
    true = PiecewiseLft.of(structure, [-0.5, 0.4], bent)
    u, y = record(true, 25, 800, 0.1)
    near = PiecewiseAffineMap(bent.theta, np.vstack([np.zeros(3), [1.0, -0.2, 0.4]]))
    found = fit_continuous(u, y, PiecewiseLft.of(structure, [-0.4, 0.2], near))
    sizes = np.sqrt(np.diag(found.covariance))
    values = np.concatenate([found.model.linear, found.model.map.theta.ravel(), found.hinges.ravel()])
    truth = np.concatenate([true.linear, bent.theta.ravel(), h])
    assert np.abs((values - truth)[sizes > 0] / sizes[sizes > 0]).max() < 4.5  # ten estimates


def test_a_continuous_map_of_many_modes_in_the_plane_is_refused():
    three = PiecewiseAffineMap(np.ones((3, 3)), np.eye(3))
    with pytest.raises(ModelError, match="two modes, or one argument"):
        fit_continuous(np.zeros(50), np.zeros(50), PiecewiseLft.of(JUMP, [0.0, 0.0, 0.0], three))
