"""Printing errors of Chapter 4: each printed form shown wrong by a number, its correction shown right."""

import numpy as np

from replications.errata import Erratum
from replications.pepona import setting
from replications.pepona.chapter4_study import FAR, readings, structure, true_start
from replications.pepona.chapter4_theory import (
    equivalence_numbers,
    lemma_columns,
    overlap_numbers,
    power_deficit,
    rank_deficit,
)
from replications.pepona.setting import Floats
from sysid.lft import fit_lft, initial_estimate, printed_search
from sysid.nonlinearities.spline import absolute_power_basis, equal_knots, spline_basis
from sysid.separable import golub_pereyra_jacobian, kaufman_jacobian, project

_STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
"""Central difference of eighth order."""
_STEP = 2e-2


def errata4() -> list[Erratum]:
    """Return every erratum of Chapter 4 with its numbers."""
    return [
        *_iteration(),
        _jacobian(),
        _sign_of_g(),
        _sign_of_a(),
        _example_1(),
        _overlap(),
        _lemma_rank(),
        _lemma_window(),
        _lemma_bound(),
        _powers(),
        _exponent(),
        _counts(),
        _figures(),
        _table_number(),
    ]


def _data(case: str, seed: int = 2009) -> tuple[Floats, Floats]:
    example = setting.EXAMPLES[case]
    signals = setting.experiment(example, example.samples, np.random.default_rng(seed))
    return signals.u, signals.y


def _iteration() -> list[Erratum]:
    """Table 4.1: the stopping test, and steps uphill."""
    example = setting.EXAMPLES["4.3"]
    data, form = _data("4.3"), structure(example)
    first = initial_estimate(data, form)
    ours = fit_lft(data, form, start=first, jacobian="kaufman")
    least = min(ours.cost, fit_lft(data, form, start=true_start(example)).cost)
    rows = data[0].size - form.largest_lag
    stopped = 2 * rows * float(printed_search(data, form, start=first).costs[-1])
    stopping = Erratum(
        "stopping-test",
        "Table 4.1, last line of the loop",
        r"\text{until}\ V_{SN}(\vartheta^{j+1}) / V_{SN}(\vartheta^j) \le \rho",
        r"\text{until}\ \rho < V_{SN}(\vartheta^{j+1}) / V_{SN}(\vartheta^j) \le 1,\quad "
        r"1 - \rho\ \text{small}",
        "excess of the cost at the stop over the minimum, relative (example 4.3, started as in 4.3.1)",
        stopped / least - 1.0,
        max(ours.cost / least - 1.0, 0.0),
        r"The test ends the loop at the first step that lowers the cost by $1 - \rho$ or more, that is, at "
        "the first one that works, and lets it go on for ever where nothing is left to gain. And "
        r"$\rho \ge 0.95$ either way is far from convergence: the fit here stops on a relative change of "
        "$10^{-10}$.",
    )
    data, form = _data("4.4"), structure(setting.EXAMPLES["4.4"])
    starts = [(np.ones(1), [1.0, g]) for g in np.linspace(-3.0, 3.0, 13)]
    rises = [float(np.max(printed_search(data, form, start=start).ratios)) - 1.0 for start in starts]
    costs = [np.array(fit_lft(data, form, start=start, jacobian="kaufman").costs) for start in starts]
    uphill = Erratum(
        "uphill",
        "Table 4.1, update before the test",
        r"\vartheta^{j+1} = \vartheta^j + \Delta\vartheta_j\ \text{whatever}\ V_{SN}(\vartheta^{j+1})",
        r"\vartheta^{j+1} = \vartheta^j\ \text{if}\ V_{SN}(\vartheta^j + \Delta\vartheta_j) > "
        r"V_{SN}(\vartheta^j)",
        "largest relative rise of the cost in one step that was kept (example 4.4 from 13 values of $g_1$)",
        max(rises),
        max(0.0, *(float(np.max(np.diff(cost) / cost[:-1])) for cost in costs)),
        "A step uphill raises the damping, but the step itself is kept, so that the next one starts "
        "where the last one should not have gone.",
    )
    return [stopping, uphill]


