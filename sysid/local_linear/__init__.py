r"""Composite local linear state-space models (Borges, Verdult and Ayala Botto 2005).

A few linear models take turns, by weights that depend on scheduling signals.  B and O enter linearly and are
eliminated by orthogonal factorisation; A, C, centres and widths are searched with Kaufman's or the exact
Jacobian of what is left:

* `fit_local_linear` fits a record by its free run, `LocalLinearFit.predict` and `LocalLinearFit.nrmse` score
  it, `plot_weights` shows where which model is in charge; `choose_local_linear` gives the model of the
  estimation rows too, and the validation error of every structure;
* `Problem` is the search problem for signals as they are, with the Jacobian of choice;
* `blocked_cost` and `blocked_kaufman` need the memory of one block of rows only.

On a measured record, the cascaded tanks (``sysid data fetch cascaded_tanks``), order and number of local
models are chosen on the validation rows: two of order two, with a free-run error of 0.38 V on the test set,
where the linear model of this order has 0.60 V::

    record = sysid.read_record("cascaded_tanks.csv", split="split", experiment="experiment")
    fit = sysid.fit_local_linear(record)
    print(fit, fit.nrmse(record, record.scored_rows("test")))
    plot_weights(fit.model, fit.schedule(record))

More local models than the data visit fit them better and may diverge elsewhere.  So the searches see the
estimation rows alone; which of them is taken is decided by the free run over the validation rows, and a refit
on both keeps to models that grow no faster than the one that was chosen.

Examples
--------
>>> import numpy as np
>>> from sysid.data import make_record
>>> rng = np.random.default_rng(1)
>>> u = np.cumsum(rng.uniform(-0.3, 0.3, 800)) * 0.5
>>> y = np.zeros(800)
>>> for k in range(799):
...     y[k + 1] = 0.8 * y[k] + np.arctan(3 * u[k])
>>> record = make_record(u, y, period=0.1)
>>> choice = choose_local_linear(record, order=1, models=3)
>>> bool(choice.accepted.nrmse(record, record.validation)[0] < 0.1)
True
"""

from sysid.local_linear.blocked import blocked_cost, blocked_kaufman
from sysid.local_linear.figures import plot_weights
from sysid.local_linear.fit import (
    LocalLinearChoice,
    LocalLinearFit,
    choose_local_linear,
    fit_local_linear,
)
from sysid.local_linear.model import LocalLinearModel
from sysid.local_linear.problem import Problem
from sysid.local_linear.projected import identity_descent
from sysid.local_linear.structure import Experiment, Sizes

__all__ = [
    "Experiment",
    "LocalLinearChoice",
    "LocalLinearFit",
    "LocalLinearModel",
    "Problem",
    "Sizes",
    "blocked_cost",
    "blocked_kaufman",
    "choose_local_linear",
    "fit_local_linear",
    "identity_descent",
    "plot_weights",
]
