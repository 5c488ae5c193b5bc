"""Printing errors of the paper: each printed form shown wrong by a number, its correction shown right.

Small typographical damage that leaves the meaning clear is not listed.
"""

import math

import numpy as np

from replications.errata import Erratum
from replications.giri import setting
from replications.giri.excitation import COUNTER_POLE, counter_example, period_rows, plant_with_pole
from replications.giri.identifiability import UNKNOWNS, determined_directions
from replications.giri.setting import Floats
from sysid.excitation import impulse_levels
from sysid.nonlinearities import Segments
from sysid.recursive import (
    ProjectionGradient,
    Snapshot,
    excitation_of,
    interpolation_coefficients,
    interpolation_polynomial,
    recover,
    regressors,
    stationary_period,
)


def errata() -> list[Erratum]:
    """Return every erratum with its numbers."""
    return [
        _example_polynomials(),
        _theta_order(),
        _theta_digits(),
        _normalisation(),
        _sign_of_dead_zone(),
        _dead_zone_bound(),
        _four_parameters(),
        _composite_matrix(),
        _zero_vector(),
        _sphere(),
        _missing_assumption(),
    ]


def truncated(values: Floats, decimals: int = 2) -> Floats:
    """Cut decimals off, as the paper does; a slack keeps 0.56 from becoming 0.55."""
    scale = 10.0**decimals
    return np.trunc(values * scale * (1.0 + 1e-12)) / scale


def as_printed(a: Floats, b: Floats) -> Floats:
    """Return theta* with the a's reversed and two decimals, as the paper lists it."""
    mu = np.outer(setting.gains(), b).ravel()
    return truncated(np.concatenate([a[::-1], mu]))


def _example_polynomials() -> Erratum:
    """Section V.C: two powers of q are lost."""
    literal = as_printed(np.array([sum(setting.A), 0.0]), np.array([sum(setting.B), 0.0]))
    corrected = as_printed(np.array(setting.A), np.array(setting.B))
    return Erratum(
        "example-polynomials",
        "Section V.C, A and B",
        r"A = 1 - 1.5q^{-1} + 0.56q^{-1},\quad B = q^{-1} - 2q^{-1}",
        r"A = 1 - 1.5q^{-1} + 0.56q^{-2},\quad B = q^{-1} - 2q^{-2}",
        "largest difference between the printed theta* and that of the stated plant, listed alike",
        float(np.max(np.abs(literal - setting.PRINTED_THETA))),
        float(np.max(np.abs(corrected - setting.PRINTED_THETA))),
        "Only with second powers does the plant have the printed parameter vector.",
    )


def _theta_order() -> Erratum:
    """Section V.C: theta* lists a_2 before a_1, against (3.8c)."""
    u, y = setting.experiment(20)
    rows = regressors(u, y, setting.ORDER, setting.LEVELS)
    exact = setting.theta_star()
    reversed_a = exact.copy()
    reversed_a[: setting.ORDER] = exact[: setting.ORDER][::-1]
    errors = [float(np.max(np.abs(y - rows @ theta)) / np.max(np.abs(y))) for theta in (reversed_a, exact)]
    return Erratum(
        "theta-order",
        "Section V.C, theta*",
        r"\theta^* = [a_2\ a_1\ \mu_{11}\ \mu_{21}\ \dots]^T",
        r"\theta^* = [a_1\ a_2\ \mu_{11}\ \mu_{21}\ \dots]^T",
        "largest one-step error on the noise-free example, relative to the largest output",
        errors[0],
        errors[1],
        "The regressor (3.8b) begins with -y(t-1), so a1 = -1.5 comes first.",
    )


def _theta_digits() -> Erratum:
    """Section V.C: theta* is cut, not rounded."""
    exact = np.concatenate([setting.A[::-1], setting.theta_star()[setting.ORDER :]])
    excess = [
        max(float(np.max(np.abs(values - exact))) / 0.01 - 0.5, 0.0)
        for values in (np.array(setting.PRINTED_THETA), np.round(exact, 2))
    ]
    return Erratum(
        "theta-digits",
        "Section V.C, theta*",
        r"1.66,\ -2.66",
        r"1.67,\ -2.67",
        "by how much the difference from the exact value exceeds half a unit of the last digit, in units",
        excess[0],
        excess[1],
        "5/3 and -8/3 are cut after two decimals.",
    )


def _normalisation() -> Erratum:
    """(3.10): the example's b does not satisfy it, so the printed rules give other slopes."""
    exact = Snapshot(0, setting.theta_star(), setting.ORDER, setting.LEVELS)
    true = np.array([setting.SEGMENTS.K1, setting.SEGMENTS.K2])
    errors = []
    for found in (recover(exact, normalisation="unit-norm"), recover(exact, normalisation="first")):
        errors.append(float(np.max(np.abs(np.array([found.K1, found.K2]) - true))))
    return Erratum(
        "normalisation",
        "(3.10), (4.5) with the example",
        r"\textstyle\sum b_i^2 = 1,\ \rho(b) > 0:\quad b = (-1, 2)/\sqrt5,\ K = -\sqrt5\,(1, 2)",
        r"b_1 = 1:\quad b = (1, -2),\ K = (1, 2)",
        "largest error of (K1, K2) when the exact theta* is decomposed",
        errors[0],
        errors[1],
        "The example's b has the norm 2.236 and its largest element is negative. Under the paper's own "
        "normalisation its procedure returns the stated slopes times -2.236; mu does not change.",
    )


