"""What the fit of a port needs of a model: its ports, and its linear plant around them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from sysid.data import Record
from sysid.diagnosis.ports.kernels import KNOWN
from sysid.linear.forms import Floats

PORTS = ("input", "output", "position", "velocity")


@dataclass(frozen=True)
class Matrices:
    """x(k+1) = A x + B v + E s, y = C x + D v + G s; the map may be fed with H x + K v.

    Attributes
    ----------
    values : tuple
        A, B, C, D, E, G, H, K, shapes (n, n), (n, m), (n,), (m,), (n,), (), (n,), (m,).
    slopes : tuple
        Their derivatives by the plant's parameters, stacked on a first axis.
    """

    values: tuple[Floats, Floats, Floats, Floats, Floats, float, Floats, Floats]
    slopes: tuple[Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats]


@dataclass(frozen=True)
class Port:
    """Where a map stands.

    Attributes
    ----------
    kind : str
        One of ``PORTS``.
    channel : int
        The input that the map changes, for ``"input"``.
    mode : int
        What the kernels feed it with.
    sign : float
        +1 where the map adds to a signal, -1 for a force against the motion.
    state : int
        The sensed state, where the model has one.
    seen : bool
        Whether the map depends on the output itself, not on its rate of change.
    quantity, unit : str
        What the map depends on.
    value, value_unit : str
        What it gives.
    """

    kind: str
    channel: int
    mode: int
    sign: float
    state: int
    seen: bool
    quantity: str
    unit: str
    value: str
    value_unit: str

    def known(self) -> "Port":
        """Return the port fed from outside instead of by the loop."""
        return replace(self, mode=KNOWN)


class Plant(Protocol):
    """What the fit of a port needs of a model.

    ``black_box`` says that the parameters have no meaning of their own: a straight line at a port is
    the plant's in any case, and the search may go along any combinations of them.  ``origins`` are the
    parameters from which a search may begin, ``start`` the first of them.
    """

    black_box: bool
    order: int
    lag: int
    free_start: bool
    start: Floats
    origins: tuple[Floats, ...]
    period: float

    def ports(self, record: Record, kinds: Sequence[str]) -> tuple[Port, ...]:
        """Return the ports of these kinds that the model has."""

    def channels(self, u: Floats) -> Floats:
        """Return the signals that drive the plant, shape (n_rows, n_channels)."""

    def map_input(self, u: Floats, channel: int) -> Floats:
        """Return the input that a map in front of the plant sees."""

    def matrices(self, parameters: Floats, port: Port) -> Matrices | None:
        """Return the matrices; None if there are none for these parameters."""
