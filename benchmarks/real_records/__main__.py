"""Study of the positioning system: ``SYSID_DATA=DIR python -m benchmarks.real_records``."""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.real_records.estimators import (
    COULOMB,
    STRIBECK,
    STRUCTURES,
    TWO_SIDED,
    Structure,
    by_forces,
    by_free_run,
    by_pieces,
    by_weighed_free_run,
    random_starts,
)
from benchmarks.real_records.evidence import (
    plateaus,
    refitted,
    repeated,
    scores_of_draws,
    scores_of_restarts,
)
from benchmarks.real_records.stage import Experiment, Stage, free_run_error, rms, score
from benchmarks.real_records.stops import RECURSIONS, stops
from sysid.data import read_record

DEMANDED = 4.1  # mm
STARTS = 4
DRAWS = 400
RESTARTS = 40
PIECES = (0.25, 1.0, 3.1, 6.2)
LOST = 20.0  # mm: a quick search that ends above this has found nothing
CYCLE = 6.25  # s: period of the reference motion
WIDTHS = {"mass": 10.0, "viscous_forward": 40.0, "viscous_backward": 40.0, "dry": 4.0, "constant": 0.6}


def main() -> int:
    """Print all tables."""
    folder = os.environ.get("SYSID_DATA")
    if not folder:
        print("set SYSID_DATA to the folder of the measured records", file=sys.stderr)
        return 2
    first, second = read(Path(folder))
    print_plateaus(first, second)
    print_attempts(first, second)
    print_repeated(first, second)
    print_constant_force(first, second)
    print_restarts(first, second)
    print_stops(first, second)
    return 0


def read(folder: Path) -> tuple[Experiment, Experiment]:
    """Return the two experiments of the positioning system."""
    record = read_record(folder / "emps" / "emps.csv.gz", split="split", experiment="experiment")
    first, second = (
        Experiment(35.15 * record.u[part, 0], np.ascontiguousarray(record.y[part, 0]), record.period)
        for part in record.slices
    )
    return first, second


def print_plateaus(first: Experiment, second: Experiment) -> None:
    """Print what the drive needs at constant speed."""
    print("speed [m/s]   force, first [N]   second    change   spread over cycles")
    for p in plateaus(first, second, 95.0, CYCLE):
        print(f"{p.speed:9.3f} {p.first:15.2f} {p.second:12.2f} {p.second - p.first:9.2f} {p.spread:12.2f}")


def print_attempts(first: Experiment, second: Experiment) -> None:
    """Print every way of fitting, chosen or not, with held-out and test error."""
    part = 3 * first.position.size // 4
    early = Experiment(first.force[:part], first.position[:part], first.period)
    print("\nstructure / minimised                                 first   held out   test [mm]")
    held_out = []
    for structure in STRUCTURES:
        for name, fit in attempts(structure):
            error = rms(free_run_error(fit(early), first)[part:])
            stage = fit(first)
            tested = score(stage, second)
            held_out.append((error, tested, f"{structure.name} / {name}"))
            print(f"{held_out[-1][2]:52s} {score(stage, first):6.2f} {error:9.2f} {tested:9.2f}", flush=True)
    error, tested, name = min(held_out)
    print(f"least held-out error: {name}, test {tested:.2f} mm")


def attempts(structure: Structure) -> Iterator[tuple[str, Callable[[Experiment], Stage]]]:
    """Yield each way of fitting."""
    points = random_starts(structure, STARTS)
    yield "free run, start searched", lambda e: by_free_run(structure, e, "free", points)[0][1]
    yield "free run, start read off", lambda e: by_free_run(structure, e, "read", points)[0][1]
    yield "free run, from rest", lambda e: by_free_run(structure, e, "rest", points)[0][1]
    for length in PIECES:
        yield f"pieces of {length} s", lambda e, t=length: by_pieces(structure, e, t, points[:2])
    if structure is not STRIBECK:  # its rise is not linear in the force
        yield "free run, weighed by colour", lambda e: by_weighed_free_run(structure, e, points)
        yield "forces", lambda e: by_forces(structure, e).stage
        yield "forces, weighed by colour", lambda e: by_forces(structure, e, weighed=True).stage


