"""Command line of the bench: ``python -m benchmarks.hidden_effects``."""

import argparse
import json
import sys
from pathlib import Path

from benchmarks.hidden_effects.plan import FAMILIES, KINDS, TIERS, assign
from benchmarks.hidden_effects.study import Study, outcomes, scores_table
from benchmarks.hidden_effects.summary import summarise
from sysid.errors import SysidError

DEFAULTS = {"cases": 60, "seed": 0, "jobs": 1, "out": Path("hidden-effects")}


def main() -> int:
    """Run the bench, write the cases alone, or build the report of a finished run."""
    arguments = _parser().parse_args()
    try:
        return int(arguments.action(arguments))
    except SysidError as error:
        print(f"hidden_effects: error: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects", description=__doc__)
    parser.set_defaults(action=_run, **DEFAULTS)
    _add_study(parser)
    commands = parser.add_subparsers(metavar="ACTION")
    # Without defaults of its own it leaves the options that stand before its name as they are.
    draw = commands.add_parser(
        "draw", help="write the cases without diagnosing them", argument_default=argparse.SUPPRESS
    )
    _add_study(draw)
    draw.set_defaults(action=_draw)
    report = commands.add_parser("report", help="build report.html and report.pdf of a finished run")
    report.add_argument("--out", type=Path, required=True, metavar="DIR")
    report.set_defaults(action=_report)
    return parser


def _add_study(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--cases", type=int, metavar="N", help="cases of each tier")
    parser.add_argument("--seed", type=int, metavar="S", help="below 10000: to develop on")
    parser.add_argument(
        "--tier", action="append", choices=list(TIERS), help="default: normal; may be repeated"
    )
    parser.add_argument("--family", choices=list(FAMILIES))
    parser.add_argument("--kind", choices=list(KINDS))
    parser.add_argument("--effect", metavar="NAME", help="hide this effect in every case")
    parser.add_argument("--full", action="store_true", help="ask about the whole catalogue")
    parser.add_argument("--jobs", type=int, metavar="J")
    parser.add_argument("--resume", action="store_true", help="keep the outcomes that are there")
    parser.add_argument("--out", type=Path, metavar="DIR")


def _studies(arguments: argparse.Namespace) -> list[Study]:
    a = arguments
    tiers = a.tier or ["normal"]
    return [Study(a.seed, a.cases, tier, a.family, a.kind, a.effect, a.full) for tier in tiers]


def _run(arguments: argparse.Namespace) -> int:
    for study in _studies(arguments):
        study.run(arguments.out, arguments.jobs, resume=arguments.resume)
    found = outcomes(arguments.out)
    summary = summarise(found)
    content = {"schema": 1, "seed": arguments.seed, "summary": summary, "outcomes": found}
    (arguments.out / "summary.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    print("\n".join(scores_table(summary)))
    return 0


def _draw(arguments: argparse.Namespace) -> int:
    from benchmarks.hidden_effects.outcome import write_case

    for study in _studies(arguments):
        for number in range(study.cases):
            case = assign(
                study.seed, number, study.tier, study.family, study.kind, study.effect, full=study.full
            )
            write_case(case, arguments.out / "cases" / case.identifier)
    return 0


def _report(arguments: argparse.Namespace) -> int:
    from benchmarks.hidden_effects.report import build_report

    for path in build_report(arguments.out).values():
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
