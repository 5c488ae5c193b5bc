"""The Monte-Carlo runner beside a plain serial loop: 1000 tasks of about 1 ms."""

import time
from dataclasses import dataclass

import numpy as np
import pytest

from sysid.montecarlo import Runner

N_RUNS = 1000
ROUNDS = 5


@dataclass(frozen=True)
class Median:
    """Work of about a millisecond that holds the processor."""

    size: int = 18_000

    def __call__(self, rng):
        return {"median": float(np.sort(rng.normal(size=self.size))[self.size // 2])}


def serial_loop(task):
    children = np.random.SeedSequence(1).spawn(N_RUNS)
    return [task(np.random.Generator(np.random.PCG64(child))) for child in children]


def seconds(function, *arguments):
    began = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - began


@pytest.mark.parametrize("jobs", [1, 2])
def test_runner_beside_a_serial_loop(benchmark, jobs):
    """Its time as a share of the loop's: ideal is 1 / jobs."""
    task, runner = Median(), Runner(jobs=jobs)
    runner.run("start the workers", task, N_RUNS, 1)
    shares = [
        seconds(runner.run, "bench", task, N_RUNS, 1) / seconds(serial_loop, task) for _ in range(ROUNDS)
    ]
    benchmark.extra_info["share of the loop, median"] = round(float(np.median(shares)), 3)
    benchmark.extra_info["share of the loop, range"] = [round(min(shares), 3), round(max(shares), 3)]
    benchmark.pedantic(runner.run, args=("bench", task, N_RUNS, 1), rounds=3)