def print_repeated(first: Experiment, second: Experiment) -> None:
    """Print the test error of models that repeat the first experiment exactly."""
    print("\nmade to repeat the first experiment          first    test [mm]")
    for name, stage in representatives(first).items():
        errors = repeated(stage, first, second)
        print(f"{name:42s} {errors[0]:8.3f} {errors[1]:9.2f}", flush=True)


def representatives(first: Experiment) -> dict[str, Stage]:
    """Return stages as forces and free runs tell them."""
    starts = {structure.name: random_starts(structure, STARTS) for structure in STRUCTURES}
    return {
        "dry friction, by forces": by_forces(COULOMB, first).stage,
        "dry friction, by free run": by_free_run(COULOMB, first, "read", starts[COULOMB.name])[0][1],
        "viscous by direction, by forces": by_forces(TWO_SIDED, first).stage,
        "viscous by direction, by free run": by_free_run(TWO_SIDED, first, "read", starts[TWO_SIDED.name])[0][
            1
        ],
        "larger near rest, by free run": by_free_run(STRIBECK, first, "read", starts[STRIBECK.name])[0][1],
    }


def print_constant_force(first: Experiment, second: Experiment) -> None:
    """Print how the test error depends on the numbers, and how well these are known."""
    for structure in (COULOMB, TWO_SIDED):
        fit, other = by_forces(structure, first), by_forces(structure, second)
        print(f"\n{structure.name}, by forces: first, 95 %, second experiment")
        errors = 1.96 * np.sqrt(np.diag(fit.covariance))
        for size, error, then in zip(fit.numbers, errors, other.numbers, strict=True):
            print(f"  {size:9.3f} +- {error:.3f} {then:12.3f}")
        for shift in (-0.1, -0.03, -0.01, 0.0, 0.01, 0.03, 0.1):
            moved = fit.stage._replace(constant=fit.stage.constant + shift)
            print(f"  constant force moved by {shift:5.2f} N: test {score(moved, second):6.2f} mm")
        scores = scores_of_draws(fit, second, DRAWS)
        low, middle, high = np.quantile(scores, [0.025, 0.5, 0.975])
        share = float(np.mean(scores <= DEMANDED))
        print(
            f"  drawn within these errors: {low:.1f}, {middle:.1f}, {high:.1f} mm; "
            f"{share:.1%} below {DEMANDED}"
        )
        best = by_free_run(structure, first, "read", random_starts(structure, STARTS))[0][1]
        for name, width in WIDTHS.items():
            value, error = refitted(best, second, name, width)
            print(f"  free run, {name} {getattr(best, name):.3f} -> {value:.3f} for the test: {error:.2f} mm")


def print_restarts(first: Experiment, second: Experiment) -> None:
    """Print the test errors of searches that end within a tenth of the least error."""
    print("\nsearches within a tenth of the least error       count   first [mm]     test [mm]")
    for structure in (COULOMB, TWO_SIDED):
        for start in ("free", "read", "rest"):
            errors, scores = scores_of_restarts(structure, first, second, start, RESTARTS)
            print(
                f"{structure.name + ', start ' + start:48s} {scores.size:5d} {errors.min():8.2f} "
                f"{errors.max():.2f} {scores.min():8.2f} {np.median(scores):.2f} {scores.max():.2f}",
                flush=True,
            )


def print_stops(first: Experiment, second: Experiment) -> None:
    """Print where quick searches stop: the lowest of each kind, and the one that foretells the test best."""
    print(
        "\nquick searches from rest, fitted -> test [mm]     least fitted       least test   range of tests"
    )
    for name, recursion in RECURSIONS.items():
        found = [stop for stop in stops(recursion, first, second) if stop.fitted < LOST]
        lowest = min(found, key=lambda stop: stop.fitted)
        luckiest = min(found, key=lambda stop: stop.tested)
        tests = [stop.tested for stop in found]
        print(
            f"{name:45s} {lowest.fitted:8.2f} -> {lowest.tested:5.2f} {luckiest.fitted:8.2f} -> "
            f"{luckiest.tested:5.2f} {min(tests):8.1f} to {max(tests):.1f}",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
