"""The command `sysid diagnose`: which effect a model lacks."""

import argparse
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from sysid.commands.model_options import assigned_values
from sysid.commands.record_options import read_described
from sysid.errors import UsageError
from sysid.result_files import check_results, to_json_text, write_result, write_text

if TYPE_CHECKING:
    from pathlib import Path

    from sysid.diagnosis.diagnosis import Diagnosis
    from sysid.diagnosis.effects import Effect


def run(arguments: argparse.Namespace) -> int:
    """Run `sysid diagnose`; errors of use and of data are raised as `SysidError`."""
    from threadpoolctl import threadpool_limits

    from sysid.diagnosis.diagnose import diagnose

    _check(arguments)
    results = [
        arguments.json,
        arguments.predictions,
        arguments.html,
        arguments.pdf,
        arguments.save,
        arguments.draft,
    ]
    check_results([path for path in results if path is not None], arguments.data)
    candidates = _candidates(arguments)
    start = assigned_values("--param", arguments.param)
    fixed = assigned_values("--fix", arguments.fix)
    model = _model(arguments, start, fixed)
    record = read_described(arguments)
    with threadpool_limits(1):  # all products are of one long row: a second thread would only wait
        diagnosis = diagnose(
            record,
            model,
            arguments.order,
            initial_state=arguments.initial_state,
            effects=candidates,
            max_effects=arguments.max_effects,
            alpha=arguments.alpha,
            accept=partial(_ask, candidates) if arguments.accept == "ask" else arguments.accept,
            add=_added(arguments, candidates),
            start=start,
            fixed=fixed,
            seed=arguments.seed,
            jobs=arguments.jobs,
            progress=None,
            thorough=arguments.thorough,
        )
        for sentence in diagnosis.sentences():
            print(sentence)
        for warning in diagnosis.record.warnings:
            print(f"Note: {warning}")
        sys.stdout.flush()  # what was found is told even if a file cannot be written
        _write(diagnosis, arguments)
    if arguments.draft is not None:
        print(_drafted(diagnosis, arguments.draft))
    return 0


def _drafted(diagnosis: "Diagnosis", path: "Path") -> str:
    """Write the best curve as an effect; say what was written."""
    draft = diagnosis.draft()
    if not draft:
        return f"No draft was written to {path}: no curve explains what no candidate does."
    write_text(path, draft)
    return f"{path} has the curve as an effect: edit it, and give it with --effects-file {path}."


def _check(arguments: argparse.Namespace) -> None:
    if arguments.jobs < 1:
        raise UsageError(f"--jobs is {arguments.jobs}: give 1 or more")
    if arguments.max_effects < 0:
        raise UsageError(f"--max-effects is {arguments.max_effects}: give 0 or more")
    if not 0.0 < arguments.alpha < 1.0:
        raise UsageError(f"--alpha is {arguments.alpha:g}: give a chance between 0 and 1")
    if arguments.save is not None:
        from sysid.diagnosis.export.saved import check_ending

        check_ending(arguments.save)
    if arguments.seed < 0:
        raise UsageError(f"--seed is {arguments.seed}: give 0 or more")


def _candidates(arguments: argparse.Namespace) -> "tuple[Effect, ...]":
    from sysid.diagnosis.effects import catalogue, find_effects, read_effects
    from sysid.diagnosis.effects.catalogue import checked

    known = catalogue()
    if arguments.effects_file is not None:
        known = checked([*known, *read_effects(arguments.effects_file)])
    if arguments.effects is None:
        return known
    names = [name.strip() for name in arguments.effects.split(",") if name.strip()]
    if not names:
        raise UsageError("--effects names no effect: give names separated by commas")
    return find_effects(names, known)


def _added(arguments: argparse.Namespace, candidates: "tuple[Effect, ...]") -> "list[str | Effect]":
    known = {effect.name: effect for effect in candidates}
    return [known.get(name, name) for name in dict.fromkeys(arguments.add or ())]


def _model(arguments: argparse.Namespace, start: dict[str, float], fixed: dict[str, float]) -> Any:
    from sysid.diagnosis.models.resolution import resolve_model

    resolve_model(arguments.model, arguments.order, start, fixed)  # before a long file is read
    return arguments.model


def _ask(candidates: "tuple[Effect, ...]", name: str) -> bool:
    """Say what was found and ask on the terminal; no answer means no."""
    for effect in candidates:
        if effect.name == name:
            print(f"{name} is missing in the model. {effect.mechanism}")
    print(f"Add {name}? [y/N] ", end="", flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _write(diagnosis: "Diagnosis", arguments: argparse.Namespace) -> None:
    """Write the files that were asked for, and say where they are."""
    if arguments.json is not None:
        write_text(arguments.json, to_json_text(diagnosis.to_json()))
    if arguments.predictions is not None:
        diagnosis.write_predictions(arguments.predictions)
    if arguments.html is not None:
        write_text(arguments.html, diagnosis.to_html())
    if arguments.pdf is not None:
        write_result(arguments.pdf, diagnosis.to_pdf())
    if arguments.save is not None:
        from sysid.diagnosis.export.saved import save

        save(diagnosis.final, arguments.save)
    results = {"Page": arguments.html, "PDF": arguments.pdf, "JSON": arguments.json}
    results |= {"Predictions": arguments.predictions, "Model": arguments.save}
    for name, path in results.items():
        if path is not None:
            print(f"{name}: {path}")
