"""The order of a linear model without effects."""

from collections.abc import Callable

import numpy as np

from sysid.data import Record
from sysid.diagnosis.structures.structure import StructureFit
from sysid.errors import DataError

HIGHEST_ORDER = 6
# A higher order must lower the validation error by at least this share.
WORTHWHILE = 0.02


def chosen_order(record: Record, fitted: Callable[[int], StructureFit]) -> int:
    """Return the lowest order whose validation error is not worth a higher one.

    Poles and zeros that nearly cancel have no place of their own: an order whose restarts disagree is
    taken only where those of no order agree.

    Parameters
    ----------
    record : Record
    fitted : callable
        The model of an order, fitted to the rows of the estimation.
    """
    best, chosen = np.inf, 1
    any_best, any_chosen = np.inf, 0
    for order in range(1, HIGHEST_ORDER + 1):
        try:
            fit = fitted(order)
        except DataError:
            if order == 1:
                raise
            break  # a lower order follows the record without running away
        error = record.y[:, 0] - fit.output
        cost = float(np.mean(error[record.validation] ** 2))
        if cost < any_best * (1.0 - WORTHWHILE) ** 2:
            any_best, any_chosen = cost, order
        if fit.restarts_agree and cost < best * (1.0 - WORTHWHILE) ** 2:
            best, chosen = cost, order
    return chosen if np.isfinite(best) else max(any_chosen, 1)
