"""Which lags feed which block of an LFT model, and which columns say the same thing twice."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from sysid.errors import ModelError
from sysid.nonlinearities.spline import EXTRAPOLATIONS, LARGEST_DEGREE, Extrapolation

Lag = tuple[str, int]
"""A signal's name and its delay in samples: ("u", 1) is u(k-1)."""

Basis = Literal["bspline", "thesis"]
Overlap = Literal["reject", "drop", "keep"]


def lags(signal: str, *delays: int) -> tuple[Lag, ...]:
    """Return lags of one signal.

    Examples
    --------
    >>> lags("u", 1, 2)
    (('u', 1), ('u', 2))
    """
    return tuple((signal, delay) for delay in delays)


@dataclass(frozen=True)
class LftStructure:
    r"""Orders and lags of an LFT model, eq. (4.10) of Pepona (2009).

    .. math:: A(q) y(k) = B(q) u(k) + G(q) w(k) + e(k), \quad w = f(z), \quad z(k) = D(q) x(k)

    with :math:`A = 1 + a_1 q^{-1} + \dots`, :math:`G = 1 + g_1 q^{-1} + \dots`, a spline f, and D that
    weighs chosen lags of inputs and outputs with :math:`\|d\| = 1`.  Special cases: Wiener
    (no A, no B, no G), Hammerstein (one lag in z), Wiener-Hammerstein (A and G).

    Attributes
    ----------
    n_a : int
        Order of A.
    b_lags : tuple of Lag
        Lags of inputs in B.
    n_g : int
        Order of G.
    z_lags : tuple of Lag
        Lags of inputs and outputs that D weighs.
    knots : int
        Knots of the map, equally spaced over the range of z.
    degree : int
        Of the spline.
    basis : {"bspline", "thesis"}
        B-splines, or :math:`|z - \kappa_j|^m, z, 1` of eq. (4.16); the same maps when ``degree`` is 3.
    extrapolation : {"linear", "constant"}
        How the map goes on outside the knots.
    overlap : {"reject", "drop", "keep"}
        What to do with a lag that stands in A or B and reaches y through G(q) D(q), too (the
        condition :math:`b_i c_i = 0`): refuse it, leave it out of A and B, or keep it as far as
        the data can tell both ways apart.

    Signals are named ``y``, ``u`` (or ``u1``, ``u2``, ...), or as the columns of a record.

    Examples
    --------
    >>> LftStructure(n_a=1, n_g=1, z_lags=lags("u", 1, 2), knots=15).names[:4]
    ('a1', 'g1', 'd1', 'd2')
    >>> LftStructure(n_a=1, b_lags=lags("u", 1), z_lags=lags("u", 1)).overlapping
    ('b1',)
    """

    n_a: int = 0
    b_lags: tuple[Lag, ...] = ()
    n_g: int = 0
    z_lags: tuple[Lag, ...] = (("u", 1),)
    knots: int = 12
    degree: int = 3
    basis: Basis = "bspline"
    extrapolation: Extrapolation = "linear"
    overlap: Overlap = "reject"

    def __post_init__(self) -> None:
        for field in ("b_lags", "z_lags"):
            object.__setattr__(self, field, _checked_lags(field, getattr(self, field)))
        for field, fewest in (("n_a", 0), ("n_g", 0), ("knots", 2), ("degree", 1)):
            value = getattr(self, field)
            if not isinstance(value, int) or value < fewest:
                raise ModelError(f"{field} is {value!r}: give a whole number of at least {fewest}")
        if not self.z_lags:
            raise ModelError("z_lags is empty: the map needs at least one lag, as ('u', 1)")
        if self.degree > LARGEST_DEGREE:
            raise ModelError(f"degree is {self.degree}: give at most {LARGEST_DEGREE}")
        for lag in self.b_lags:
            if lag[0] == "y":
                raise ModelError(f"b_lags holds {lag}: lags of the output belong to A, give them by n_a")
        choices = {
            "basis": ("bspline", "thesis"),
            "extrapolation": tuple(EXTRAPOLATIONS),
            "overlap": ("reject", "drop", "keep"),
        }
        for field, allowed in choices.items():
            if getattr(self, field) not in allowed:
                raise ModelError(f"{field} is {getattr(self, field)!r}: choose {' or '.join(allowed)}")
        if self.basis == "thesis" and self.degree % 2 == 0:
            raise ModelError(
                f"degree is {self.degree} with the basis |z - knot|^m, where an even power has no break at "
                "its knot: take an odd degree, or the basis 'bspline'"
            )

    @property
    def kind(self) -> str:
        """What such a system is called: Wiener, Hammerstein, Wiener-Hammerstein, or else LFT."""
        if self.b_lags or any(signal == "y" for signal, _ in self.z_lags):
            return "LFT"
        if len(self.z_lags) == 1:
            return "Hammerstein"
        return "Wiener-Hammerstein" if self.n_a or self.n_g else "Wiener"

    @property
    def words(self) -> str:
        """What stands where, in words."""
        sums = f"z from {', '.join(at(*lag) for lag in self.z_lags)}"
        linear = [f"A of order {self.n_a}", f"G of order {self.n_g}"]
        if self.b_lags:
            linear.append(f"B with {', '.join(at(*lag) for lag in self.b_lags)}")
        return f"{self.kind}, {', '.join(linear)}, {sums}, {self.knots} knots"

    @property
    def n_coefficients(self) -> int:
        """Coefficients of the map in the basis of the fit."""
        return self.knots + 2 if self.basis == "thesis" else self.knots - 1 + self.degree

    @property
    def largest_lag(self) -> int:
        """Samples before the first row that can be predicted."""
        return max([self.n_a, *(delay for _, delay in self.b_lags), self.z_delay + self.n_g])

    @property
    def z_delay(self) -> int:
        """Largest delay in z."""
        return max(delay for _, delay in self.z_lags)

    @property
    def linear_lags(self) -> tuple[Lag, ...]:
        """The lags whose coefficients are linear parameters: those of A, then those of B."""
        return (*lags("y", *range(1, self.n_a + 1)), *self.b_lags)

    @property
    def map_lags(self) -> frozenset[Lag]:
        """The lags of G(q) D(q), by which signals reach the output through the map."""
        return frozenset((signal, delay + i) for signal, delay in self.z_lags for i in range(self.n_g + 1))

    @property
    def overlapping(self) -> tuple[str, ...]:
        """Names of the coefficients of A and B whose lag is one of G(q) D(q), too."""
        return tuple(lag_name("ab", lag, self) for lag in self.linear_lags if lag in self.map_lags)

    def left_out(self) -> tuple[Lag, ...]:
        """Return the lags of A and B that ``overlap`` takes out of the model.

        Raises
        ------
        ModelError
            If there are some and they are to be refused.
        """
        shared = [lag for lag in self.linear_lags if lag in self.map_lags]
        if not shared or self.overlap == "drop":
            return tuple(shared)
        if self.overlap == "keep":
            # Only when every lag of the map's linear part stands in A or B is one of them redundant.
            return tuple(shared[-1:]) if len(shared) == len(self.map_lags) else ()
        names = ", ".join(self.overlapping)
        raise ModelError(
            f"{names} and the slope of the map act on the same lag (b_i c_i = 0 is violated): take the lag "
            "out of A or B or out of z, or give overlap='drop' or 'keep'"
        )

    @property
    def n_parameters(self) -> int:
        """Number of free parameters."""
        return len(self.names) - 1

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters: those of A, B, G, D, then the coefficients of the map."""
        gone = self.left_out() if self.overlap != "reject" or not self.overlapping else ()
        return (
            *(lag_name("ab", lag, self) for lag in self.linear_lags if lag not in gone),
            *(f"g{i}" for i in range(1, self.n_g + 1)),
            *(lag_name("d", lag, self) for lag in self.z_lags),
            *(f"c{i}" for i in range(1, self.n_coefficients + 1)),
        )


def at(signal: str, delay: int) -> str:
    """Return a lagged signal as it stands in an equation.

    Examples
    --------
    >>> at("u", 2), at("u", 0)
    ('u(k-2)', 'u(k)')
    """
    return f"{signal}(k-{delay})" if delay else f"{signal}(k)"


def lag_name(block: Literal["ab", "d"], lag: Lag, structure: LftStructure) -> str:
    """Return the name of a coefficient: ``b1``, or with the signal where several meet, ``b[u2,1]``."""
    signal, delay = lag
    if block == "ab" and signal == "y":
        return f"a{delay}"
    letter, beside = ("b", structure.b_lags) if block == "ab" else ("d", structure.z_lags)
    single = len({name for name, _ in beside}) == 1
    return f"{letter}{delay}" if single else f"{letter}[{signal},{delay}]"


def _checked_lags(field: str, given: Sequence[Lag]) -> tuple[Lag, ...]:
    found: list[Lag] = []
    for entry in given:
        try:
            signal, delay = entry
        except (TypeError, ValueError):
            raise ModelError(f"{field} holds {entry!r}: give pairs of signal and delay, ('u', 1)") from None
        if not isinstance(signal, str) or not isinstance(delay, int):
            raise ModelError(f"{field} holds {entry!r}: give pairs of signal and delay, ('u', 1)")
        fewest = 1 if signal == "y" else 0
        if delay < fewest:
            raise ModelError(
                f"{field} holds {signal} with the delay {delay}: give at least {fewest}, for the model "
                "predicts y from the past"
            )
        if (signal, delay) in found:
            raise ModelError(f"{field} holds {signal}(k-{delay}) twice: give each lag once")
        found.append((signal, delay))
    return tuple(found)
