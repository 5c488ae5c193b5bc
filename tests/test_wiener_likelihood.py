"""Maximum likelihood, its bound and the scores, against quadrature, closed forms and other minimisers."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import norm

from sysid.errors import DataError, IdentifiabilityError, UsageError
from sysid.linear import simulate_polynomial
from sysid.nonlinearities import (
    DEAD_ZONE,
    EVEN_DEAD_ZONE,
    SIGN,
    MonotonePieces,
    PiecewiseAffine,
    Quantiser,
    sine,
)
from sysid.wiener import (
    frequency_response,
    identify_wiener,
    information_bound,
    maximum_likelihood,
    naive_fit,
    score,
)
from sysid.wiener.likelihood import log_likelihood, simulate
from sysid.wiener.maximum_likelihood import stabilised
from sysid.wiener.response import circle_norm, relative_h2
from sysid.wiener.truncated import interval_moments

TRUE = np.array([-1.03, 0.9048, 0.0, 0.445, 0.4299])
IDENTITY = MonotonePieces("identity", lambda y: y, [-np.inf, np.inf], lambda i, z: z)
DEAD = PiecewiseAffine.of(DEAD_ZONE, 1.0)


def record(seed, samples, noise):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = simulate_polynomial(TRUE[2:], [1.0, *TRUE[:2]], u)
    return u, y, y + noise * rng.standard_normal(samples)


INTERVALS = [
    (-1.0, 2.0), (0.5, 0.6), (3.0, 4.0), (9.0, 12.0), (20.0, 20.3), (-40.0, -39.5), (0.0, np.inf),
    (-np.inf, 5.0), (6.0, np.inf), (30.0, np.inf), (-np.inf, np.inf), (1e-3, 2e-3), (7.9, 9.0),
    (-np.inf, -12.0), (-0.001, 0.3),
]  # fmt: skip


@pytest.mark.parametrize(("low", "high"), INTERVALS)
def test_moments_of_an_interval_are_those_of_quadrature(low, high):
    moments = np.empty(4)
    log_mass = interval_moments(low, high, moments)
    # Scaled by the density at the end nearest to zero, so that the far tails do not underflow, and cut where
    # the integrand has fallen below 1e-20.
    near = min(max(low, 0.0), high) if high >= 0 else high
    scale = 0.5 * near * near
    reach = 12.0 if near == 0 else min(12.0, 60.0 / abs(near))
    a, b = max(low, near - reach), min(high, near + reach)

    nodes, weights = np.polynomial.legendre.leggauss(40)
    edges = np.linspace(a, b, 61)
    centre, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    t = centre[:, np.newaxis] + half[:, np.newaxis] * nodes

    def integral(power):
        return float(np.sum(half[:, np.newaxis] * weights * t**power * np.exp(scale - 0.5 * t**2)))

    mass = integral(0)
    assert log_mass == pytest.approx(math.log(mass) - scale - 0.5 * math.log(2 * math.pi), abs=1e-10)
    for power in range(4):
        size = max(1.0, abs(near)) ** (power + 1)
        assert moments[power] == pytest.approx(integral(power + 1) / mass, abs=1e-9 * size)


def test_sensitivities_are_those_of_finite_differences():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(30)
    point = np.concatenate([TRUE + 0.05, [0.3, -0.2]])
    _, sensitivity = simulate(u, point[:5], point[5:], 2)
    for j, direction in enumerate(np.eye(7)):
        ahead, behind = (
            simulate(u, one[:5], one[5:], 2)[0]
            for one in (point + 1e-6 * direction, point - 1e-6 * direction)
        )
        # Second-order differences with a step of 1e-6: rounding of 1e-9 of outputs of order ten.
        np.testing.assert_allclose(sensitivity[j], (ahead - behind) / 2e-6, atol=1e-7)
    np.testing.assert_allclose(
        simulate(u, TRUE, np.zeros(2), 2)[0], simulate_polynomial(TRUE[2:], [1.0, *TRUE[:2]], u), atol=1e-12
    )


@pytest.mark.parametrize(
    "known",
    [IDENTITY, sine((-8.0, 8.0)), DEAD, Quantiser(0.7), SIGN, PiecewiseAffine.of(EVEN_DEAD_ZONE, 0.5)],
)
def test_score_and_information_are_the_derivatives_of_the_likelihood(known):
    u, _, x = record(1, 30, 0.3)
    preimage = known.preimage(known(x))
    arrays = (preimage.first, preimage.lower, preimage.upper, preimage.weight)
    point = np.concatenate([TRUE + 0.03, [0.1, -0.1, math.log(0.4)]])
    _, gradient, information, _ = log_likelihood(u, *arrays, point, 2)
    step = 1e-5
    for j, direction in enumerate(np.eye(8)):
        ahead, behind = (log_likelihood(u, *arrays, point + s * step * direction, 2) for s in (1, -1))
        scale = 1.0 + abs(information[j, j])
        assert gradient[j] == pytest.approx((ahead[0] - behind[0]) / (2 * step), abs=1e-6 * scale)
        if known is IDENTITY or j == 7:  # linear in the model's output: no curvature of the output itself
            continue
        output_information = -(ahead[1][7] - behind[1][7]) / (2 * step)
        assert information[j, 7] == pytest.approx(output_information, abs=1e-5 * scale)
    # The observed information leaves out the curvature of y, so its noise entry is the one to hold exactly.
    ahead, behind = (log_likelihood(u, *arrays, point + s * step * np.eye(8)[7], 2) for s in (1, -1))
    assert information[7, 7] == pytest.approx(-(ahead[1][7] - behind[1][7]) / (2 * step), rel=1e-5)


def test_without_a_nonlinearity_it_is_the_output_error_fit():
    u, _, z = record(2, 80, 0.2)
    found = maximum_likelihood(u, z, IDENTITY, [naive_fit(u, z, 2)])

    def residual(p):
        return simulate(u, p[:5], p[5:], 2)[0] - z

    other = least_squares(residual, [*TRUE, 0.0, 0.0], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.theta, other.x[:5], atol=1e-6)
    assert found.noise == pytest.approx(np.sqrt(np.mean(other.fun**2)), rel=1e-6)
    expected = 0.2**2 * np.linalg.inv(other.jac.T @ other.jac)[:5, :5]
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(expected)), rtol=0.3)


@pytest.mark.parametrize(("known", "samples"), [(sine(), 20), (DEAD, 30), (Quantiser(1.0), 50), (SIGN, 60)])
def test_it_starts_from_the_preimage_estimate_and_ends_at_a_maximum(known, samples):
    u, y, _ = record(11, samples, 0.0)
    x = np.clip(y + 0.1 * np.random.default_rng(3).standard_normal(samples), -6.2, 6.2)
    fit = identify_wiener(u, known(x), known, 2, keep=5)
    found = maximum_likelihood(u, known(x), known, fit)
    assert found.converged
    preimage = known.preimage(known(x))
    arrays = (preimage.first, preimage.lower, preimage.upper, preimage.weight)
    at = np.concatenate([found.theta, found.state, [math.log(found.noise)]])
    used = 7 if known is SIGN else 8
    rng = np.random.default_rng(0)
    for _ in range(50):  # no small step goes up
        step = np.zeros(8)
        step[:used] = 1e-3 * rng.standard_normal(used)
        assert log_likelihood(u, *arrays, at + step, 2)[0] <= found.log_likelihood + 1e-6
    np.testing.assert_allclose(found.y, simulate(u, found.theta, found.state, 2)[0])
    assert score(found.theta, TRUE, 2, match_gain=known is SIGN).rms_db < 4


def test_separated_signs_are_told():
    u, y, _ = record(4, 60, 0.0)
    found = maximum_likelihood(u, SIGN(y), SIGN, identify_wiener(u, SIGN(y), SIGN, 2))
    assert "the data are separated" in found.status
    np.testing.assert_array_equal(found.simulate(u), SIGN(simulate_polynomial(found.b, found.a, u)))


def test_the_bound_without_a_nonlinearity_is_that_of_the_output_error():
    u, _, _ = record(5, 60, 0.0)
    _, sensitivity = simulate(u, TRUE, np.zeros(2), 2)
    expected = 0.3**2 * np.linalg.inv(sensitivity @ sensitivity.T)[:5, :5]
    # The midpoint rule reaches to five standard deviations: it leaves out 1e-5 of the information.
    np.testing.assert_allclose(information_bound(u, TRUE, 0.3, IDENTITY, 2), expected, rtol=1e-4)


def test_the_bound_behind_sign_is_that_of_a_probit():
    u, y, _ = record(6, 400, 0.0)
    _, sensitivity = simulate(u, TRUE, np.zeros(2), 2)
    t = y / 0.5
    weight = norm.pdf(t) ** 2 / (norm.cdf(t) * norm.sf(t)) / 0.5**2
    expected = np.linalg.inv((sensitivity * weight) @ sensitivity.T)[:5, :5]
    # The jump of z falls between two of 2000 points of the quadrature.
    np.testing.assert_allclose(information_bound(u, TRUE, 0.5, SIGN, 2, points=2000), expected, rtol=0.03)


def test_less_information_means_a_larger_bound():
    u, _, _ = record(7, 80, 0.0)
    bounds = [
        np.diag(information_bound(u, TRUE, 0.2, known, 2))
        for known in (IDENTITY, Quantiser(0.5), Quantiser(2.0))
    ]
    assert np.all(bounds[0] < bounds[1])
    assert np.all(bounds[1] < bounds[2])


def test_frequency_response_and_norms():
    omega = np.linspace(0.01, 3.1, 50)
    z = np.exp(-1j * omega)
    expected = (TRUE[3] * z + TRUE[4] * z**2) / (1 + TRUE[0] * z + TRUE[1] * z**2)
    np.testing.assert_allclose(frequency_response(TRUE, 2, omega), expected, rtol=1e-12)
    impulse = simulate_polynomial(TRUE[2:], [1.0, *TRUE[:2]], np.eye(1, 2000)[0])
    assert circle_norm(TRUE[2:], np.array([1.0, *TRUE[:2]])) == pytest.approx(
        np.linalg.norm(impulse), rel=1e-10
    )
    grid = np.exp(-2j * np.pi * np.arange(4096) / 4096)
    unstable = np.array([-2.2, 1.3, 0.1, 0.4, 0.3])

    def on_grid(theta):
        return np.polyval(theta[:1:-1], grid) / np.polyval([theta[1], theta[0], 1.0], grid)

    for theta in (np.array([-0.9, 0.8, 0.1, 0.5, 0.3]), unstable):
        difference = on_grid(theta) - on_grid(TRUE)
        direct = np.sqrt(np.mean(np.abs(difference) ** 2) / np.mean(np.abs(on_grid(TRUE)) ** 2))
        assert relative_h2(theta, TRUE, 2) == pytest.approx(direct, rel=1e-8)
    np.testing.assert_allclose(
        np.abs(on_grid(stabilised(unstable, 2))), np.abs(on_grid(unstable)), rtol=1e-9, atol=1e-12
    )
    assert not score(unstable, TRUE, 2).stable


def test_scores():
    louder = np.append(TRUE[:2], 2 * TRUE[2:])
    found = score(louder, TRUE, 2)
    assert (found.rms_db, found.max_db) == (
        pytest.approx(20 * math.log10(2)),
        pytest.approx(20 * math.log10(2)),
    )
    assert found.rms_deg == pytest.approx(0.0, abs=1e-9)
    assert found.relative_h2 == pytest.approx(1.0)
    matched = score(louder, TRUE, 2, match_gain=True)
    assert (matched.rms_db, matched.relative_h2) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))
    turned = score(np.append(TRUE[:2], -TRUE[2:]), TRUE, 2, match_gain=True)
    assert turned.rms_deg == pytest.approx(180)
    peak = score(TRUE, TRUE, 2)
    assert peak.peak_frequency == pytest.approx(0.998, abs=0.01)
    dense = np.abs(frequency_response(TRUE, 2, np.linspace(0.9, 1.1, 2001)))
    assert peak.peak_db == pytest.approx(
        20 * math.log10(dense.max()), abs=0.02
    )  # the window's grid is coarser


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: maximum_likelihood(np.ones(5), np.ones(4), SIGN, [TRUE]), DataError, "do not match"),
        (
            lambda: maximum_likelihood(np.ones(5), np.ones(5), SIGN, [TRUE]),
            IdentifiabilityError,
            "8 unknowns",
        ),
        (lambda: information_bound(np.ones(9), TRUE, 0.0, SIGN, 2), UsageError, "the noise is 0"),
        (lambda: information_bound(np.ones(9), TRUE, 0.1, SIGN, 2), IdentifiabilityError, "singular"),
        (lambda: score([np.nan] * 5, TRUE, 2), UsageError, "are not finite"),
    ],
)
def test_bad_input_is_one_clear_error(call, error, message):
    with pytest.raises(error, match=message):
        call()