def _sign_of_dead_zone() -> Erratum:
    """Introduction: D2 is a width there, a signed end everywhere else."""
    dead_zone = Segments(1.0, 2.0, 1.0, -2.0)
    mu = np.outer(interpolation_coefficients(setting.LEVELS, dead_zone), setting.B).ravel()
    theta = np.concatenate([setting.A, mu])
    found = recover(Snapshot(0, theta, setting.ORDER, setting.LEVELS), "dead-zone")
    return Erratum(
        "dead-zone-sign",
        "Introduction against (3.18a)",
        r"(-\infty, -D_2],\ (-D_2, D_1),\ [D_1, \infty)",
        r"(-\infty, D_2],\ (D_2, D_1),\ [D_1, \infty),\quad D_2 \le 0",
        "difference between the left end of the dead zone (-2) and what the intervals make of (3.18a)",
        abs(-found.D2 - dead_zone.D2),
        abs(found.D2 - dead_zone.D2),
        "(3.18a) and the example have a signed D2 = -2; in the introduction D2 is positive.",
    )


def _dead_zone_bound() -> Erratum:
    """A4: with a signed D2 the bound must be on its modulus."""
    errors = []
    for v2 in (-1.7, -3.0):  # D_M = 1.5 satisfies the printed A4; D_M = 2.5 the corrected one
        levels = (-6.0, v2, 3.0, 6.0)
        mu = np.outer(interpolation_coefficients(levels, setting.SEGMENTS), setting.B).ravel()
        found = recover(Snapshot(0, np.concatenate([setting.A, mu]), setting.ORDER, levels))
        errors.append(abs(found.K2 - setting.SEGMENTS.K2))
    return Erratum(
        "dead-zone-bound",
        "A4 with (3.1)",
        r"D_M > \max(D_1, D_2)",
        r"D_M > \max(D_1, -D_2)",
        "error of K2 from the exact theta* with levels that the bound allows (V2 = -1.7; V2 = -3)",
        errors[0],
        errors[1],
        "For the example max(D1, D2) = 1, which lets V2 fall into the dead zone (-2, 1).",
    )


def _four_parameters() -> Erratum:
    """Sections I and II.B: six parameters are called four; four points determine four."""
    found = determined_directions()
    return Erratum(
        "four-parameters",
        "Section I (i), Section II.B, Section VI",
        r"\text{four points determine } D_1, D_2, K_1, K_2, L_1, L_2",
        r"\text{four points determine } K_1, K_2, H_1, H_2",
        "number of parameters minus the directions that F(V1) .. F(V4) determine",
        float(len(UNKNOWNS) - found),
        float(4 - found),
        "The example has D1 != -D2 and both dead zone and preload, so none of (3.18a-c) holds for it: its D "
        "and L cannot be identified, and figure 3b cannot show them converge by this scheme.",
    )


def _composite_matrix() -> Erratum:
    """(4.3): index of the last row."""
    corrected = setting.composite()
    printed = corrected.copy()
    printed[-1, -1] = corrected[0, -1]
    ratios = [np.linalg.svd(matrix, compute_uv=False) for matrix in (printed, corrected)]
    return Erratum(
        "composite-matrix",
        "(4.3)",
        r"\hat M = \begin{pmatrix} \hat\mu_{11} & \cdots & \hat\mu_{1N} \\ \vdots & & \vdots \\ "
        r"\hat\mu_{n1} & \cdots & \hat\mu_{1N} \end{pmatrix}",
        r"\hat M = \begin{pmatrix} \hat\mu_{11} & \cdots & \hat\mu_{14} \\ \vdots & & \vdots \\ "
        r"\hat\mu_{n1} & \cdots & \hat\mu_{n4} \end{pmatrix}",
        "second over first singular value of M at the true parameters",
        float(ratios[0][1] / ratios[0][0]),
        float(ratios[1][1] / ratios[1][0]),
        "With the index as printed M would not be of rank one; N is 4.",
    )


def _zero_vector() -> Erratum:
    """(4.1a): the projection divides by the norm of a vector that may be zero."""
    zero = np.zeros(setting.theta_star().size)
    radius = 10.0
    with np.errstate(invalid="ignore"):
        printed = min(radius, float(np.linalg.norm(zero))) * zero / np.linalg.norm(zero)
    estimator = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=radius)
    estimator.update(0.0, 0.0)
    wrong = float(np.max(np.abs(printed)))
    return Erratum(
        "zero-vector",
        "(4.1a)",
        r"\hat\theta = \min(\rho^*, \|\theta'\|)\,\frac{\theta'}{\|\theta'\|}",
        r"\hat\theta = \begin{cases}\theta' & \|\theta'\| \le \rho^* \\ "
        r"\rho^*\,\theta'/\|\theta'\| & \text{otherwise}\end{cases}",
        "distance from the nearest point of the ball, for the zero vector",
        math.inf if math.isnan(wrong) else wrong,
        float(np.linalg.norm(estimator.theta)),
        "The start is arbitrary; from zero, with the plant at rest, the printed formula is 0/0 at once.",
    )


