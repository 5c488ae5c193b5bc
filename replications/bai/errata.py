"""Printing errors of the paper: each printed form shown wrong by a number, its correction shown right.

An error is the largest difference, over a grid of parameters, between the formula and an
independent evaluation (quadrature, simulation, finite differences).  Printed forms that leave out a
symbol are read in the most favourable way that keeps what is printed.
"""

from collections.abc import Callable
from itertools import product

import numpy as np

from replications.bai import setting
from replications.bai.example_1 import Example1, one_parameter_map
from replications.bai.worked import static_map
from replications.errata import Erratum
from sysid import moment_ratios
from sysid.distributions import Distribution, PiecewiseUniform, Uniform
from sysid.hammerstein import correlation_equations
from sysid.separable import LaggedRegression


def errata() -> list[Erratum]:
    """Return every erratum with its numbers."""
    return [
        _transfer_function(),
        _saturation_quotient(),
        _relay_missing(),
        _gradient_factor(),
        _last_correlation_equation(),
        _ratio_index(),
        _relay_equations(),
        _preload_equations(),
        _nonzero_mean_input(),
    ]


def _transfer_function() -> Erratum:
    """(1.1): powers of z in numerator and denominator."""
    z = np.exp(1j * np.linspace(0.01, np.pi, 200))
    (alpha1, alpha2), (beta1, beta2) = setting.ALPHA, setting.BETA
    reference = np.array([np.sum(setting_response() * point ** -np.arange(1, 401)) for point in z])
    printed = (beta1 / z + beta2) / (z**2 - alpha1 / z - alpha2)
    corrected = (beta1 * z + beta2) / (z**2 - alpha1 * z - alpha2)
    return Erratum(
        "transfer-function",
        "(1.1)",
        r"\frac{\beta_1 z^{-(n-1)} + \dots + \beta_n}{z^n - \alpha_1 z^{-(n-1)} - \dots - \alpha_n}",
        r"\frac{\beta_1 z^{n-1} + \dots + \beta_n}{z^n - \alpha_1 z^{n-1} - \dots - \alpha_n}",
        "largest difference from the frequency response of (2.1)",
        float(np.max(np.abs(printed - reference))),
        float(np.max(np.abs(corrected - reference))),
        "The exponents have lost their sign: only the corrected form has the difference equation (2.1).",
    )


def setting_response() -> np.ndarray:
    """Return the impulse response of the examples' linear system until it has died out (400 samples)."""
    return setting.impulse_response(400)


def _grid() -> np.ndarray:
    """Return inputs between -4 and 4 that do not hit a threshold of 1."""
    return np.linspace(-4.0, 4.0, 401) + 1e-3


def _saturation_quotient() -> Erratum:
    """(1.4): the saturation is printed as a quotient."""
    u, a = _grid(), setting.THRESHOLD
    reference = np.clip(u, -a, a)
    inside, outside = 1 + np.sign(a - np.abs(u)), 1 + np.sign(np.abs(u) - a)
    with np.errstate(divide="ignore"):
        printed = inside / outside * u + a * np.sign(u)
    corrected = inside / 2 * u + outside / 2 * a * np.sign(u)
    return Erratum(
        "saturation",
        "(1.4), first line",
        r"\frac{1+\operatorname{sgn}(a-|u|)}{1+\operatorname{sgn}(|u|-a)}\,u + a\operatorname{sgn}(u)",
        r"\frac{1+\operatorname{sgn}(a-|u|)}{2}\,u "
        r"+ \frac{1+\operatorname{sgn}(|u|-a)}{2}\,a\operatorname{sgn}(u)",
        "largest difference from clipping the input at a = 1, inputs in [-4, 4]",
        float(np.max(np.abs(printed - reference))),
        float(np.max(np.abs(corrected - reference))),
        "Two fractions have run together: as printed the map divides by zero wherever |u| < a.",
    )


def _relay_missing() -> Erratum:
    """(1.4): six maps are announced, five printed; the one called relay has memory."""
    u = np.random.default_rng(1).uniform(-4, 4, 20_000)
    printed = one_parameter_map("hysteresis-relay")(u, setting.THRESHOLD)
    relay = one_parameter_map("relay")(u, setting.THRESHOLD)
    inside = np.abs(u) <= setting.THRESHOLD
    by_definition = np.where(inside, 0.0, np.sign(u))
    return Erratum(
        "relay",
        "(1.4), x_re",
        r"x_{re} \in \{-1, 1\},\ \text{by the direction of } u \text{ where } |u| \le a",
        r"x_{re} = 0\ (|u| \le a),\quad \operatorname{sgn} u\ (|u| > a)",
        "share of samples on which the map called x_re and a relay with dead band differ",
        float(np.mean(printed != relay)),
        float(np.mean(by_definition != relay)),
        "The relay of figure 2 is missing from (1.4); what is printed under its name is the hysteresis "
        "relay, whose own line is missing. They differ wherever |u| <= a.",
    )


