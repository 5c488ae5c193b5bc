"""What ``sysid demo`` does: a record with a hidden effect, and its truth afterwards."""

import argparse
import csv
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np

from sysid.demonstration import Case, Difficulty, draw_case
from sysid.demonstration.sealing import reveal, seal
from sysid.diagnosis.wording import plus_minus, value_beside
from sysid.errors import DataError, UsageError

RECORD, TRUTH, DIAGNOSIS = "record.csv", "truth.sealed", "diagnosis.json"

SCENES = (
    ("dc-motor", "coulomb"),
    ("mass-spring-damper", "cubic_stiffness"),
    ("dc-motor", "in_deadzone"),
    ("two-tanks", "sqrt_outflow"),
    ("difference-equation", "in_backlash"),
    ("dc-motor", "in_saturation"),
    ("mass-spring-damper", "coulomb"),
    ("two-tanks", "overflow"),
    ("difference-equation", "in_deadzone"),
    ("mass-spring-damper", "out_saturation"),
    ("dc-motor", "in_backlash"),
)
"""Plants and what is hidden in them; the seed chooses."""

MECHANISMS = {
    "coulomb": "dry friction",
    "cubic_stiffness": "a spring that stiffens with the cube of the deflection",
    "in_deadzone": "a dead zone of the actuator",
    "sqrt_outflow": "outflows with the square root of the level",
    "in_backlash": "backlash in the drive",
    "in_saturation": "saturation of the actuator",
    "overflow": "a tank that overflows",
    "out_saturation": "saturation of the sensor",
}

FOUND_AS = {
    "coulomb": {"friction": "Fc"},
    "cubic_stiffness": {"stiffness": "k3"},
    "in_deadzone": {"lower": "width_negative", "upper": "width_positive"},
    "in_backlash": {"lower": "width_negative", "upper": "width_positive"},
    "in_saturation": {"lower": "level_negative", "upper": "level_positive"},
    "out_saturation": {"lower": "level_negative", "upper": "level_positive"},
    "overflow": {"rim": "limit_2"},
    "sqrt_outflow": {},
}
"""Names that the diagnosis has for the true parameters; what else was drawn says nothing to its reader."""


def run(arguments: argparse.Namespace) -> int:
    """Make a record with a hidden effect, or reveal what was hidden."""
    lines = _reveal(arguments.reveal) if arguments.reveal else _make(arguments.out, arguments.seed)
    print("\n".join(lines))
    return 0


def _make(folder: Path, seed: int) -> list[str]:
    if seed < 0:
        raise UsageError(f"--seed is {seed}; give an integer >= 0.")
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out {folder} is a file: name a folder, which is made if it is not there.")
    rng = np.random.default_rng(seed)
    family, effect = SCENES[(seed - 1) % len(SCENES)]
    case = draw_case(rng, family, [effect], Difficulty(share=(0.05, 0.3), snr=(25.0, 40.0)))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / DIAGNOSIS).unlink(missing_ok=True)  # an answer to another record would be held against this
    _write_record(case, folder / RECORD)
    fingerprint = seal(case.truth(), folder / TRUTH)
    compare, diagnose = commands(case, folder)
    return [
        f"{folder / RECORD}: input u and output y of a {family}, {case.u.size} samples.",
        f"{folder / TRUTH}: what is hidden in it, sealed; fingerprint {fingerprint}.",
        "",
        "How well does a linear model do, and where does it fail?",
        f"    {compare}",
        "What is missing in the model, and how much better is it with it?",
        f"    {diagnose}",
        "Was that right?",
        f"    {shlex.join(['sysid', 'demo', '--reveal', str(folder)])}",
    ]


def commands(case: Case, folder: Path) -> tuple[str, str]:
    """Return the commands that compare and diagnose the record in `folder`."""
    data = [str(folder / RECORD), "--input", "u", "--output", "y", "--period", repr(case.plant.period)]
    data += ["--split-column", "set"]
    page = ["--html", str(folder / "compare.html")]
    answer = ["--json", str(folder / DIAGNOSIS), "--html", str(folder / "diagnosis.html")]
    return (
        shlex.join(["sysid", "compare", *data, "--model", "linear", *page]),
        shlex.join(["sysid", "diagnose", *data, *case.model_arguments(), "--initial-state", "rest", *answer]),
    )


def _write_record(case: Case, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["k", "u", "y", "set"])
        for k, (u, y, part) in enumerate(zip(case.u, case.y, case.sets, strict=True)):
            writer.writerow([k, f"{u:.9g}", f"{y:.9g}", part])


def _reveal(folder: Path) -> list[str]:
    truth, fingerprint = reveal(folder / TRUTH)
    names = [effect["name"] for effect in truth["effects"]]
    lines = [
        f"Hidden in the {truth['family']}: {', '.join(f'{n} ({MECHANISMS[n]})' for n in names)}; "
        f"fingerprint {fingerprint}."
    ]
    answer = _answer(folder / DIAGNOSIS) if (folder / DIAGNOSIS).exists() else None
    for effect in truth["effects"]:
        lines += _parameters(effect, {} if answer is None else _found(answer))
    lines.append(
        f"{100 * truth['share']:.0f} % of the output's variance, from rest on, is beyond any linear model; "
        f"the noise is {truth['snr']:.0f} dB below the signal."
    )
    if answer is not None:
        accepted = [str(name) for name in answer["accepted"]]
        said = ", ".join(accepted) if accepted else "nothing"
        agreement = "It agrees." if set(accepted) == set(names) else "It does not agree."
        lines.append(f"The diagnosis added {said}. {agreement}")
    return lines


def _parameters(effect: dict[str, Any], found: dict[str, Any]) -> list[str]:
    """Return the true parameters of an effect under the diagnosis's names, beside what it found."""
    lines = []
    for drawn, name in FOUND_AS[effect["name"]].items():
        value = effect["parameters"][drawn]
        estimate = found.get(name) or found.get(name.partition("_")[0])  # one for both sides
        beside = f"   (found: {_with_interval(estimate)})" if estimate else ""
        lines.append(f"    {name} = {value:.4g}{beside}")
    return lines


def _with_interval(estimate: dict[str, Any]) -> str:
    spread = float("nan") if estimate["std_error"] is None else estimate["std_error"]
    words = (value_beside(estimate["value"], spread), plus_minus(spread), estimate["unit"])
    return " ".join(word for word in words if word)


def _found(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters of the final model, with their names."""
    ladder = answer.get("ladder")
    return dict(ladder[-1]["parameters"]) if ladder else {}


def _answer(path: Path) -> dict[str, Any]:
    """Return what `sysid diagnose --json` wrote."""
    try:
        answer: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        answer["accepted"] = list(answer["accepted"])
        return answer
    except (ValueError, KeyError, TypeError):
        raise DataError(f"{path} is not an answer of `sysid diagnose --json`; run it again.") from None
