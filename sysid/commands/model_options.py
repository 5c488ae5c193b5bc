"""The options that say which model is fitted, and what is known of its parameters."""

import argparse
from collections.abc import Sequence
from math import isfinite

from sysid.errors import UsageError


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say which model is fitted, and what is known of it."""
    group = parser.add_argument_group("model")
    group.add_argument(
        "--model",
        metavar="linear|NAME|FILE.toml|MODULE:CLASS",
        default="linear",
        help="linear (default), state-space, hammerstein-<map> (as hammerstein-saturation), local-linear (or "
        "local-linear-3 for three of them), hammerstein, wiener, wiener-hammerstein (free maps), lft, "
        "piecewise-affine, a physical model that `sysid models` lists, "
        "one of your own, or one that `sysid diagnose --save` wrote (.json, .toml)",
    )
    group.add_argument(
        "--order", metavar="N", type=int, help="order of the linear model (default: chosen from the data)"
    )
    group.add_argument(
        "--param",
        metavar="NAME=VALUE[+-STD]",
        action="append",
        help="value of a parameter known within some 20 %%, from which its search starts; with STD, a "
        "standard deviation, a Gaussian prior that weighs in the fit",
    )
    group.add_argument("--fix", metavar="NAME=VALUE", action="append", help="known value of a parameter")


def assigned_values(option: str, texts: Sequence[str] | None) -> dict[str, float]:
    """Return the numbers that NAME=VALUE texts give.

    Examples
    --------
    >>> assigned_values("--fix", ["R=1.2", "L=1e-3"])
    {'R': 1.2, 'L': 0.001}
    """
    values: dict[str, float] = {}
    for text in texts or ():
        name, sign, number = (part.strip() for part in text.partition("="))
        if not (name and sign):
            raise UsageError(f"{option} {text!r} has no value: write {option} NAME=VALUE")
        if name in values:
            raise UsageError(f"{option} gives {name!r} twice: give it once")
        try:
            values[name] = float(number)
        except ValueError:
            raise UsageError(f"{option} {text!r}: {number!r} is no number") from None
        if not isfinite(values[name]):
            raise UsageError(f"{option} {text!r}: {number!r} is not finite: give a number")
    return values


def start_values(texts: Sequence[str] | None) -> dict[str, float | tuple[float, float]]:
    """Return the start values that NAME=VALUE texts give; with a standard deviation behind +- or ±, pairs.

    Examples
    --------
    >>> start_values(["R=1.2+-0.1", "L=1e-3"])
    {'R': (1.2, 0.1), 'L': 0.001}
    """
    parts = [text.replace("±", "+-").partition("+-") for text in texts or ()]
    values = assigned_values("--param", [head for head, _, _ in parts])
    spreads = assigned_values(
        "--param", [f"{head.partition('=')[0]}={spread}" for head, sign, spread in parts if sign]
    )
    return {n: (value, spreads[n]) if n in spreads else value for n, value in values.items()}
