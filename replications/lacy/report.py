"""Tables and sentences of the chapter on the paper of Lacy, Erwin and Bernstein; the notebook calls these."""

from collections.abc import Mapping
from typing import Any

from replications.errata import show_errata
from replications.lacy import setting
from replications.lacy.examples import METHODS
from replications.lacy.figures import block_diagram, consistency, nonlinearity, response, spread
from sysid.reporting import display
from sysid.reporting.display import Display, Markdown

__all__ = [
    "bias", "block_diagram", "branch_recovery", "consistency", "derivatives", "efficiency", "errata",
    "example", "identifiability", "literal_reading", "methods", "noise_free", "nonlinearity", "outside",
    "peaks", "response", "scale", "search", "special_cases", "spread", "step_tests", "studies", "window",
]  # fmt: skip

Results = Mapping[str, Any]
_NAMES = {
    "paper": "paper's method",
    "ml": "maximum likelihood",
    "naive": "z taken for y",
    "bound": "at the Cramér-Rao bound",
}


def _numbers(results: Results) -> Mapping[str, float]:
    numbers: Mapping[str, float] = results["papers"]["lacy"]["numbers"]
    return numbers


def _runs(results: Results, case: str = "sine/paper") -> int:
    return int(results["papers"]["lacy"]["monte_carlo"][case]["n_runs"])


def literal_reading(results: Results) -> Display:
    """Say what happens when (29) is read as printed."""
    numbers = _numbers(results)
    return display.prose(
        "Read literally, with $q^{-1}$ where $q$ is meant, the denominator has its roots outside the "
        "unit circle "
        f"(modulus {display.number(1 / numbers['setting/pole-modulus'], digits=4)}): an impulse "
        f"response that "
        f"has grown {display.number(numbers['literal-reading/growth'], digits=2)} times between "
        f"samples 30 and "
        "60 is no spring with a dashpot. With descending powers of $q$ the poles have the modulus "
        f"{display.number(numbers['setting/pole-modulus'], digits=4)}, the zero lies at "
        f"{display.number(numbers['setting/zero'], digits=3)} and "
        f"$G(1) = {numbers['setting/dc-gain']:.4f}$."
    )


def example(results: Results, case: str) -> Display:
    """Show the two figures of an example and what can be said about its record."""
    shown = results["papers"]["lacy"]["tables"]["figures"][case]
    return display.group(
        nonlinearity(results, case),
        response(results, case),
        display.prose(f"Solver: {shown['status']}. Identifiability: {shown['identifiability']}."),
    )


def methods(results: Results) -> Display:
    """Show the medians of every method in every example."""
    numbers = _numbers(results)
    heads = ["", "dB rms", "dB max", "degrees rms", "degrees max", "relative $H_2$", "unstable"]
    keys = ("rms_db", "max_db", "rms_deg", "max_deg", "relative_h2")
    rows: list[list[object]] = []
    for case, one in setting.EXAMPLES.items():
        rows.append([Markdown(f"**{one.title}**, {one.samples} samples")])
        for method in ("naive", "paper", "ml", "bound"):
            cells: list[object] = [numbers[f"{case}/{method}/{key}_median"] for key in keys]
            share = f"{100 * numbers[f'{case}/{method}/unstable_share']:.1f} %"
            rows.append([_NAMES[method], *cells, share])
    formats = {
        "dB rms": ".2f",
        "dB max": ".2f",
        "degrees rms": ".1f",
        "degrees max": ".1f",
        "relative $H_2$": ".3f",
    }
    return display.table(
        rows,
        heads,
        formats=formats,
        align="lrrrrrr",
        caption=f"Medians over {_runs(results)} records of the error of the frequency response on 0.01 … "
        "2 rad. The last line of each example is an estimate drawn at the Cramér-Rao bound. Behind sign "
        "the gains are matched.",
    )


def peaks(results: Results) -> Display:
    """Show height and frequency of the resonance."""
    numbers = _numbers(results)
    rows = [
        [
            one.title,
            *(
                f"{numbers[f'{case}/{method}/peak_db_median']:.2f} at "
                f"{numbers[f'{case}/{method}/peak_frequency_median']:.3f}"
                for method in METHODS
            ),
        ]
        for case, one in setting.EXAMPLES.items()
    ]
    return display.table(
        rows,
        ["example", *(_NAMES[method] for method in METHODS)],
        align="lrrrr",
        caption="Resonance: medians of the height [dB] and the frequency [rad a sample].",
    )


