"""Tables and sentences of the chapter, made from the results; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from replications import diagrams
from replications.borges import peer, setting
from replications.borges.flops import ROWS
from replications.errata import show_errata
from sysid.reporting import display
from sysid.reporting.display import Display

Results = Mapping[str, Any]

PRINTED_SECONDS = {"approach-1": 7.208, "approach-2a": 5.744, "approach-2b": 0.162}


def numbers_of(results: Results) -> Mapping[str, float]:
    """Return the numbers of the paper."""
    numbers: Mapping[str, float] = results["papers"]["borges"]["numbers"]
    return numbers


def timings_of(results: Results) -> Mapping[str, float]:
    """Return the measured times and ratios of times."""
    timings: Mapping[str, float] = results["papers"]["borges"]["timings"]
    return timings


def structure() -> Display:
    """Draw the model: weights mix the local models, whose state goes around."""
    drawing = diagrams.block_diagram(
        blocks=[
            (2.2, r"$p_i(\phi_k)$", 10),
            (5.2, r"$\sum_i p_i (A_i x + B_i u + O_i)$", 9),
            (8.2, r"$C$", 11),
        ],
        sums=[],
        arrows=[((0.4, 0.8), (1.45, 0.8)), ((2.95, 0.8), (3.45, 0.8)), ((6.95, 0.8), (7.75, 0.8)),
                ((8.65, 0.8), (9.7, 0.8)), ((5.2, 1.8), (5.2, 1.15))],
        signals=[(0.75, 1.0, r"\phi_k"), (5.45, 1.6, "u_k"), (7.35, 1.0, "x_k"), (9.3, 1.0, "y_k")],
    )  # fmt: skip
    return display.figure(
        drawing,
        "The structure as it is implemented.",
        "The scheduling vector decides how much each local model counts; one state belongs to all of them.",
    )


def jacobians(results: Results) -> Display:
    """Show errors of all derivatives against finite differences."""
    numbers = numbers_of(results)
    labels = {
        "approach-1": "approach 1, (29)",
        "exact": "exact, without any dΦ",
        "kaufman": "Kaufman: 2b projected",
        "2a": "approach 2a, (40)",
        "2b": "approach 2b, (41)",
    }
    rows = [
        [label, numbers[f"jacobian_error/{name}"], numbers[f"gradient_error/{name}"]]
        for name, label in labels.items()
    ]
    rows.append(["adjoint: one backward pass", None, numbers["gradient_error/adjoint"]])
    condition = display.number(numbers["jacobian/condition_of_phi"], digits=3)
    return display.table(
        rows,
        ["derivative", "error as Jacobian", "error of the gradient"],
        formats={"error as Jacobian": ".1e", "error of the gradient": ".1e"},
        caption="Relative errors (Frobenius norm) against central differences of the projected residual, "
        f"where the condition of Φ is {condition}.",
        align="lrr",
    )


def searches(results: Results) -> Display:
    """Show what a wrong Jacobian does to Levenberg-Marquardt."""
    numbers = numbers_of(results)
    labels = {
        "exact": "exact Jacobian",
        "kaufman": "Kaufman",
        "approach-2b": "approach 2b as printed",
        "joint": "joint optimisation of (η, θ)",
        "identity/kaufman/free": "Kaufman, damping λI",
        "identity/kaufman/projected": "Kaufman, λI, projected (15)",
        "identity/approach-2b/free": "2b, damping λI",
        "identity/approach-2b/projected": "2b, λI, projected (15)",
    }
    rows = [
        [
            label,
            *(
                numbers.get(f"{kind}/{name}{suffix}")
                for suffix in ("", "/20-dB")
                for kind in ("lm_iterations", "cost_over_best")
            ),
        ]
        for name, label in labels.items()
    ]
    columns = ["search", "evaluations", "cost", "evaluations, 20 dB", "cost, 20 dB"]
    return display.group(
        display.table(
            rows,
            columns,
            formats={"cost": ".2f", "cost, 20 dB": ".2f"},
            caption="Evaluations of the cost until it is within 1.5 times the best of all methods (61: "
            "never, in 60), and the cost at the end over that best; medians over the runs, two scheduling "
            "inputs.",
            align="lrrrr",
        ),
        display.prose(
            "Projection with Kaufman's or the exact Jacobian changes no step: their rows are orthogonal to "
            "every change of coordinates, as the projected residual does not depend on the coordinates; and "
            "so is the damped step. At equal λ the steps differ by "
            f"{display.number(numbers['projection/step_difference/kaufman'], digits=2)} (relative), those of "
            "2b, which is no Jacobian, by "
            f"{display.number(numbers['projection/step_difference/2b'], digits=2)}."
        ),
    )


def redundancy(results: Results) -> Display:
    """Show dimensions of the null space."""
    numbers = numbers_of(results)
    rows = [
        [
            f"q = {q}",
            *(
                int(numbers[f"redundancy/q{q}/{name}"])
                for name in ("null-space", "change-of-state", "weights")
            ),
        ]
        for q in (1, 2)
    ]
    return display.table(
        rows,
        ["scheduling", "null space of the Jacobian", "change of the state", "left for (w, c)"],
        caption="Directions in η that change no output. The weights do not change when one quadratic "
        "function is added to all exponents: 2q + 1 parameters for s conditions, so max(0, 2q + 1 − s) "
        "directions remain that (13) does not know.",
        align="lrrr",
    )


def scores(results: Results) -> Display:
    """Show VAF and RMSE on fresh data."""
    numbers = numbers_of(results)
    labels = {
        "linear/": "one linear model (PI-MOESP)",
        "start/": "start: B and O of four models",
        "": "separable least squares (Kaufman)",
        "exact/": "the same, exact Jacobian",
        "approach-2b/": "the same, 2b as printed",
        "joint/": "joint optimisation",
    }
    rows = []
    for q in ("q1", "q2"):
        for noise, words in (("", "20 dB"), ("/noise-free", "none")):
            for prefix, label in labels.items():
                names = [
                    f"{q}/{kind}_validation/{prefix}output-{o}{noise}"
                    for kind in ("vaf", "rmse")
                    for o in (1, 2)
                ]
                if names[0] in numbers:
                    rows.append([q[1], words, label, *(numbers[name] for name in names)])
    columns = ["q", "noise", "model", "VAF 1 [%]", "VAF 2 [%]", "RMSE 1", "RMSE 2"]
    return display.table(
        rows,
        columns,
        formats={name: ".2f" if "VAF" in name else ".4f" for name in columns[3:]},
        caption="Free run on fresh noise-free data of 1000 samples, from rest; medians over the runs.",
        align="rllrrrr",
    )


def scores_figure(results: Results) -> Display:
    """Draw VAF of the second output for one and two scheduling inputs."""
    numbers = numbers_of(results)
    drawing, axes = display.subplots(height=2.6)
    methods = {"linear/": "linear", "start/": "start", "": "separable"}
    for index, q in enumerate(("q1", "q2")):
        values = [numbers[f"{q}/vaf_validation/{prefix}output-2"] for prefix in methods]
        look = display.series(index)
        axes.bar(np.arange(3) + 0.36 * index - 0.18, values, 0.34, label=f"q = {q[1]}", color=look["color"])
    axes.set_xticks(range(3), list(methods.values()))
    axes.set(ylabel="VAF of output 2 [%]", ylim=(0, 105))
    axes.legend(fontsize=8, loc="upper left")
    return display.figure(
        drawing,
        "The second output on fresh data, 20 dB noise, by the number of scheduling inputs.",
        "The fifty parameters of the paper schedule by one input, and cannot give the product of the other "
        "with the state: whatever the search, a fourth of the variance of the second output stays.",
    )


def table_1(results: Results) -> Display:
    """Show Table 1 at the setting."""
    numbers = numbers_of(results)
    labels = (
        "Φ, (17)",
        "QR, (23)",
        "sensitivity, (32) or (43)",
        "θ, (25)",
        "approach 1",
        "approach 2a",
        "approach 2b",
    )
    rows = [
        [
            label,
            f"{numbers[f'table-1/{row}/printed']:,.0f}",
            f"{numbers[f'table-1/{row}/ours']:,.0f}",
            "yes" if f"table-1/{row}/counted_over_ours" in numbers else "",
        ]
        for row, label in zip(ROWS, labels, strict=True)
    ]
    return display.table(
        rows,
        ["", "printed", "ours", "counted in a run"],
        caption="Table 1 at N = 1000, n = 3, s = 4, m = 2, two outputs, q = 1: operations. The printed "
        "counts take m where there are m + 1 columns, and the rows of one and of all derivatives are the "
        "same formula; ours of row three is one system.",
        align="lrrl",
    )


def table_2(results: Results) -> Display:
    """Show Table 2 as ratios, with what was measured."""
    numbers, timings = numbers_of(results), timings_of(results)
    reference = PRINTED_SECONDS["approach-2b"]
    rows = []
    for name, short in (("approach-1", "1"), ("approach-2a", "2a")):
        rows.append(
            [
                f"approach {short} over 2b",
                PRINTED_SECONDS[name] / reference,
                numbers[f"table-1/{name}/over-2b/printed"],
                numbers[f"table-1/{name}/over-2b/ours"],
                timings[f"ratio_{short}_over_2b/numpy"],
                timings[f"ratio_{short}_over_2b/compiled"],
            ]
        )
    columns = ["", "printed times", "printed operations", "our operations", "NumPy", "compiled"]
    speed = display.number(timings["gigaflops_of_matrix_product"], digits=3)
    return display.group(
        display.table(
            rows,
            columns,
            formats=dict.fromkeys(columns[1:], ".1f"),
            caption="Table 2 as ratios, measured in one run. NumPy runs system by system, as (30) and (42) "
            "are written.",
            align="lrrrrr",
        ),
        display.prose(
            f"Compiled, 2b takes {display.number(timings['flop_ratio_2b'], digits=3)} times as long as its "
            f"operations would at the speed of this machine's matrix product ({speed} Gflop/s), and writes "
            f"{display.number(timings['gigabytes_a_second_2b'], digits=3)} GB/s. The exact Jacobian takes "
            f"{display.number(timings['exact_over_approach1'], digits=2)} of approach 1, Kaufman's "
            f"{display.number(timings['kaufman_over_approach1'], digits=2)}, and the gradient by the adjoint "
            f"{display.number(timings['adjoint_over_2b'], digits=2)} of 2b. {peer_sentence(results)} Times "
            "differ from run to run and are no gates."
        ),
    )


def peer_sentence(results: Results) -> str:
    """Say how JAX compares, or why it was not measured."""
    ratio = timings_of(results).get(peer.NAME)
    if ratio is None:
        return f"{peer.MISSING}."
    times = display.number(ratio, digits=3)
    return f"JAX (jit, forward mode and scan) takes {times} times as long as ours for 2b."


def long_records(results: Results) -> Display:
    """Show the elimination in blocks, and what normal equations lose."""
    numbers, timings = numbers_of(results), timings_of(results)
    return display.prose(
        f"In blocks of {timings['blocked_qr_block']:.0f} samples the triangular factor of [Φ Y] takes "
        f"{display.number(timings['blocked_qr_cpu_ratio'], digits=2)} of the processor time of QR of the "
        f"whole Φ and {display.number(timings['blocked_qr_extra_mb'], digits=2)} MB; the cost differs by "
        f"{display.number(timings['blocked_qr_cost_difference'], digits=1)} (relative). Accumulating $Q_1$ "
        f"as Algorithm 1 does would cost {numbers['algorithm-1/operations_for_q_over_r']:.0f} times the "
        "operations of the factor at N = 10⁶, and its memory is that of Φ. Where local models overlap "
        f"(condition of Φ {display.number(numbers['condition/phi'], digits=2)}) the parameters come back "
        f"with a relative error of {display.number(numbers['condition/theta_error/qr'], digits=2)} by QR and "
        f"of {display.number(numbers['condition/theta_error/normal-equations'], digits=2)} by normal "
        "equations."
    )


def inputs(results: Results) -> Display:
    """Say which inputs were chosen."""
    share = numbers_of(results)["setting/diverging_share"]
    return display.prose(
        "The paper says *uncorrelated white-noise sequences*. With normal inputs of variance one the system "
        f"diverges in {100 * share:.0f} % of 50 experiments: the cube of the first output takes over beyond "
        f"1.6. The studies use inputs uniform on [−{setting.HALF_WIDTH:g}, {setting.HALF_WIDTH:g}], the "
        "range in which Narendra and Parthasarathy use it."
    )


def errata(results: Results) -> Display:
    """Show every printing error with its numbers."""
    return show_errata(results, "borges")