def _jacobian() -> Erratum:
    """(4.31): Kaufman's approximation is called the Jacobian."""
    signals = setting.experiment(setting.EXAMPLES["4.3"], 300, np.random.default_rng(31))
    now = spline_basis(signals.z, equal_knots(signals.z, 4))[1:]
    before = spline_basis(signals.z, equal_knots(signals.z, 4))[:-1]
    y, lagged = signals.y[1:], signals.y[:-1, np.newaxis]

    def residual(g: float) -> Floats:
        return project(np.hstack([lagged, now + g * before]), y).residual

    at = 0.1
    reference = sum(
        weight * (residual(at + k * _STEP) - residual(at - k * _STEP)) for k, weight in _STENCIL.items()
    )
    found = project(np.hstack([lagged, now + at * before]), y)
    derivative = np.hstack([np.zeros_like(lagged), before])[np.newaxis]
    scale = float(np.linalg.norm(reference / _STEP))
    printed, exact = (
        float(np.linalg.norm(build(found, derivative)[:, 0] - reference / _STEP)) / scale
        for build in (kaufman_jacobian, golub_pereyra_jacobian)
    )
    return Erratum(
        "separated-jacobian",
        "(4.31), given as the Jacobian of the separated problem after Golub and Pereyra",
        r"J_s = J_n - J_l J_l^\dagger J_n",
        r"J_s = J_n - J_l J_l^\dagger J_n "
        r"+ (J_l^\dagger)^T\,(\partial J_l/\partial\vartheta_{nl})^T\,\epsilon",
        "relative difference from finite differences of eighth order, as derivatives of the residual",
        printed,
        exact,
        "(4.31) is Kaufman's approximation. It leaves out a term in the residual; the gradient of the cost "
        "is the same, so it is a good approximation to descend by, and no more.",
    )


def _diverging(case: str, reading: str, records: int = 40) -> float:
    example = readings(case)[reading]
    far = 0
    for seed in range(records):
        signals = setting.experiment(example, 2 * example.samples, np.random.default_rng([seed, 4]))
        far += not np.max(np.abs(signals.y)) <= FAR
    return far / records


def _sign_of_g() -> Erratum:
    """(4.41): as printed the system diverges."""
    return Erratum(
        "sign-of-g1",
        "(4.41a) with Table 4.4",
        r"y_k = 0.4\,y_{k-1} + 1.2\,u_{k-1} + w_k + 0.5\,w_{k-1} + e_k",
        r"y_k = 0.4\,y_{k-1} + 1.2\,u_{k-1} + w_k - 0.5\,w_{k-1} + e_k",
        "share of records of 1000 samples that diverge",
        _diverging("4.4", "+a+g"),
        _diverging("4.4", "+a-g"),
        r"Above $z = 2$ the map has at least the slope 1, so that a large $y$ grows by "
        r"$0.4 + 1 + 0.5 > 1$. With $-0.5$ the system is that of Example 4.3 but for the loop.",
    )


def _sign_of_a() -> Erratum:
    """(4.40a): a1 of Table 4.3 is that of A(q)."""
    gaps = {}
    for name in ("-a-g", "+a-g"):
        example = readings("4.3")[name]
        scores = []
        for seed in range(40):
            signals = setting.experiment(example, example.samples, np.random.default_rng([seed, 3]))
            scores.append(setting.vaf(signals.y, signals.y - signals.e))
        off = abs(98.32 - float(np.mean(scores))) - 4.0 * float(np.std(scores))
        gaps[name] = max(off, 0.0)
    return Erratum(
        "sign-of-a1",
        "(4.40a) with Table 4.3",
        r"y_k = a_1 y_{k-1} + w_k + g_1 w_{k-1} + e_k,\quad a_1 = -0.4",
        r"y_k = -a_1 y_{k-1} + w_k + g_1 w_{k-1} + e_k,\quad a_1 = -0.4",
        "how far the printed VAF of 98.32 % lies outside four standard deviations of the best that any "
        "model can reach [%]",
        gaps["-a-g"],
        gaps["+a-g"],
        "The final $a_1$ of Table 4.3 is that of $A(q)$ in (4.11a). Its initial value is what stands before "
        "$+y_{k-1}$ in (4.33), so the row mixes two signs.",
    )


