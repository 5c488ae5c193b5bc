"""What ``sysid replicate`` does."""

import argparse
import json
import sys
from collections.abc import Mapping
from itertools import groupby
from pathlib import Path

from rich.console import Console
from rich.table import Table

from sysid import claims
from sysid.errors import UsageError
from sysid.gates import Gate, summary
from sysid.locking import only_writer
from sysid.montecarlo import Runner
from sysid.progress import Progress, progress
from sysid.replication import SCHEMA, Paper, Session, chosen_papers, jsonable, provenance, write_results

MINIMUM_RUNS = 10


def run(arguments: argparse.Namespace) -> int:
    """Replicate the chosen papers; return 0 when every gate is green and 1 otherwise."""
    papers = chosen_papers(arguments.papers)
    if not papers:
        raise UsageError("no paper is installed: install a package with the entry point sysid.papers")
    runs = {
        name: arguments.runs or (paper.smoke_runs if arguments.smoke else paper.default_runs)
        for name, paper in papers.items()
    }
    console = Console()
    if arguments.only_run is not None or arguments.case is not None:
        return _replay(arguments, papers, runs)
    if arguments.dry_run:
        _list(console, papers, runs)
        return 0
    if arguments.runs is not None and arguments.runs < MINIMUM_RUNS:
        raise UsageError(
            f"--runs is {arguments.runs}: covariances of the estimates need at least {MINIMUM_RUNS} runs"
        )
    out: Path = arguments.out
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out {out} is a file: name a folder")
    for paper in papers.values():
        claims.read(paper.claims_file)  # a fault in it is told now, not after the studies
    with only_writer(out):
        gates, places = _replicate_all(arguments, papers, runs)
    _print_gates(console, gates)
    for place in places:
        console.print(f"{place.suffix[1:]}: {place}", soft_wrap=True, highlight=False)
    return 0 if all(gate.passed for group in gates.values() for gate in group) else 1


def _replicate_all(
    arguments: argparse.Namespace, papers: Mapping[str, Paper], runs: Mapping[str, int]
) -> tuple[dict[str, list[Gate]], list[Path]]:
    """Replicate the papers and write results and reports; return the gates and the files written."""
    out: Path = arguments.out
    gates: dict[str, list[Gate]] = {}
    results: dict[str, object] = {}
    with progress() as bars:
        for name, paper in papers.items():
            results[name], gates[name] = _replicate(arguments, paper, runs[name], bars)
        written = {
            "schema": SCHEMA,
            "provenance": provenance(papers, runs, arguments.seed),
            "summary": summary(gates),
            "papers": results,
        }
        return gates, [write_results(out, written), *_report(out, arguments.format, papers, bars)]


def _replicate(
    arguments: argparse.Namespace, paper: Paper, runs: int, bars: Progress
) -> tuple[dict[str, object], list[Gate]]:
    """Replicate one paper into its part of the results."""
    with (
        Runner(
            jobs=arguments.jobs,
            backend=arguments.backend,
            scheduler=arguments.scheduler,
            folder=arguments.out / "runs" / paper.id,
            resume=arguments.resume,
        ) as runner,
        bars.task(f"{paper.id}: studies", len(paper.plan(runs))) as bar,
    ):
        session = Session(
            runs,
            arguments.seed,
            arguments.smoke,
            runner,
            finished=bar.advance,
            with_records=arguments.with_records,
        )
        result = paper.replicate(session)
    for failed in session.failures:
        print(
            f"sysid replicate: run {failed.run} of {failed.case} failed: {failed.message}; repeat it with "
            f"--case {failed.case} --only-run {failed.run} --seed {arguments.seed}",
            file=sys.stderr,
        )
    entry = {"title": paper.title, "citation": paper.citation, **result.to_json(session.timings)}
    return entry, list(result.gates)


def _report(out: Path, formats: tuple[str, ...], papers: Mapping[str, Paper], bars: Progress) -> list[Path]:
    """Write the reports that were asked for."""
    wanted = [name for name in formats if name != "json"]
    if not wanted:
        return []
    from sysid.reporting import build

    notebooks = {name: paper.notebook for name, paper in papers.items()}
    with bars.task("reports", len(notebooks) + len(wanted)) as bar:
        reached = 0

        def advance(done: int, total: int, what: str) -> None:
            nonlocal reached
            bar.advance(done - reached)
            reached = done

        return list(build(out, wanted, notebooks=notebooks, progress=advance).values())


def _replay(arguments: argparse.Namespace, papers: Mapping[str, Paper], runs: Mapping[str, int]) -> int:
    """Repeat one run of a case, or of every case, in this process; what it raises is shown in full."""
    if arguments.only_run is None:
        raise UsageError("--case goes with --only-run: give the number of the run")
    tasks = {
        case: task for name, paper in papers.items() for case, (task, _) in paper.plan(runs[name]).items()
    }
    if arguments.case is not None and arguments.case not in tasks:
        raise UsageError(f"no case is named {arguments.case!r}: `sysid replicate --dry-run` lists them")
    chosen = tasks if arguments.case is None else {arguments.case: tasks[arguments.case]}
    runner = Runner(jobs=1)
    values = {
        case: runner.replay(case, task, arguments.only_run, arguments.seed) for case, task in chosen.items()
    }
    print(json.dumps(jsonable(values), indent=1))
    return 0


def _list(console: Console, papers: Mapping[str, Paper], runs: Mapping[str, int]) -> None:
    """Print the studies of a replication."""
    table = Table("paper", "case", "runs", title="what would be run")
    for name, paper in papers.items():
        for case, (_, n_runs) in paper.plan(runs[name]).items():
            table.add_row(name, case, str(n_runs))
    console.print(table)


def _print_gates(console: Console, gates: Mapping[str, list[Gate]]) -> None:
    """Print how many gates of each family are green, and every red one."""
    table = Table("paper", "gates", "type", "passed", "verdict", title="gates")
    for paper, group in gates.items():
        ordered = sorted(group, key=lambda gate: (gate.id.split("/")[0], gate.type))
        for (family, kind), members in groupby(ordered, key=lambda gate: (gate.id.split("/")[0], gate.type)):
            found = list(members)
            passed = sum(gate.passed for gate in found)
            verdict = "green" if passed == len(found) else "RED"
            table.add_row(paper, family, kind, f"{passed} of {len(found)}", verdict)
    console.print(table)
    for paper, group in gates.items():
        for gate in group:
            if not gate.passed:
                console.print(
                    f"RED {paper} {gate.id}: {gate.value:.6g} is not in [{gate.lower:.6g}, {gate.upper:.6g}] "
                    f"({gate.type}: {gate.reason})",
                    highlight=False,
                    soft_wrap=True,
                )
    console.print(summary(gates), highlight=False, soft_wrap=True)
