"""Other tools on the cases of a finished run: ``python -m benchmarks.hidden_effects.peers --out DIR``.

Runs in an environment of its own (`tox -e bench-effects-peers`) and uses nothing of sysid but the files of
the run. Each tool gets the rows ``est`` and ``val``, the order of the plant, and its settings chosen by the
free run on ``val``; its error is that of the free run on ``test`` against the noise-free output.
"""

import argparse
import contextlib
import csv
import io
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Data:
    """A case as a tool sees it, input and output scaled to unit deviation.

    ``y`` is NaN on the test rows; ``fit`` are the rows of the estimate, ``check`` those that choose settings.
    """

    u: Floats
    y: Floats
    order: int
    fit: slice
    check: slice


FreeRun = Callable[[Data], Floats]
"""Data -> free run over all rows, in the scale of the data."""


@dataclass(frozen=True)
class Tool:
    """What runs, what it is told beyond the record, and what its answer names.

    A string in the place of what runs names the column of the diagnosis's predictions that is judged.
    """

    name: str
    told: str
    names: str
    run: FreeRun | str


def sparse_library(data: Data) -> Floats:
    """Fit y(k + 1) and its lags by sparse regression on polynomials of lags (pysindy)."""
    import pysindy

    u, y = data.u, data.y
    candidates = []
    for lags in (data.order, data.order + 1):
        states = _lagged(y, lags)
        inputs = _lagged(u, lags)
        rows = slice(lags, data.fit.stop)
        for degree in (2, 3):
            for threshold in (0.001, 0.01, 0.05):
                model = pysindy.DiscreteSINDy(
                    optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-6),
                    feature_library=pysindy.PolynomialLibrary(degree=degree),
                )
                model.fit(states[rows], t=1, u=inputs[rows])
                candidates.append(_library_run(model, inputs, lags))
    return _best(candidates, data)


def _library_run(model: Any, inputs: Floats, lags: int) -> Floats:
    """Iterate the first equation of the fitted library; the others only shift."""
    powers = model.feature_library.powers_
    weights = model.coefficients()[0]
    powers, weights = powers[weights != 0.0], weights[weights != 0.0]
    y = np.zeros(len(inputs))
    state = np.zeros(lags)
    for k in range(len(inputs) - 1):
        here = np.concatenate([state, inputs[k]])
        value = float(np.prod(here**powers, axis=1) @ weights)
        if not abs(value) < 1e6:
            return np.full(len(inputs), np.nan)
        y[k + 1] = value
        state = np.concatenate([[value], state[:-1]])
    return y


def polynomial_narx(data: Data) -> Floats:
    """Select terms of a polynomial NARX model by forward regression (sysidentpy)."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    u, y = data.u[:, np.newaxis], data.y[:, np.newaxis]
    candidates = []
    for lags in (data.order, data.order + 1):
        for degree in (2, 3):
            model = FROLS(
                order_selection=True,
                n_info_values=25,
                ylag=lags,
                xlag=lags,
                info_criteria="bic",
                estimator=LeastSquares(),
                basis_function=Polynomial(degree=degree),
                model_type="NARMAX",
            )
            model.fit(X=u[data.fit], y=y[data.fit])
            candidates.append(np.ravel(model.predict(X=u, y=y[: model.max_lag])))
    return _best(candidates, data)


def state_network(data: Data) -> Floats:
    """Fit a state-space model with a small neural network in both maps (jax-sysid)."""
    import jax
    from jax_sysid.models import Model

    jax.config.update("jax_enable_x64", True)
    n, width = data.order + 1, 6

    def hidden(p: Any, x: Any, u: Any, at: int) -> Any:
        return p[at + 2] @ jax.numpy.tanh(p[at] @ jax.numpy.concatenate([x, u]) + p[at + 1])

    def state(x: Any, u: Any, p: Any) -> Any:
        return p[0] @ x + p[1] @ u + hidden(p, x, u, 4)

    def output(x: Any, u: Any, p: Any) -> Any:
        return p[2] @ x + p[3] @ u + hidden(p, x, u, 7)

    candidates = []
    for seed in range(2):
        rng = np.random.default_rng(seed)

        def small(*shape: int, rng: np.random.Generator = rng) -> Floats:
            return 0.1 * rng.standard_normal(shape)

        linear = [0.7 * np.eye(n) + 0.1 * small(n, n), small(n, 1), small(1, n), np.zeros((1, 1))]
        networks = [small(width, n + 1), np.zeros(width), small(n, width)]
        networks += [small(width, n + 1), np.zeros(width), small(1, width)]
        model = Model(n, 1, 1, state_fcn=state, output_fcn=output)
        model.init(params=linear + networks)
        model.loss(rho_x0=1e-3, rho_th=1e-5, train_x0=False)
        model.optimization(adam_epochs=400, lbfgs_epochs=600, iprint=-1)
        model.fit(data.y[data.fit, np.newaxis], data.u[data.fit, np.newaxis])
        candidates.append(np.ravel(model.predict(np.zeros(n), data.u[:, np.newaxis])[0]))
    return _best(candidates, data)


TOOLS = (
    Tool("sysid diagnose", "the model and candidates", "the effect", "final"),
    Tool("linear model, residual tests", "the model", "that something is missing", "baseline"),
    Tool("pysindy", "the order", "polynomial terms", sparse_library),
    Tool("sysidentpy", "the order", "polynomial terms", polynomial_narx),
    Tool("jax-sysid", "the order", "nothing", state_network),
)


def main() -> int:
    """Run the tools on the cases of a finished run and write ``peers.json`` beside them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects.peers", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the finished run")
    parser.add_argument(
        "--cases", type=int, default=40, metavar="N", help="single-effect cases, from the first"
    )
    arguments = parser.parse_args()
    rows = []
    for outcome in _chosen(arguments.out, arguments.cases):
        for tool in TOOLS:
            rows.append(_judged(tool, outcome, arguments.out))
            ratio = rows[-1]["ratio"]
            print(outcome["id"], tool.name, "failed" if ratio is None else f"{ratio:.2f}", flush=True)
        content = json.dumps({"schema": 1, "outcomes": rows}, indent=1)
        (arguments.out / "peers.json").write_text(content + "\n", encoding="utf-8")
    return 0


