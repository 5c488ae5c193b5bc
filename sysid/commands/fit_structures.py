"""The structures that `sysid fit` knows; a new one is an entry here and the module it names."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from sysid.errors import UsageError

Fitter = Callable[..., Any]
"""Called as ``fit(record, options, initial_state=..., progress=...)``, returns a model that
`sysid.diagnosis.comparison.judge` takes and that has a method ``saved()`` for `--save`."""


@dataclass(frozen=True)
class Option:
    """An option of the command line that belongs to one or more structures.

    Attributes
    ----------
    flag : str
        As ``--knots``.
    field : str
        Key under which the fitter finds it; only what was given is passed on.
    read : callable
        Turns the text into a value, or raises `UsageError` or ValueError.
    metavar, help : str
    """

    flag: str
    field: str
    read: Callable[[str], Any]
    metavar: str
    help: str


@dataclass(frozen=True)
class Structure:
    """A structure that can be fitted.

    Attributes
    ----------
    name, summary : str
    options : tuple of Option
    fitter : str
        ``module:function``, loaded when it is used.
    """

    name: str
    summary: str
    options: tuple[Option, ...]
    fitter: str

    def load(self) -> Fitter:
        """Return the function that fits it."""
        module, _, function = self.fitter.partition(":")
        return getattr(import_module(module), function)  # type: ignore[no-any-return]

    def read_options(self, given: Mapping[str, str]) -> dict[str, Any]:
        """Return the values of the options that were given, by flag.

        Raises
        ------
        UsageError
            If one does not belong to this structure, is given twice over, or makes no sense.
        """
        known = {option.flag: option for option in self.options}
        values: dict[str, Any] = {}
        from_flag: dict[str, str] = {}
        for flag, text in given.items():
            if flag not in known:
                raise UsageError(
                    f"{flag} does not belong to the structure {self.name}: it has {', '.join(known)}"
                )
            option = known[flag]
            if option.field in values:
                raise UsageError(f"{from_flag[option.field]} and {flag} say the same: give one of them")
            try:
                values[option.field] = option.read(text)
            except UsageError as problem:
                raise UsageError(f"{flag} {text!r}: {problem}") from None
            from_flag[option.field] = flag
        return values


def lag_list(text: str) -> tuple[tuple[str, int], ...]:
    """Return lags as SIGNAL:DELAY,...; a delay alone is one of the input, ``none`` stands for no lag.

    Examples
    --------
    >>> lag_list("u:1,2,y:1")
    (('u', 1), ('u', 2), ('y', 1))
    """
    if text.strip() == "none":
        return ()
    found = []
    for part in text.split(","):
        signal, sign, delay = part.strip().rpartition(":")
        if not delay.isdigit() or (sign and not signal):
            raise UsageError(f"{part.strip()!r} is no lag: write SIGNAL:DELAY,..., as u:1,u:2,y:1")
        found.append((signal or "u", int(delay)))
    return tuple(found)


def whole(fewest: int) -> Callable[[str], int]:
    """Return a reader of whole numbers from ``fewest`` on."""

    def read(text: str) -> int:
        if not text.isdigit() or int(text) < fewest:
            raise UsageError(f"give a whole number of at least {fewest}")
        return int(text)

    return read


def one_of(*choices: str) -> Callable[[str], str]:
    """Return a reader of one of some words."""

    def read(text: str) -> str:
        if text not in choices:
            raise UsageError(f"choose {', '.join(choices[:-1])} or {choices[-1]}")
        return text

    return read


STARTS = Option(
    "--starts", "starts", whole(1), "N", "searches, all but the first from random starts (default: 3)"
)
SEED = Option("--seed", "seed", whole(0), "S", "seed of the random starts (default: 0)")
KNOTS = Option("--knots", "knots", whole(2), "N", "knots of the map over the range of z (default: chosen)")
DEGREE = Option("--degree", "degree", whole(1), "M", "degree of the spline (default: 3)")
EXTRAPOLATION = Option(
    "--extrapolation",
    "extrapolation",
    one_of("linear", "constant"),
    "linear|constant",
    "how the map goes on beyond its data (default: linear)",
)

LFT = Structure(
    "lft",
    "A(q) y = B(q) u + G(q) f(z) + e with a spline f of lagged inputs and outputs z: Wiener, Hammerstein, "
    "Wiener-Hammerstein systems and maps that are fed the output",
    (
        Option(
            "--z",
            "z_lags",
            lag_list,
            "LAGS",
            "lags in the map's input z, as u:1,u:2 or y:2 (default: chosen)",
        ),
        Option("--input-lags", "z_lags", lag_list, "LAGS", "the same for lags of the input alone, as 1,2"),
        Option("--a-order", "n_a", whole(0), "N", "order of A (default: chosen)"),
        Option("--g-order", "n_g", whole(0), "N", "order of G (default: chosen)"),
        Option("--b-lags", "b_lags", lag_list, "LAGS", "lags in B, as 1,2, or none (default: chosen)"),
        KNOTS,
        DEGREE,
        EXTRAPOLATION,
        Option(
            "--overlap",
            "overlap",
            one_of("keep", "drop", "reject"),
            "keep|drop|reject",
            "lags that act in A or B and through the map, too (default: keep what the data tell apart)",
        ),
        Option(
            "--jacobian",
            "jacobian",
            one_of("exact", "kaufman"),
            "exact|kaufman",
            "of the separated problem (default: exact)",
        ),
        Option(
            "--criterion",
            "criterion",
            one_of("one-step", "free-run"),
            "one-step|free-run",
            "error that the fit minimises (default: chosen by the validation error)",
        ),
        STARTS,
        SEED,
    ),
    "sysid.diagnosis.models.lft:fit_lft_structure",
)


def order_pair(text: str) -> tuple[int, int]:
    """Return the orders of two blocks; one number stands for both.

    Examples
    --------
    >>> order_pair("3,4"), order_pair("2")
    ((3, 4), (2, 2))
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) > 2 or not all(part.isdigit() for part in parts):
        raise UsageError("give the orders of the front and the back block, as 3,3")
    return int(parts[0]), int(parts[-1])


