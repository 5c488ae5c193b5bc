"""Whether what is asked of a Wiener-Hammerstein fit makes sense."""

import numpy as np

from sysid.data import Record
from sysid.errors import IdentifiabilityError, UsageError
from sysid.lft.linear_block import LinearBlock
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.linear.output_error import INITIAL_STATES, whole_number
from sysid.linear.reduction import Segment
from sysid.nonlinearities.spline import Extrapolation, Spline

LARGEST_ORDER = 10
LARGEST_INTERVALS = 200
ROWS_PER_PARAMETER = 4


def checked_form(
    record: Record, delay: int, degree: int, extrapolation: Extrapolation, initial_state: str
) -> WienerHammerstein:
    """Return a model without blocks that holds what is not searched; an error if it makes no sense."""
    if record.u.shape[1] != 1:
        raise UsageError(
            f"the record has {record.u.shape[1]} inputs ({', '.join(record.inputs)}): choose one "
            "for this model"
        )
    if initial_state not in INITIAL_STATES:
        raise UsageError(f"initial state is {initial_state!r}: choose estimate or rest")
    delay = whole_number("delay", delay)
    if not 0 <= delay < record.n_samples:
        raise UsageError(f"delay is {delay} samples: give 0 or more, and less than the record's length")
    gain = LinearBlock(np.zeros(0), np.ones(1))
    degree = whole_number("degree", degree)
    spline = Spline(np.array([-1.0, 1.0]), np.zeros(1 + max(degree, 0)), degree, extrapolation)
    return WienerHammerstein(gain, spline, gain, delay=delay, resting=initial_state == "rest")


def checked_orders(orders: tuple[int, int]) -> tuple[int, int]:
    """Return the orders of both blocks; UsageError if they make no sense."""
    try:
        front, back = (whole_number("order", order) for order in orders)
    except TypeError:
        raise UsageError(f"orders is {orders!r}: give two, of the front and the back block") from None
    except ValueError:
        raise UsageError(
            f"orders is {orders!r}: give two whole numbers, of the front and the back block"
        ) from None
    if min(front, back) < 0 or max(front, back) > LARGEST_ORDER or front + back == 0:
        raise UsageError(
            f"orders are {front} and {back}: give numbers from 0 to {LARGEST_ORDER}, at least one "
            "of them above 0"
        )
    return front, back


def checked_intervals(knots: int) -> int:
    """Return the number of intervals between so many knots; UsageError if it makes no sense."""
    intervals = whole_number("knots", knots) - 1
    if not 1 <= intervals <= LARGEST_INTERVALS:
        raise UsageError(f"knots is {knots}: give a number from 2 to {LARGEST_INTERVALS + 1}")
    return intervals


def check_enough(segments: tuple[Segment, ...], orders: tuple[int, int], n_basis: int) -> None:
    """Raise IdentifiabilityError if there are too few rows for the parameters."""
    n_rows = sum(int(s.used.sum()) for s in segments)
    unknowns = 2 * sum(orders) + n_basis
    if n_rows < ROWS_PER_PARAMETER * unknowns:
        raise IdentifiabilityError(
            f"{n_rows} rows cannot determine {unknowns} parameters (orders {orders[0]} and {orders[1]}, a "
            f"map of {n_basis} coefficients): at least {ROWS_PER_PARAMETER * unknowns} rows are needed; "
            "lower orders or knots"
        )
