"""LFT models as JSON files."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import DataError, SysidError, UsageError
from sysid.lft import piecewise_files
from sysid.lft.model import LftModel
from sysid.lft.piecewise import PiecewiseLft
from sysid.lft.structure import LftStructure
from sysid.lft.wiener_hammerstein import files as wiener_hammerstein_files
from sysid.lft.wiener_hammerstein.model import WienerHammerstein
from sysid.nonlinearities.spline import Spline

KIND, SCHEMA = "sysid-lft-model", 1


def save(model: LftModel, path: str | Path) -> None:
    """Write a model, apart from the data it was fitted to, as JSON.

    Parameters
    ----------
    model : LftModel
        An `LftFit`, or what `load` returned.
    path : str or Path

    Raises
    ------
    UsageError
        If the file cannot be written.
    """
    try:
        Path(path).write_text(json.dumps(to_json(model), indent=1) + "\n", encoding="utf-8")
    except OSError as problem:
        raise UsageError(f"{path} cannot be written ({problem.strerror}): choose another place") from None


def load(path: str | Path) -> LftModel | WienerHammerstein | PiecewiseLft:
    """Read a model that `save`, or `--save` on the command line, wrote.

    Raises
    ------
    DataError
        If the file is no such model.

    Examples
    --------
    >>> import numpy as np, pathlib, tempfile
    >>> from sysid.lft import LftStructure, fit_lft, lags
    >>> u = np.random.default_rng(0).uniform(-1, 1, 200)
    >>> y = np.r_[0.0, np.tanh(2 * u[:-1])]
    >>> fit = fit_lft((u, y), LftStructure(z_lags=lags("u", 1), knots=6))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(fit, pathlib.Path(folder) / "model.json")
    ...     model = load(pathlib.Path(folder) / "model.json")
    >>> bool(np.array_equal(model.simulate((u, y)), fit.simulate((u, y))))
    True
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        for other in (wiener_hammerstein_files, piecewise_files):
            if content["kind"] == other.KIND:
                return other.from_json(content)  # type: ignore[no-any-return]
        return from_json(content)
    except OSError as problem:
        raise DataError(f"{path} cannot be read ({problem.strerror}): give a saved model") from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as problem:
        reason = str(problem) if isinstance(problem, SysidError) else repr(problem)
        raise DataError(f"{path} is no saved LFT model ({reason}): write one with --save") from None


def to_json(model: LftModel) -> dict[str, Any]:
    """Return plain values; a coefficient without a variance has null."""
    covariance = [
        [value if np.isfinite(value) else None for value in row] for row in model.covariance.tolist()
    ]
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "structure": asdict(model.structure),
        "inputs": list(model.inputs),
        "output": model.output,
        "a": model.a.tolist(),
        "b": model.b.tolist(),
        "g": model.g.tolist(),
        "d": model.d.tolist(),
        "map": {"knots": model.map.knots.tolist(), "coefficients": model.map.coefficients.tolist()},
        "names": list(model.names),
        "covariance": covariance,
        "noise_std": model.noise_std,
        "end_taps": model.end_taps.tolist(),
    }


def from_json(content: dict[str, Any]) -> LftModel:
    """Return the model of plain values; whatever is wrong with them raises."""
    if content["kind"] != KIND or content["schema"] != SCHEMA:
        raise DataError("it is of another kind or version")
    entries = dict(content["structure"])
    for field in ("b_lags", "z_lags"):
        entries[field] = tuple((signal, delay) for signal, delay in entries[field])
    structure = LftStructure(**entries)
    names = tuple(str(name) for name in content["names"])
    arrays = {key: np.array(content[key], dtype=np.float64) for key in ("a", "b", "g", "d", "end_taps")}
    covariance = np.array(
        [[np.nan if value is None else value for value in row] for row in content["covariance"]],
        dtype=np.float64,
    )
    n_d = len(structure.z_lags)
    shapes = {
        "a": (structure.n_a + 1,),
        "b": (len(structure.b_lags),),
        "g": (structure.n_g + 1,),
        "d": (n_d,),
    }
    for key, shape in (shapes | {"end_taps": (2, n_d)}).items():
        if arrays[key].shape != shape or not np.isfinite(arrays[key]).all():
            raise DataError(f"{key} does not have {' x '.join(map(str, shape))} finite values")
    n_map = structure.knots - 1 + structure.degree
    n_linear = len(structure.linear_lags) - len(structure.left_out())
    if len(names) != n_linear + structure.n_g + n_d + n_map or covariance.shape != (len(names), len(names)):
        raise DataError("names and covariance do not fit its structure")
    curve = Spline(
        np.array(content["map"]["knots"], dtype=np.float64),
        np.array(content["map"]["coefficients"], dtype=np.float64),
        structure.degree,
        structure.extrapolation,
    )
    return LftModel(
        structure=structure,
        inputs=tuple(str(name) for name in content["inputs"]),
        output=str(content["output"]),
        map=curve,
        names=names,
        covariance=covariance,
        noise_std=float(content["noise_std"]),
        **arrays,
    )
