"""Tables of the chapter about disturbances and noise; and what all its tables need."""

from collections.abc import Mapping
from typing import Any

from replications.giri import setting
from replications.giri.disturbance import KINDS
from replications.giri.precision import METHODS, NOISES, SIZES
from sysid.reporting import display
from sysid.reporting.display import Display, Markdown

Results = Mapping[str, Any]


def numbers_of(results: Results) -> Mapping[str, float]:
    """Return the numbers of the paper."""
    numbers: Mapping[str, float] = results["papers"]["giri"]["numbers"]
    return numbers


def symbol(name: str) -> str:
    r"""Write a parameter as mathematics.

    Examples
    --------
    >>> symbol("mu12"), symbol("a1")
    ('$\\mu_{12}$', '$a_{1}$')
    """
    return f"$\\mu_{{{name[2:]}}}$" if name.startswith("mu") else display.symbol(name)


def disturbance_table(results: Results) -> Display:
    """Show the ratio of error to disturbance, and what theory gives."""
    numbers = numbers_of(results)
    rows = []
    for kind in KINDS:
        theory = numbers.get(f"noise_ratio/{kind}/theory")
        error = numbers[f"noise_ratio/{kind}/std_error"]
        rows.append(
            [
                kind,
                display.with_error(numbers[f"noise_ratio/{kind}"], error)
                if error > 1e-6
                else display.number(numbers[f"noise_ratio/{kind}"]),
                None if theory is None else display.number(theory),
                display.number(numbers[f"noise_slope/{kind}"], digits=5),
                display.number(numbers[f"noise_ratio/{kind}/at-1"], digits=3),
                display.number(numbers[f"proposition-4.1/increment_ratio/{kind}"], digits=3),
                display.number(numbers[f"proposition-4.1/posterior_ratio/{kind}"], digits=3),
            ]
        )
    return display.table(
        rows,
        ["disturbance", "ratio", "theory", "exponent", "ratio at 1", "increments", "posterior error"],
        caption=r"Mean $\|\hat\theta - \theta^*\|$ over mean $|\eta|$, $\eta = Az$, for amplitudes of $z$ "
        r"from $10^{-5}$ to $10^{-1}$; exponent of the error in $|\eta|$; the ratio at an amplitude of 1; "
        r"and the means of $\|\hat\theta(t) - \hat\theta(t-1)\|$ and $|e_p|$ over mean $|\eta|$ "
        "(Proposition 4.1).",
        align="lrrrrrr",
    )


def precision_tables(results: Results) -> Display:
    """Show bias, spread and efficiency of every method."""
    monte_carlo = results["papers"]["giri"]["monte_carlo"]
    shown = []
    for noise in NOISES:
        rows = []
        for method in METHODS:
            entry = monte_carlo[f"{noise}/{method}/periods={SIZES[-1]}"]["parameters"]
            for name in ("a1", "K1"):
                quality = entry[name]
                efficiency = quality["efficiency"]
                rows.append(
                    [
                        method.replace("-", " "),
                        Markdown(symbol(name)),
                        display.with_error(quality["bias"], quality["bias_std_error"]),
                        display.number(quality["std"], digits=2),
                        display.number(quality["crlb_std"], digits=2),
                        None if efficiency is None else f"{100 * efficiency:.1f} %",
                    ]
                )
        kind = "equation error" if noise == "equation" else "disturbance of the output"
        shown.append(
            display.table(
                rows,
                ["method", "", "bias", "std", "bound", "efficiency"],
                caption=f"White {kind} of standard deviation 0.1, {SIZES[-1]} periods. Bound: the "
                "Cramér-Rao bound of the seven free parameters for Gaussian noise.",
                align="lcrrrr",
            )
        )
    numbers = numbers_of(results)
    rows = [
        [
            noise,
            method.replace("-", " "),
            *(
                display.number(numbers[f"slope/{noise}/{method}/{name}"], digits=2)
                for name in setting.PARAMETERS
            ),
        ]
        for noise in NOISES
        for method in ("least-squares", "structured")
    ]
    heads = [symbol(name) for name in setting.PARAMETERS]
    error = display.number(numbers["slope_std_error"], digits=1)
    shown.append(
        display.table(
            rows,
            ["noise", "method", *heads],
            caption=f"Exponent of the RMSE in the number of periods, {SIZES[0]} to {SIZES[-1]}; standard "
            f"error {error}. A bias makes it flatter than $-1/2$.",
            align="ll" + "r" * len(heads),
        )
    )
    return display.group(*shown)


def speed(results: Results) -> Display:
    """Tell how many updates a second each algorithm made in this run."""
    timings = results["papers"]["giri"]["timings"]
    names = {
        "projection-gradient": "projected gradient",
        "kaczmarz": "Kaczmarz",
        "recursive-least-squares": "recursive least squares",
    }
    rates = [
        f"{title} {display.number(int(round(1.0 / timings[f'update/{name}'], -3)))}"
        for name, title in names.items()
    ]
    return display.prose(
        f"Updates a second, one call for each sample, on one core in this run: {', '.join(rates)}."
    )


def studies(results: Results) -> Display:
    """Show the Monte-Carlo tables of the shortest and the longest experiment in full."""
    monte_carlo = results["papers"]["giri"]["monte_carlo"]
    shown = []
    for noise in NOISES:
        for method in METHODS:
            for size in (SIZES[0], SIZES[-1]):
                case = f"{noise}/{method}/periods={size}"
                runs, failed = monte_carlo[case]["n_runs"], monte_carlo[case]["failed"]
                words = f"White {noise} noise, {method.replace('-', ' ')}, {size} periods; "
                words += f"{runs} runs, {failed} failed."
                shown.append(display.monte_carlo(results, "giri", case, caption=words))
    return display.group(*shown)