def window(results: Results) -> Display:
    """Say why errors are scored up to 2 rad."""
    numbers = _numbers(results)
    rows = [
        [one.title, numbers[f"{case}/ml/rms_db_median"], numbers[f"{case}/ml/beyond_db_median"]]
        for case, one in setting.EXAMPLES.items()
    ]
    return display.table(
        rows,
        ["example", "0.01 … 2 rad", "2 … 3.13 rad"],
        formats={"0.01 … 2 rad": ".2f", "2 … 3.13 rad": ".2f"},
        caption="Median error of maximum likelihood in dB. The zero of G at −0.966 leaves less than −40 "
        "dB of response near 3.14 rad: there the same error of the parameters is many decibels and moves "
        "no output.",
    )


def noise_free(results: Results) -> Display:
    """Show what the paper's method finds without noise."""
    numbers = _numbers(results)
    rows = [
        [
            one.title,
            f"{100 * numbers[f'noise-free/{case}/exact_fit_share']:.0f} %",
            numbers[f"noise-free/{case}/median_error"],
            numbers[f"noise-free/{case}/rms_db_median"],
            numbers[f"noise-free/{case}/ml_rms_db_median"],
        ]
        for case, one in setting.EXAMPLES.items()
    ]
    heads = ["example", "exact fits", "error of θ", "error [dB]", "error of ML [dB]"]
    return display.table(
        rows,
        heads,
        align="lrrrr",
        formats={heads[2]: ".1e", heads[3]: ".2g", heads[4]: ".2g"},
        caption="Without noise: share of records fitted without error, and medians of the errors. Behind "
        "sine and dead zone an exact fit is the true system; a quantiser or a sign leaves a set of "
        "systems that all fit exactly, and the estimate is one of it.",
    )


def search(results: Results) -> Display:
    """Say what branch and bound does and how fast."""
    numbers = _numbers(results)
    seconds = results["papers"]["lacy"]["timings"]["branch_and_bound/sine_seconds"]
    share = numbers["branch_and_bound/agrees_with_brute_force"]
    return display.prose(
        f"On {24} small cases, for which every sequence was evaluated by an independent routine, it found "
        f"the minimum in {100 * share:.0f} %. A record of 20 samples behind a sine over $[-2\\pi, 2\\pi]$ "
        f"has about $10^{{12}}$ sequences; the search needed {display.number(seconds, digits=2)} s "
        "(median of seven noisy records), and what it returns is the global minimum, not the best of "
        "some starts. When it is stopped by a limit of nodes it says so."
    )


def branch_recovery(results: Results) -> Display:
    """Say why recovery of the branches with noise is no gate."""
    numbers = _numbers(results)
    return display.prose(
        f"With S/N = 10 the sequence with the smallest $J_y$ has on average "
        f"{100 * numbers['sine/recovered_share']:.0f} "
        f"% of its samples on the right branch, and all of them in "
        f"{100 * numbers['sine/all_recovered_share']:.0f} % "
        "of the records. That is no fault of the search: among $10^{12}$ sequences some fit noise "
        "better than the "
        "true one does, most often where $z$ is near $\\pm1$ and two branches lie closer than the "
        "noise. Such "
        "swaps hardly change the system. So recovery is reported, and the error of the system is "
        "what is gated."
    )


def scale(results: Results) -> Display:
    """Say what the scale of y does to the criterion."""
    numbers = _numbers(results)
    transient = display.number(numbers["scale/relative_at_transient"], digits=2)
    truth = display.number(numbers["scale/relative_at_truth"], digits=2)
    return display.prose(
        "Shrinking $y$ to a thousandth, which no sign notices, changes $J_y^2$ by the factor "
        f"{display.number(numbers['scale/j_y_shrunk_over_j_y'], digits=2)} and $J_y^2/\\|Qy\\|^2$ by "
        f"{numbers['scale/relative_shrunk_over_relative']:.6f}. The relative criterion has a trap of its "
        "own: over an unbounded box a free transient so large that the input no longer counts brings it "
        f"to {transient}, below the {truth} of the true $y$ of a noisy record. Therefore starts are of "
        "nearly equal size, and a minimiser in which the response to the input has less than 1 % of the "
        "energy of $y$ is passed over. With $\\sum b = 1$ the trap does not exist; it is offered as "
        '`normalisation="sum-b"`.'
    )


def identifiability(results: Results) -> Display:
    """Show what the records of the figures determine."""
    shown = results["papers"]["lacy"]["tables"]["figures"]
    rows = [[one.title, shown[case]["identifiability"]] for case, one in setting.EXAMPLES.items()]
    return display.table(
        rows,
        ["example", "what the record determines"],
        caption="Identifiability of the records shown. Unknowns are the five parameters and the initial "
        "state.",
    )


def special_cases(results: Results) -> Display:
    """Show the special cases of Section 5."""
    numbers = _numbers(results)
    rows = [
        ["arctan y", numbers["special/arctan/regions"], numbers["special/arctan/free"], "one evaluation"],
        ["sat y", numbers["special/saturation/regions"], "saturated samples", "one box"],
        [
            "y²",
            "2 to the number of samples",
            numbers["special/square/free"],
            "branch and bound: y and −y tie",
        ],
    ]
    return display.table(
        rows,
        ["nonlinearity", "R", "q", "what is solved"],
        caption="The special cases of Section 5.",
        align="lrrl",
    )


