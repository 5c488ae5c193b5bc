"""Run many cases, keep each outcome as soon as it is there, go on after an interruption."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.hidden_effects.outcome import judge
from benchmarks.hidden_effects.plan import assign
from sysid.errors import UsageError
from sysid.progress import progress


@dataclass(frozen=True)
class Study:
    """What is run.

    Attributes
    ----------
    seed, cases : int
    tier : str
    family, kind, effect : str or None
        Restrict what is drawn.
    full : bool
        Ask about the whole catalogue.
    """

    seed: int
    cases: int
    tier: str = "normal"
    family: str | None = None
    kind: str | None = None
    effect: str | None = None
    full: bool = False

    def run(self, folder: Path, jobs: int = 1, *, resume: bool = False) -> list[dict[str, Any]]:
        """Judge all cases; outcomes that are there are kept with `resume`.

        Raises
        ------
        UsageError
            If the folder holds outcomes of a study with other settings.
        """
        from joblib import Parallel, delayed

        folder.mkdir(parents=True, exist_ok=True)
        self._claim(folder, resume=resume)
        missing = [number for number in range(self.cases) if not self._outcome(folder, number).exists()]
        work = (delayed(_case)(self, number, folder) for number in missing)
        with progress() as bars, bars.task(self.tier, self.cases, self.cases - len(missing)) as bar:
            finished: Iterator[Any] = Parallel(n_jobs=jobs, return_as="generator_unordered")(work)
            for _ in finished:
                bar.advance()
        return outcomes(folder)

    def _outcome(self, folder: Path, number: int) -> Path:
        return folder / "outcomes" / f"{self.tier}-{self.seed:05d}-{number:04d}.json"

    def _claim(self, folder: Path, *, resume: bool) -> None:
        """Let only outcomes of one setting gather in a folder; the number of cases may grow."""
        (folder / "outcomes").mkdir(exist_ok=True)
        claim = folder / "outcomes" / f"{self.tier}-{self.seed:05d}.settings"
        settings = json.dumps([self.family, self.kind, self.effect, self.full])
        if not resume:
            for path in (folder / "outcomes").glob(f"{self.tier}-{self.seed:05d}-*.json"):
                path.unlink()
        elif claim.exists() and claim.read_text(encoding="utf-8") != settings:
            raise UsageError(
                f"{folder} holds cases of seed {self.seed} drawn with other settings; choose another folder."
            )
        claim.write_text(settings, encoding="utf-8")


def outcomes(folder: Path) -> list[dict[str, Any]]:
    """Read the outcomes of a folder in the order of their names."""
    return [json.loads(path.read_text("utf-8")) for path in sorted((folder / "outcomes").glob("*.json"))]


def _case(study: Study, number: int, folder: Path) -> None:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        assignment = assign(
            study.seed, number, study.tier, study.family, study.kind, study.effect, full=study.full
        )
        outcome = judge(assignment, folder / "cases" / assignment.identifier)
    path = study._outcome(folder, number)
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(outcome, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def scores_table(summary: dict[str, Any]) -> Sequence[str]:
    """Return the lines that a terminal shows."""
    lines = []
    for tier, figures in summary.items():
        lines.append(f"{tier}: {figures['cases']} cases, {len(figures['failed'])} failed")
        for score in figures["scores"].values():
            if score["n"]:
                lines.append(f"  {_line(score)}")
        time, cover = figures["seconds"], figures["intervals"]
        if cover["n"]:
            lines.append(f"  95 % intervals hold the truth: {100 * cover['share']:.0f} % of {cover['n']}")
        lines.append(f"  seconds a case: median {time['median']:.1f}, max {time['max']:.1f}")
    return lines


def _line(score: dict[str, Any]) -> str:
    wanted = "".join(
        f", {word} {100 * score[key]:.0f} % wanted"
        for key, word in (("least", "at least"), ("most", "at most"))
        if score[key] is not None
    )
    verdict = {True: " met", False: " MISSED", None: ""}[score["met"]]
    return (
        f"{score['meaning']}: {100 * score['share']:.1f} % "
        f"[{100 * score['low']:.1f}, {100 * score['high']:.1f}] of {score['n']}{wanted}{verdict}"
    )