def _sphere() -> Erratum:
    """After (4.1): the projection is on a ball, not on a sphere."""
    u, y = setting.experiment(2200)
    true = setting.theta_star()
    radius = 10.0
    estimator = ProjectionGradient(setting.ORDER, setting.LEVELS, radius=radius)
    kept, _ = estimator.run(u, y, every=u.size)
    rows = regressors(u[:2800], y[:2800], setting.ORDER, setting.LEVELS)
    theta = np.full(true.size, 1.0)
    for row, output in zip(rows, y, strict=False):
        theta = theta + row * (output - row @ theta) / (1.0 + row @ row)
        theta = radius * theta / np.linalg.norm(theta)
    size = float(np.linalg.norm(true))
    return Erratum(
        "sphere",
        "after (4.1b)",
        r"\text{projection on the sphere } \|\theta\| = \rho^*",
        r"\text{projection on the ball } \|\theta\| \le \rho^*",
        "relative parameter error of the noise-free example (sphere: after 200 periods; ball: 2200)",
        float(np.linalg.norm(theta - true)) / size,
        float(np.linalg.norm(kept[-1] - true)) / size,
        "An estimate held on a sphere cannot be nearer to theta* than | ||theta*|| - rho* |.",
    )


def _missing_assumption() -> Erratum:
    """Proposition 5.1: excitation needs F(V_1) != 0."""
    a = plant_with_pole(COUNTER_POLE)
    segments = counter_example()
    lost = []
    for levels in (setting.LEVELS, (-7.0, *setting.LEVELS[1:])):
        found = excitation_of(period_rows(a, segments, levels, even=False))
        lost.append(float(found.n_parameters - found.rank))
    return Erratum(
        "missing-assumption",
        "Proposition 5.1",
        r"\{v\} \text{ of (5.1) excites } \Phi \text{ persistently}",
        r"\dots \text{ if } F(V_1) \ne 0",
        "directions that a period does not excite, for a plant with F(V1) = 0 and after moving V1 to -7",
        lost[0],
        lost[1],
        "The gap of 2n after V1 frees the plant a second time only if V1 moves it. With F(V1) = 0, which a "
        "preload against the slope allows, a pole can hide from the other three impulses.",
    )


def confirmed() -> dict[str, float]:
    """Return how far printed formulas that are right are from an independent evaluation."""
    levels = np.array(setting.LEVELS)
    polynomial = interpolation_polynomial([0.0, *levels], levels, setting.gains())
    found = {"(3.2)-(3.5)": float(np.max(np.abs(polynomial - [0.0, *setting.SEGMENTS(levels)])))}
    cases = {
        "(3.18a)": ("dead-zone", Segments(0.7, 1.9, 1.2, -0.4)),
        "(3.18b)": ("preload", Segments(0.7, 1.9, 0.0, 0.0, 0.6, -1.3)),
        "(3.18c)": ("symmetric", Segments(0.7, 1.9, 1.2, -1.2, 0.6, -0.6)),
    }
    for name, (structure, segments) in cases.items():
        mu = np.outer(interpolation_coefficients(levels, segments), setting.B).ravel()
        theta = np.concatenate([setting.A, mu])
        recovered = recover(Snapshot(0, theta, setting.ORDER, setting.LEVELS), structure)  # type: ignore[arg-type]
        found[name] = max(abs(getattr(recovered.segments, key) - getattr(segments, key)) for key in UNKNOWNS)
        if name == "(3.18a)":
            offsets = np.array([recovered.H1, recovered.H2]) - segments.offsets
            slopes = np.array([recovered.K1 - segments.K1, recovered.K2 - segments.K2])
            found["(3.16), (3.17)"] = float(np.max(np.abs([*offsets, *slopes])))
    return found


def excited_share(plants: int = 200, seed: int = 5) -> float:
    """Return the share of random plants, of orders 1 to 4 and F(V_1) != 0, that (5.1) excites."""
    rng = np.random.default_rng(seed)
    excited = 0
    for number in range(plants):
        order = 1 + number % 4
        roots = rng.uniform(0.2, 0.9, order // 2) * np.exp(1j * rng.uniform(0.3, 2.8, order // 2))
        poles = np.concatenate([roots, roots.conj(), rng.uniform(-0.9, 0.9, order % 2)])
        b = rng.standard_normal(order)
        d = rng.uniform(0.2, 2.0, len(setting.LEVELS)) * rng.choice([-1.0, 1.0], len(setting.LEVELS))
        u = impulse_levels(setting.LEVELS, order)
        rows, _ = stationary_period(np.poly(poles).real[1:], np.outer(b, d), u, setting.LEVELS)
        excited += excitation_of(rows).persistent
    return excited / plants