def _gradient_factor() -> Erratum:
    """(2.7): the factor 1/N of (2.4) is lost."""
    rng = np.random.default_rng(2)
    u, y = Example1("saturation").experiment(rng)
    regression = LaggedRegression.arx(y, setting.ORDER)
    a_matrix = regression.regressors(np.clip(u, -1, 1))
    target = regression.y
    theta = np.array([-0.7, -0.2, 1.1, 0.9])

    def half_cost(point: np.ndarray) -> float:
        return float(np.mean((target - a_matrix @ point) ** 2)) / 2

    # The cost is quadratic, so a central difference has no truncation error and a large step is best.
    reference = np.array([half_cost(theta + step) - half_cost(theta - step) for step in np.eye(4)]) / 2
    printed = -a_matrix.T @ target + a_matrix.T @ a_matrix @ theta
    return Erratum(
        "gradient",
        "(2.7)",
        r"\tfrac12\,\partial J/\partial\theta = -A^TY + A^TA\theta",
        r"\tfrac12\,\partial J/\partial\theta = \tfrac1N(-A^TY + A^TA\theta)",
        "largest difference from a central difference of J/2",
        float(np.max(np.abs(printed - reference))),
        float(np.max(np.abs(printed / target.size - reference))),
        "The minimiser (2.8) is not affected.",
    )


def _last_correlation_equation() -> Erratum:
    """(3.2), last line: the equation for lag m has run into the one for 2n."""
    w = setting_response()
    n, m = setting.ORDER, 8
    alpha = np.array(setting.ALPHA)
    printed = w[2 * n - 1] - (alpha[0] * w[2 * n - 2] + alpha[1] * w[2 * n - 3] * w[m - 1])
    unknowns = np.concatenate([alpha, setting.BETA])
    corrected = w[:m] - correlation_equations(w[:m], n) @ unknowns
    return Erratum(
        "correlation-equation",
        "(3.2), last line",
        r"\dots + \alpha_n \mathrm E y(k-n)u(k-2n)\ \mathrm E y(k)u(k-m)",
        r"\mathrm E y(k)u(k-i) = \sum_j \alpha_j \mathrm E y(k-j)u(k-i),\quad i = n+1, \dots, m",
        "residual of the equation with the exact correlations of the example (q = 1, m = 8)",
        float(abs(printed)),
        float(np.max(np.abs(corrected))),
        "Two equations were set as one; the matrix (3.3) is right.",
    )


def _ratio_index() -> Erratum:
    """(3.4) against (3.18): the index of c is shifted by one."""
    cases = []
    for a1, a2 in _sides():
        q1, q2, q3 = _relay_moments(a1, a2)
        # (3.18) defines c_2 = q1/q2 and c_3 = q1/q3; the solution after (3.8) needs c_1 = q1/q2, c_2 = q1/q3.
        shifted = moment_ratios.two_sided_relay(q1 / q1, q1 / q2, *_WIDTHS)
        right = moment_ratios.two_sided_relay(q1 / q2, q1 / q3, *_WIDTHS)
        cases.append([_distance(found.parameters, (a1, a2)) for found in (shifted, right)])
    printed, corrected = np.max(cases, axis=0)
    return Erratum(
        "ratio-index",
        "(3.18) against (3.4)",
        r"c_i = q(f_1, a)/q(f_i, a),\ i = 2, \dots, l+1",
        r"c_i = q(f_1, a)/q(f_{i+1}, a),\ i = 1, \dots, l",
        "error of (a1, a2) of the two-sided relay when the algorithm's c_i enter the worked solution",
        float(printed),
        float(corrected),
        "The algorithm counts its ratios from 2, equations (3.4), (3.5) and all examples from 1.",
    )


_WIDTHS = (2.0, 6.0, 2.0, 4.0)
"""b1, b2 of the uniform inputs and d1, d2 of the third input (3.7)."""


def _sides() -> list[tuple[float, float]]:
    return list(product((0.3, 0.8, 1.4), (0.5, 1.1, 1.9)))


def _distance(found: np.ndarray, true: tuple[float, ...]) -> float:
    return float(np.max(np.abs(np.asarray(found) - true)))


def _moment(name: str, distribution: Distribution, *parameters: float) -> float:
    """E[xu] by quadrature: independent of every closed form."""
    return float(static_map(name).moment_by_quadrature(distribution, *parameters))


def _relay_moments(a1: float, a2: float) -> list[float]:
    b1, b2, d1, d2 = _WIDTHS
    inputs = (Uniform.symmetric(b1), Uniform.symmetric(b2), PiecewiseUniform.zero_mean(d1, d2))
    return [_moment("two-sided-relay", f, a1, a2) for f in inputs]