def _example_1() -> Erratum:
    """(4.15b): the shift was forgotten."""
    numbers = equivalence_numbers()
    return Erratum(
        "example-4.1",
        "(4.15b)",
        r"z_k = d_1 u_{k-1} + d_2 u_{k-2}",
        r"z_k = d_1 u_{k-2} + d_2 u_{k-3}",
        "largest difference of the output from that of (4.14)",
        numbers["example-4.1/printed"],
        numbers["example-4.1/shifted"],
        "The example shifts the input of the map by one sample; (4.15b) repeats (4.14b) without the shift.",
    )


def _overlap() -> Erratum:
    """4.2.2: b_i c_i = 0 for every i."""
    numbers = overlap_numbers()
    return Erratum(
        "overlap",
        "4.2.2, last constraint",
        r"b_i c_i = 0\ \text{for all}\ i \in [0, n_l],\ n_l = \min(n_b + 1, n_g + n_d + 1)",
        r"b_i = 0\ \text{for one}\ i \le n_g + n_d\ \text{with}\ c_i \ne 0,\ \text{and only if}\ "
        r"n_b \ge n_g + n_d",
        "parameters taken away that the data determine, for one to three lags in $B$ and two in $D$ ($c_0, "
        r"c_1 \ne 0$)",
        float(sum(min(n_b + 1, 2) - numbers[f"overlap/deficit/n_b={n_b}"] for n_b in (0, 1, 2))),
        float(sum((1.0 if n_b >= 1 else 0.0) - numbers[f"overlap/deficit/n_b={n_b}"] for n_b in (0, 1, 2))),
        r"$B + \lambda_{s+1} G D$ hides one number, $\lambda_{s+1}$, and only if every lag of $GD$ is one of "
        "$B$; otherwise a lag that $B$ lacks tells it. One condition is needed then, not one for every "
        r"common lag; and common lags end at $\min(n_b, n_g + n_d)$.",
    )


def _lemma_rank() -> Erratum:
    """Lemma 4.1: the constant stands in every block."""
    return Erratum(
        "lemma-rank",
        "Lemma 4.1, (4.25)",
        r"\textstyle\sum_j F_jF_j^T > \rho I,\quad F_k = [\dots\ \phi_k^T\ \phi_{k-1}^T\ \cdots]^T",
        r"\text{the same with the 1 in}\ \phi_k\ \text{only}",
        r"rank that is missing over 4000 samples, $n_g = 1$",
        float(rank_deficit(lemma_columns(1))),
        float(rank_deficit(lemma_columns(1, once=True))),
        r"Each $\phi_{k-i}$ ends with the constant 1, so that the rank is short by $n_g$ whatever the data: "
        r"the condition can hold for $n_g = 0$ only. It is not necessary either: with $n_g = 1$ the error "
        r"falls like $N^{-1/2}$ all the same, for $\lambda$ and $g$ are fewer than the products in $\Psi$.",
    )


def _lemma_window() -> Erratum:
    """Lemma 4.1: M > p rows are too few."""
    columns = lemma_columns(0)
    p, n = 2, columns.shape[1]
    few, enough = columns[: p + 2], columns[:400]
    return Erratum(
        "lemma-window",
        "Lemma 4.1, M",
        r"M > p = n_a + n_b + n_g + 1",
        r"M + 1 \ge n_a + n_b + (n_g + 1)(s + 2)",
        r"rank that is missing ($n_g = 0$) in a window of $p + 2$ rows, and in one of 400",
        float(n - np.linalg.matrix_rank(few)),
        float(n - np.linalg.matrix_rank(enough)),
        "A sum of $M + 1$ products of rank one has at most the rank $M + 1$; $F$ has more entries than that.",
    )


def _lemma_bound() -> Erratum:
    """Proof of Lemma 4.1: the square of delta."""
    delta, rho = 0.1, 1.0
    vector = delta * np.ones(4) / 2.0
    form = float(vector @ (rho * np.eye(4)) @ vector)
    return Erratum(
        "lemma-bound",
        "proof of Lemma 4.1",
        r"\textstyle\sum_j (y_j - \hat y_j)^2 > \delta\rho",
        r"\textstyle\sum_j (y_j - \hat y_j)^2 > \delta^2\rho",
        r"by how much the bound exceeds the form for $\sum_j F_jF_j^T = I$, $\rho = 1$ and $\delta = 0.1$",
        max(delta * rho - form, 0.0),
        max(delta**2 * rho - form, 0.0),
        r"$\delta$ is the norm of the error, and the form is quadratic in it. The conclusion stands.",
    )