def derivatives(results: Results) -> Display:
    """Say how well the fast forms agree with finite differences."""
    numbers = _numbers(results)
    return display.prose(
        "Against finite differences of eighth order the fast gradient is off by "
        f"{numbers['fast-form/gradient']:.0e} and the fast Hessian by {numbers['fast-form/hessian']:.0e}, "
        "relative."
    )


def step_tests(results: Results) -> Display:
    """Say what Section 6 gives."""
    numbers = _numbers(results)
    known = numbers["dead-zone/paper/rms_db_median"]
    return display.prose(
        "The dead zone was measured by 65 step tests a quarter apart, joined by straight lines, with "
        "flat segments kept flat. Without noise in the identification record the linear system, divided "
        "by its DC gain, comes out with a largest error of "
        f"{display.number(numbers['step-tests/noise-free/largest_error'], digits=2)}; with S/N = 10 and "
        f"60 samples the median error is {numbers['step-tests/rms_db_median']:.2f} dB, "
        f"{numbers['step-tests/rms_deg_median']:.1f} degrees (Example 2, 30 samples and the dead zone "
        f"known: {known:.2f} dB). Eq. (28) holds to {numbers['step-tests/normalisation-error']:.0e}, when "
        "its sum is read as one over $a_i - b_i$."
    )


def efficiency(results: Results) -> Display:
    """Show efficiency and exponents behind the dead zone."""
    paper = results["papers"]["lacy"]
    numbers, sizes = _numbers(results), paper["tables"]["sizes"]
    rows = [
        [
            Markdown(display.symbol(name)),
            *(f"{100 * numbers[f'efficiency/ml/{name}/{n}']:.0f} %" for n in sizes),
            *(f"{100 * numbers[f'efficiency/paper/{name}/{n}']:.0f} %" for n in (sizes[0], sizes[-1])),
            numbers[f"slope/ml/{name}"],
            numbers[f"slope/bound/{name}"],
        ]
        for name in setting.PARAMETERS
    ]
    heads = ["", *(f"ML, N = {n}" for n in sizes), *(f"paper, N = {n}" for n in (sizes[0], sizes[-1])),
             "exponent of ML", "of the bound"]  # fmt: skip
    return display.table(
        rows,
        heads,
        formats={"exponent of ML": ".2f", "of the bound": ".2f"},
        align="l" + "r" * (len(heads) - 1),
        caption="Dead zone: efficiency (square of the ratio of bound and RMSE) and exponents of the "
        "error in N. The "
        "bound falls faster than $N^{-1/2}$, as the system starts from rest and takes some forty "
        "samples to ring up.",
    )


def bias(results: Results) -> Display:
    """Say how large the bias of the equation error is."""
    numbers = _numbers(results)
    parts = []
    for method in ("paper", "ml"):
        found = display.with_error(numbers[f"bias/{method}/a2"], numbers[f"bias_std_error/{method}/a2"])
        parts.append(f"{found} by {'the paper' if method == 'paper' else 'maximum likelihood'}")
    return display.prose(
        f"At 240 samples the bias of $a_2$ is {parts[0]}'s method and {parts[1]}. With no nonlinearity at "
        "all, least squares on $y + w$ has the bias "
        f"{display.number(numbers['asymptotic-bias/a2'], digits=2)}; samples inside the dead zone are "
        "placed by the fit and carry less noise."
    )


def outside(results: Results) -> Display:
    """Say how many data leave the range of the sine."""
    numbers = _numbers(results)
    return display.prose(
        "With the noise where (30) has it, before the nonlinearity, no datum ever lies outside the "
        "range. The paper's rule to move such data to the nearest point of the range is for noise behind "
        "it: at S/N = 10 it then moves "
        f"{display.number(numbers['outside-range/noise-behind/mean'], digits=2)} of the 20 data of a sine "
        "record on average, and the fit reports them."
    )


def errata(results: Results) -> Display:
    """Show every printing error with its numbers."""
    return show_errata(results, "lacy")


def studies(results: Results) -> Display:
    """Show the full Monte-Carlo tables."""
    monte_carlo = results["papers"]["lacy"]["monte_carlo"]
    return display.group(
        *(
            display.monte_carlo(
                results,
                "lacy",
                f"{case}/{method}",
                caption=f"{one.title}, {_NAMES[method]}: {monte_carlo[f'{case}/{method}']['n_runs']} runs "
                f"of {one.samples} samples.",
            )
            for case, one in setting.EXAMPLES.items()
            for method in ("paper", "ml", "naive")
        )
    )