def _relay_equations() -> Erratum:
    """After (3.8): the 2x2 system."""
    b1, b2, d1, d2 = _WIDTHS
    d = d1 * d2**2 + d2 * d1**2
    cases = []
    for a1, a2 in _sides():
        q1, q2, q3 = _relay_moments(a1, a2)
        c1, c2 = q1 / q2, q1 / q3
        # Favourable reading of the print: the lost column restored, the right-hand side as it stands.
        matrix = np.array(
            [[b2 - c1 * b1, b2 - c1 * b1], [1 - 2 * b1 * c2 * d2**2 / d, 1 - 2 * b1 * c2 * d1**2 / d]]
        )
        right = np.array([2 * b1**2 * b2 - 2 * c1 * b1 * b2**2, 2 * b1**2 - 4 * b1 * c2 * d2**2 / d])
        printed = np.linalg.solve(matrix, right)
        corrected = moment_ratios.two_sided_relay(c1, c2, *_WIDTHS).parameters
        cases.append([_distance(printed, (a1, a2)), _distance(corrected, (a1, a2))])
    printed_error, corrected_error = np.max(cases, axis=0)
    return Erratum(
        "relay-equations",
        "system after (3.8)",
        r"\begin{pmatrix} b_2 - c_1 b_1 \\ 1 - 2b_1c_2d_2^2/D \end{pmatrix}"
        r"\begin{pmatrix} a_1 \\ a_2 \end{pmatrix} = "
        r"\begin{pmatrix} \cdot \\ 2b_1^2 - 4b_1c_2d_2^2/D \end{pmatrix}",
        r"\begin{pmatrix} b_2 - c_1b_1 & b_2 - c_1b_1 \\ "
        r"1 - 2b_1c_2d_2^2/D & 1 - 2b_1c_2d_1^2/D \end{pmatrix}"
        r"\begin{pmatrix} a_1^2 \\ a_2^2 \end{pmatrix} = "
        r"\begin{pmatrix} \cdot \\ 2b_1^2 - 4b_1c_2d_1^2d_2^2/D \end{pmatrix}",
        "error of (a1, a2) with exact ratios (print: lost column restored, the rest as it stands)",
        float(printed_error),
        float(corrected_error),
        "The unknowns are squares, the second column is lost, and the right side lacks the factor d1^2; "
        "D = d1 d2^2 + d2 d1^2.",
    )


def _preload_equations() -> Erratum:
    """(3.12): b2 for b3."""
    b1, b2, b3 = 2.0, 6.0, 3.0
    inputs = (Uniform.symmetric(b1), Uniform.symmetric(b2), PiecewiseUniform.mass_and_uniform(b3))
    cases = []
    for a1, a2 in _sides():
        q1, q2, q3 = (_moment("two-sided-preload", f, a1, a2) for f in inputs)
        c1, c2 = q1 / q2, q1 / q3
        matrix = np.array([[1.0, 1.0], [b3 * c2 / 2 - b1 / 4, b3 * c2 / 4 - b1 / 4]])
        right = np.array([moment_ratios.preload_sum(c1, b1, b2), b1**2 / 3 - 2 * b2**2 * c2 / 3])
        printed = np.linalg.solve(matrix, right)
        corrected = moment_ratios.two_sided_preload(c1, c2, b1, b2, b3).parameters
        cases.append([_distance(printed, (a1, a2)), _distance(corrected, (a1, a2))])
    printed_error, corrected_error = np.max(cases, axis=0)
    return Erratum(
        "preload-equations",
        "(3.12), second row",
        r"\tfrac{b_1^2}{3} - \tfrac{2 b_2^2 c_2}{3}",
        r"\tfrac{b_1^2}{3} - \tfrac{2 b_3^2 c_2}{3}",
        "error of (a1, a2) with exact ratios",
        float(printed_error),
        float(corrected_error),
        "The second ratio belongs to the third input.",
    )


