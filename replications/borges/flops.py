"""Table 1: operations of every computation, as printed, as formulas of ours, and as counted in a run."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from replications.borges import setting
from sysid.local_linear import Sizes
from sysid.local_linear import gradients as g
from sysid.local_linear.passes import regressors
from sysid.local_linear.recursion import plain
from sysid.local_linear.structure import Experiment, course

Floats = NDArray[np.float64]

ROWS = ("phi", "qr", "sensitivities", "theta", "approach-1", "approach-2a", "approach-2b")


def printed(sizes: Sizes, n_samples: int) -> dict[str, float]:
    """Return the formulas of Table 1 as printed."""
    n, s, m, p = sizes.n_states, sizes.n_models, sizes.n_inputs, sizes.n_outputs
    front = 2.0 * p * n * n_samples
    core = 2 * s * n**3 + (1.5 * s + p) * n**2 + p**2 * n + (4 * n + 2 * m) * s**2
    return {
        "phi": front * ((m + n + 5) * s + p),
        "qr": front * (m**2 * n * s**2),
        "sensitivities": front * core,
        "theta": float(m**2 * n**2 * s**2),
        "approach-1": front * (core * m * n * s + 8 * m * s),
        "approach-2a": front * core * m * n * s,
        "approach-2b": front * core,
    }


def ours(sizes: Sizes, n_samples: int) -> dict[str, float]:
    """Return our formulas: one multiplication or addition is one operation.

    A system of the batch costs 2 n^2 for its state and 2 n p for its output; there are n s (m + 1) for Phi
    and n^2 s + 2 s q for the sensitivities, as entries of C need none.  QR is Householder's 2 r c^2 for r
    rows and c columns; approach 1 adds the two products with d Phi and the projection.
    """
    n, p, columns = sizes.n_states, sizes.n_outputs, sizes.n_linear
    system = n_samples * (2.0 * n * n + 2 * n * p)
    moving = sizes.n_eta - n * p
    rows = float(n_samples * p)
    phi = columns * system
    both = moving * columns * system + columns * n_samples * (2.0 * n * n + 2 * n * n)
    product = 2.0 * rows * columns * sizes.n_eta
    return {
        "phi": phi,
        "qr": 2.0 * rows * columns**2 - 2.0 * columns**3 / 3.0,
        "sensitivities": system,
        "theta": float(columns**2),
        "approach-1": both + 2.0 * product + 8.0 * rows * columns * sizes.n_eta,
        "approach-2a": both + product,
        "approach-2b": moving * system,
    }


class Counter:
    """A batch recursion in NumPy that counts what it does."""

    def __init__(self) -> None:
        self.operations = 0.0

    def __call__(
        self, A: Floats, C: Floats, drives: Floats, row: int, out: Floats, first: int, x: Floats
    ) -> int:
        """Run a batch; every product with its addition is two operations."""
        self.operations += A.shape[0] * x.shape[1] * 2.0 * (A[0].size + C.size)
        return plain(A, C, drives, row, out, first, x)


def counted(sizes: Sizes, n_samples: int = 20) -> dict[str, float]:
    """Return the operations of the recursions really done in a run, for the rows where they are all."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal((n_samples, sizes.n_inputs))
    eta = 0.3 * rng.standard_normal(sizes.n_eta)
    one = course(sizes, eta, Experiment.of(u, u[:, : sizes.n_scheduling]))
    G = rng.standard_normal((sizes.n_states, sizes.channels))
    found = {}
    tasks: dict[str, Callable[[Counter], object]] = {
        "phi": lambda counter: regressors(one, respond=counter),
        "approach-2b": lambda counter: g.approach_2b(one, G, respond=counter),
        "slopes": lambda counter: g.regressor_slopes(one, respond=counter),
    }
    for name, task in tasks.items():
        counter = Counter()
        task(counter)
        found[name] = counter.operations
    return found


def flop_numbers() -> dict[str, float]:
    """Return Table 1 at the setting of Section 4, and how far our formulas are from what was counted."""
    one = setting.sizes(1)
    ours_there, print_there = ours(one, setting.SAMPLES), printed(one, setting.SAMPLES)
    numbers = {f"table-1/{row}/ours": ours_there[row] for row in ROWS}
    numbers |= {f"table-1/{row}/printed": print_there[row] for row in ROWS}
    found, expected = counted(one), ours(one, 20)
    expected["slopes"] = expected["approach-2a"] - 2.0 * 40 * one.n_linear * one.n_eta
    for name, value in found.items():
        numbers[f"table-1/{name}/counted_over_ours"] = value / expected[name]
    for first in ("approach-1", "approach-2a"):
        numbers[f"table-1/{first}/over-2b/ours"] = ours_there[first] / ours_there["approach-2b"]
        numbers[f"table-1/{first}/over-2b/printed"] = print_there[first] / print_there["approach-2b"]
    # Seconds of a processor of 2.8 GHz that does one operation a cycle.
    for row in ("approach-1", "approach-2a", "approach-2b"):
        numbers[f"table-2/{row}/one-operation-a-cycle"] = ours_there[row] / 2.8e9
    return numbers