WIENER_HAMMERSTEIN = Structure(
    "wiener-hammerstein",
    "y = G2(q) f(G1(q) u) with a spline f and poles on both sides, by simulation error",
    (
        Option(
            "--orders", "orders", order_pair, "N1,N2", "of the front and the back block (default: chosen)"
        ),
        KNOTS,
        DEGREE,
        EXTRAPOLATION,
        Option(
            "--oversampling",
            "oversampling",
            whole(1),
            "R",
            "the map acts at R points in a sampling period, found by interpolation (default: chosen, 1 or 2)",
        ),
        Option("--delay", "delay", whole(0), "N", "samples by which the input is late (default: 0)"),
    ),
    "sysid.diagnosis.models.wiener_hammerstein:fit_wiener_hammerstein_structure",
)


def positive(text: str) -> float:
    """Return a positive number."""
    value = float(text) if text.replace(".", "", 1).replace("e-", "", 1).isdigit() else 0.0
    if not value > 0.0:
        raise UsageError("give a positive number")
    return value


PIECEWISE_AFFINE = Structure(
    "piecewise-affine",
    "A(q) y = B(q) u + G(q) f(z) + e with an f that is affine in each of several regions and may jump "
    "between them, by one-step prediction error",
    (
        *(option for option in LFT.options if option.flag in ("--z", "--a-order", "--g-order", "--b-lags")),
        Option(
            "--modes", "modes", whole(2), "N", "regions of a piecewise affine map (default: chosen, 2 to 4)"
        ),
        Option(
            "--map-stage",
            "stage",
            one_of("k-plane", "global", "bounded-error"),
            "k-plane|global|bounded-error",
            "how a piecewise affine map is first fitted (default: k-plane)",
        ),
        Option("--delta", "delta", positive, "D", "bound on the error of the stage bounded-error"),
        SEED,
    ),
    "sysid.diagnosis.models.piecewise:fit_piecewise_structure",
)

STRUCTURES: tuple[Structure, ...] = (LFT, WIENER_HAMMERSTEIN, PIECEWISE_AFFINE)


def find_structure(name: str) -> Structure:
    """Return the structure of that name.

    Raises
    ------
    UsageError
        If there is none.
    """
    for structure in STRUCTURES:
        if structure.name == name:
            return structure
    known = ", ".join(structure.name for structure in STRUCTURES)
    raise UsageError(f"structure {name!r} is not known: choose one of {known}")