def _nonzero_mean_input() -> Erratum:
    """(3.10) has a nonzero mean, for which (3.2) does not hold."""
    b1, b2, b3 = 2.0, 6.0, 3.0
    third = PiecewiseUniform.mass_and_uniform(b3)
    response = setting_response()
    gain = float(np.sum(response))
    preload = static_map("two-sided-preload")
    cases = []
    for a1, a2 in _sides():

        def loaded(u: float, a1: float = a1, a2: float = a2) -> float:
            return u + a2 if u > 0 else u - a1 if u < 0 else 0.0

        x_mean = third.expectation(loaded, [0.0])
        q3 = _moment("two-sided-preload", third, a1, a2)
        # Exact correlations under the third input: other samples contribute the product of the means.
        w = q3 * response[:4] + x_mean * third.mean * (gain - response[:4])
        solution = np.linalg.solve(correlation_equations(w, 2), w)
        printed = _distance(solution, (*setting.ALPHA, *(q3 * np.array(setting.BETA))))
        # The repair: two symmetric inputs and the offset of the output.
        q1, q2 = (_moment("two-sided-preload", Uniform.symmetric(b), a1, a2) for b in (b1, b2))
        offset = gain * preload.mean(Uniform.symmetric(b1), a1, a2)
        alpha, beta = np.array(setting.ALPHA), q1 * np.array(setting.BETA)
        repaired = moment_ratios.preload_from_offset(q1 / q2, b1, b2, alpha, beta, offset)
        cases.append([printed, _distance(repaired.parameters, (a1, a2))])
    printed_error, corrected_error = np.max(cases, axis=0)
    return Erratum(
        "nonzero-mean-input",
        "(3.10) with (3.2)",
        r"\mathrm E\,x(k-i)u(k-j) = q\,\delta(i-j)\ \text{for } f_3 \text{ of mean } -b_3/4",
        r"a_2 - a_1 = 2\bar y\,(1 - \textstyle\sum\alpha)/\sum\beta\ \text{under a symmetric input}",
        "print: error of (alpha, q beta) from exact correlations; repair: error of (a1, a2)",
        float(printed_error),
        float(corrected_error),
        "With a nonzero mean every correlation gains E[x]E[u]. Subtracting the means does not help: the "
        "covariance of x and u under (3.10) depends on a1 + a2 only, as under a symmetric input.",
    )


def centred_covariance_spread() -> float:
    """Return how much cov(x, u) under (3.10) changes while a1 + a2 is kept: not at all."""
    third = PiecewiseUniform.mass_and_uniform(3.0)
    preload = static_map("two-sided-preload")
    totals = (1.0, 2.0, 3.0)
    covariances = [
        [preload.covariance(third, share * total, (1 - share) * total) for share in (0.1, 0.4, 0.9)]
        for total in totals
    ]
    return float(np.max(np.ptp(covariances, axis=1)))


def confirmed_moments() -> dict[str, float]:
    """Largest difference between the printed moments that are right and quadrature."""
    b1, d1, d2, b3 = 2.0, 2.0, 4.0, 3.0
    d = d1 * d2**2 + d2 * d1**2
    uniform, zero_mean = Uniform.symmetric(b1), PiecewiseUniform.zero_mean(d1, d2)
    third = PiecewiseUniform.mass_and_uniform(b3)
    sided: dict[str, tuple[str, Distribution, Callable[[float, float], float]]] = {
        "(3.8) i=1,2": ("two-sided-relay", uniform, lambda a1, a2: (2 * b1**2 - a1**2 - a2**2) / (4 * b1)),
        "(3.8) f3": (
            "two-sided-relay",
            zero_mean,
            lambda a1, a2: d1**2 * d2**2 / d - (d2**2 * a1**2 + d1**2 * a2**2) / d / 2,
        ),
        "(3.11) i=1,2": ("two-sided-preload", uniform, lambda a1, a2: b1**2 / 3 + b1 * (a1 + a2) / 4),
        "(3.11) f3": ("two-sided-preload", third, lambda a1, a2: 2 * b3**2 / 3 + a1 * b3 / 2 + a2 * b3 / 4),
    }
    found = {
        name: max(abs(formula(*sides) - _moment(map_name, f, *sides)) for sides in _sides())
        for name, (map_name, f, formula) in sided.items()
    }
    single: dict[str, tuple[str, Callable[[float], float]]] = {
        "(3.13)": ("saturation", lambda a: a / b1 * (b1**2 / 2 - a**2 / 6)),
        "(3.15)": ("dead-zone", lambda a: a**3 / (6 * b1) - a * b1 / 2 + b1**2 / 3),
    }
    for name, (map_name, formula) in single.items():
        found[name] = max(abs(formula(a) - _moment(map_name, uniform, a)) for a in (0.2, 0.9, 1.7))
    return found


def cubic_root_counts() -> tuple[int, int]:
    """Count the cases in which (3.16) has one root in each interval the paper names, and all cases."""
    right = total = 0
    for b1, factor, share in product((0.5, 2.0, 7.0), (1.05, 1.5, 4.0), (0.02, 0.3, 0.7, 0.98)):
        b2, a = b1 * factor, share * b1
        q1, q2 = (a**3 / (6 * b) - a * b / 2 + b**2 / 3 for b in (b1, b2))
        c = q1 / q2
        roots = np.roots([c * b1 - b2, 0.0, 3 * b1 * b2 * (b1 - c * b2), 2 * b1 * b2 * (c * b2**2 - b1**2)])
        total += 1
        real = np.sort(roots.real)
        right += bool(np.all(np.abs(roots.imag) < 1e-9) and real[0] < 0 < real[1] < b1 < real[2])
    return right, total