def _chosen(folder: Path, count: int) -> list[dict[str, Any]]:
    """Return outcomes with one effect that is not noise, whose answer is there to compare with."""
    paths = sorted((folder / "outcomes").glob("*.json"))
    found = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
    single = [o for o in found if o["kind"] == "single" and o["truth"] != ["coloured_noise"]]
    return [o for o in single if o["error"] is None and o["test_true"] > 0.0][:count]


def _judged(tool: Tool, outcome: dict[str, Any], folder: Path) -> dict[str, Any]:
    case = folder / "cases" / outcome["id"]
    with (case / "record.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    truth = json.loads((case / "truth.json").read_text(encoding="utf-8"))
    u = np.array([float(row["u"]) for row in table])
    y = np.array([float(row["y"] or "nan") for row in table])
    sets = [row["set"] for row in table]
    clean = np.array(truth["noise_free_test"])
    began, error, ratio = time.perf_counter(), None, None
    try:
        if isinstance(tool.run, str):
            model = _predicted(case, tool.run)
        else:
            model = _scaled(tool.run, u, y, sets, outcome["order"])
        rms = float(np.sqrt(np.mean((model[-clean.size :] - clean) ** 2)))
        ratio = rms / outcome["test_true"] if math.isfinite(rms) else None
        error = None if ratio is not None else "the free run diverges"
    except Exception as failure:
        error = " ".join(f"{type(failure).__name__}: {failure}".split())[:300]
    seconds = outcome["seconds"] if isinstance(tool.run, str) else time.perf_counter() - began
    answer = {"id": outcome["id"], "tool": tool.name, "told": tool.told, "names": tool.names}
    return answer | {"ratio": ratio, "error": error, "seconds": seconds}


def _scaled(run: FreeRun, u: Floats, y: Floats, sets: list[str], order: int) -> Floats:
    """Run a tool on scaled data, silently, and scale its free run back."""
    n_est, n_known = sets.index("val"), sets.index("test")
    scale_u, scale_y = float(np.std(u[:n_known])), float(np.std(y[:n_known]))
    data = Data(u / scale_u, y / scale_y, order, slice(0, n_est), slice(n_est, n_known))
    with warnings.catch_warnings(), np.errstate(all="ignore"), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        return run(data) * scale_y


def _predicted(case: Path, column: str) -> Floats:
    with (case / "predictions.csv").open(encoding="utf-8") as file:
        return np.array([float(row[column]) for row in csv.DictReader(file)])


def _lagged(signal: Floats, lags: int) -> Floats:
    """Return columns signal(k), signal(k - 1), ...; zero before the first row."""
    columns = [np.concatenate([np.zeros(i), signal[: signal.size - i]]) for i in range(lags)]
    return np.column_stack(columns)


def _best(candidates: Iterable[Floats], data: Data) -> Floats:
    """Return the free run with the smallest error on the rows that choose."""

    def error(run: Floats) -> float:
        value = float(np.mean((run[data.check] - data.y[data.check]) ** 2))
        return value if math.isfinite(value) else math.inf

    return min(candidates, key=error)


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    sys.exit(main())