def _powers() -> Erratum:
    """(4.10c) for any m."""
    return Erratum(
        "even-order",
        "(4.10c), a spline of order m",
        r"w = \sum_j \lambda_j |z - \kappa_j|^m + \lambda_{s+1} z + \lambda_0,\ \text{any}\ m",
        r"m = 3",
        r"functions that depend on the others, twelve knots, $m = 2$ and $m = 3$",
        float(power_deficit(2)),
        float(power_deficit(3)),
        "An even power has no break at its knot, so that for $m = 2$ all fourteen functions make one "
        "parabola. For $m = 1$ two of them are superfluous; quintic splines have two dimensions more than "
        "there are functions for $m = 5$.",
    )


def _exponent() -> Erratum:
    """(4.16), (4.37): n in the place of m."""
    z = np.linspace(-1.0, 1.0, 200)
    places = equal_knots(z, 11)
    reference = absolute_power_basis(z, places)
    n = 3 + 12 + 5  # n of (4.13) for Example 4.2: n_d = 3 in its own count, and nothing else
    powers = np.column_stack([np.abs(z[:, np.newaxis] - places) ** n, z, np.ones_like(z)])
    scale = float(np.linalg.norm(reference))
    return Erratum(
        "exponent",
        "(4.16), (4.37) and the examples",
        r"\phi_k = [\,|z_k - \kappa_1|^n \cdots\,],\ n\ \text{of (4.13)}",
        r"\phi_k = [\,|z_k - \kappa_1|^m \cdots\,],\ m = 3",
        "relative difference from the basis of (4.10c)",
        float(np.linalg.norm(powers - reference)) / scale,
        float(np.linalg.norm(absolute_power_basis(z, places, degree=3) - reference)) / scale,
        "$n$ is the number of parameters in (4.13), and the order of the spline in (4.10c) is $m$.",
    )


def _counts() -> Erratum:
    """4.3: how many variables each part has."""
    n_a, n_b, n_g, n_d, s = 1, 1, 1, 2, 12
    searched = (n_d + 1) + n_g  # entries of d and g with g_0 = 1
    linear = n_a + (n_b + 1) + (s + 2)
    return Erratum(
        "counts",
        "4.3, below (4.30)",
        r"n_g + n_d + 2\ \text{variables are searched, the remaining}\ n_a + n_b + s + 2\ \text{are linear}",
        r"n_g + n_d + 1\ \text{and}\ n_a + n_b + s + 3",
        "difference from the entries of (4.19), both parts",
        float(abs(n_g + n_d + 2 - searched) + abs(n_a + n_b + s + 2 - linear)),
        float(abs(n_g + n_d + 1 - searched) + abs(n_a + n_b + s + 3 - linear)),
        r"(4.19) itself has them right. With $\|d\| = 1$ only $n_g + n_d$ are free. The examples and (4.35) "
        "count $n_d$ in another way than (4.12): $n_d$ taps from $u_{k-1}$ on, not $n_d + 1$ from $u_k$ on.",
    )


def _figures() -> Erratum:
    """Name the figures of Example 4.3 by their numbers."""
    last_printed, last_named, last_meant = 4, 5, 3
    return Erratum(
        "figures",
        "Example 4.3, text",
        r"\text{figures 4.3 to 4.5}",
        r"\text{figures 4.2 and 4.3}",
        "figures named for this example that the chapter does not have or that belong to another",
        float(last_named - last_meant),
        float(max(last_meant - last_printed, 0)),
        "The first approximation is figure 4.2, the two later ones are the halves of figure 4.3; 4.4 "
        "belongs to Example 4.4 and 4.5 does not exist.",
    )


def _table_number() -> Erratum:
    """Name the table of Example 4.2 by its number."""
    return Erratum(
        "table-number",
        "Example 4.2, text",
        r"\text{given in Table 2}",
        r"\text{given in Table 4.2}",
        "difference from the number of the table",
        abs(2.0 - 4.2),
        abs(4.2 - 4.2),
        "",
    )
