"""One case through the command `sysid diagnose`, and what came of it."""

import contextlib
import csv
import io
import json
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_effects.intervals import plant_values, true_values
from benchmarks.hidden_effects.plan import Assignment
from benchmarks.hidden_effects.refit import rms, true_structure

NOT_PHYSICAL = "coloured_noise"


def write_case(assignment: Assignment, folder: Path) -> None:
    """Write ``record.csv`` and ``case.json``, as they are handed over, and the sealed ``truth.json``."""
    folder.mkdir(parents=True, exist_ok=True)
    case = assignment.case
    with (folder / "record.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["k", "u", "y", "set"])
        for k, (u, y, part) in enumerate(zip(case.u, case.y, case.sets, strict=True)):
            writer.writerow([k, repr(float(u)), "" if part == "test" else repr(float(y)), part])
    command = ["sysid", "diagnose", "record.csv", *assignment.arguments]
    _write(folder / "case.json", {"id": assignment.identifier, "command": command})
    _write(folder / "truth.json", {"tier": assignment.tier, "kind": assignment.kind, **case.truth()})


def judge(assignment: Assignment, folder: Path) -> dict[str, Any]:
    """Diagnose a case in this process and score the answer.

    Parameters
    ----------
    assignment : Assignment
    folder : Path
        Keeps the case and the answer.

    Returns
    -------
    dict
        Truth, answer and scores in plain values; ``error`` is the message of a diagnosis that failed.
    """
    write_case(assignment, folder)
    worked = time.process_time()
    answer, seconds, error = _diagnose(assignment, folder)
    worked = time.process_time() - worked
    case = assignment.case
    result: dict[str, Any] = {
        "id": assignment.identifier,
        "tier": assignment.tier,
        "kind": assignment.kind,
        "family": case.plant.family,
        "order": case.plant.order,
        "excitation": case.excitation,
        "share": case.share,
        "snr": case.snr,
        "truth": list(case.names),
        "seconds": seconds,
        "cpu_seconds": worked,
        "error": error,
    }
    if error is None:
        result |= _answer(assignment, answer) | _errors(assignment, folder)
    return result


def _diagnose(assignment: Assignment, folder: Path) -> tuple[Any, float, str | None]:
    from sysid.cli import main

    answer_file, predictions = folder / "answer.json", folder / "predictions.csv"
    arguments = ["diagnose", str(folder / "record.csv"), *assignment.arguments]
    arguments += ["--json", str(answer_file), "--predictions", str(predictions)]
    said, complained = io.StringIO(), io.StringIO()
    began = time.perf_counter()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
            code = main(arguments)
    except (Exception, SystemExit) as failure:
        code, complaint = 3, f"{type(failure).__name__}: {failure}"
    else:
        complaint = complained.getvalue().strip()
    seconds = time.perf_counter() - began
    if code != 0:
        return None, seconds, " ".join(f"exit code {code}: {complaint}".split())[:500]
    return json.loads(answer_file.read_text(encoding="utf-8")), seconds, None


def _answer(assignment: Assignment, answer: Any) -> dict[str, Any]:
    ranked = answer["ranked"]
    physical = [entry for entry in ranked if entry["effect"] != NOT_PHYSICAL]
    p_values = [entry["p_value"] for entry in physical if entry["p_value"] is not None]
    return {
        "verdict": answer["verdict"],
        "accepted": answer["accepted"],
        "ranked": [entry["effect"] for entry in ranked],
        "tie": answer.get("tie") or [],
        "p_value": min(p_values, default=None),
        "intervals": _intervals(assignment, ranked),
        "plant_intervals": _plant_intervals(assignment, answer),
    }


def _intervals(assignment: Assignment, ranked: list[Any]) -> list[dict[str, Any]]:
    """Standardised errors of the parameters of the true effect, where it is the only one."""
    if len(assignment.case.effects) != 1:
        return []
    effect = assignment.case.effects[0]
    found: list[dict[str, Any]] = []
    for entry in ranked:
        if entry["effect"] != effect.name:
            continue
        fitted: Mapping[str, Any] = entry["parameters"]
        truth = true_values(effect.name, effect.parameters, assignment.case.plant.period, list(fitted))
        found += _standardised(truth, fitted)
    return found


def _plant_intervals(assignment: Assignment, answer: Any) -> list[dict[str, Any]]:
    """Standardised errors of the parameters of the plant, where its structure was found."""
    found, hidden = (
        {name for name in names if name != NOT_PHYSICAL}
        for names in (answer["accepted"], assignment.case.names)
    )
    if assignment.kind == "outside" or answer["verdict"] == "unexplained" or found != hidden:
        return []
    return _standardised(plant_values(assignment.case), answer["ladder"][-1]["parameters"])


def _standardised(truth: Mapping[str, float], fitted: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the errors in standard errors, where there is one."""
    found: list[dict[str, Any]] = []
    for name in truth.keys() & fitted.keys():
        error = fitted[name].get("std_error")
        if error is not None and math.isfinite(error) and error > 0.0:
            found.append({"parameter": name, "z": (fitted[name]["value"] - truth[name]) / error})
    return sorted(found, key=lambda entry: entry["parameter"])


def _errors(assignment: Assignment, folder: Path) -> dict[str, Any]:
    """Free-run errors on the test rows, against the noise-free output."""
    case = assignment.case
    test = case.sets == "test"
    with (folder / "predictions.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = {name: np.array([float(row[name]) for row in rows])[test] for name in ("baseline", "final")}
    clean = case.noise_free[test]
    best = rms(true_structure(case)[test] - clean)
    baseline, final = (rms(columns[name] - clean) for name in ("baseline", "final"))
    possible = baseline - best
    # Nothing can be gained where nothing, or only the noise's colour, is missing.
    physical = any(name != NOT_PHYSICAL for name in case.names)
    return {
        "test_baseline": baseline,
        "test_final": final,
        "test_true": best,
        "test_scale": float(np.std(clean)),
        "reduction": (baseline - final) / possible if physical and possible > 0.0 else None,
    }


def _write(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
