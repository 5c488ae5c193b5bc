"""Tasks of the tests, in a module of their own so that workers in other processes can import them."""

import os
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Noise:
    """Mean, spread and a least-squares slope of a few normal numbers."""

    size: int = 40
    scale: float = 1.0
    seconds: float = 0.0

    def __call__(self, rng):
        time.sleep(self.seconds)
        x = self.scale * rng.normal(size=self.size)
        regressors = rng.normal(size=(self.size, 3))
        slope = np.linalg.lstsq(regressors, x, rcond=None)[0]
        return {"mean": x.mean(), "std": x.std(ddof=1), "slope": slope[0]}


@dataclass(frozen=True)
class Troubled:
    """Fails, is infinite, or leaves a value undefined in some of the runs."""

    def __call__(self, rng):
        kind = int(rng.integers(4))
        value = float(rng.normal())
        if kind == 0:
            raise ValueError(f"no root\nnear {value:.3f}")
        if kind == 1:
            return {"a": value, "b": np.inf}
        print("printed by the task")
        print("and to the other stream", file=sys.stderr)
        return {"a": value, "b": np.nan if kind == 2 else -value}


class AlwaysFails:
    def __call__(self, rng):
        raise RuntimeError("never works")


@dataclass(frozen=True)
class Logged:
    """Notes each computed run, by its first random number, in a file."""

    log: Path
    seconds: float

    def __call__(self, rng):
        time.sleep(self.seconds)
        value = float(rng.random())
        with self.log.open("a") as file:
            file.write(f"{value!r}\n")
        return {"value": value}


class Changing:
    """Returns another column in one run of ten."""

    def __call__(self, rng):
        return {"a": 1.0} if rng.random() > 0.1 else {"b": 1.0}


class Named:
    def __call__(self, rng):
        return {"run": 1.0}


@dataclass(frozen=True)
class Dies:
    """Kills the worker it runs in, but never the process named."""

    parent: int

    def __call__(self, rng):
        if os.getpid() != self.parent:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"a": 1.0}


class BlasThreads:
    """Counts the threads that BLAS may use."""

    def __call__(self, rng):
        from threadpoolctl import threadpool_info

        threads = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
        return {"libraries": len(threads), "threads": max(threads)}


@dataclass(frozen=True)
class Compiled:
    """Runs a numba kernel; tells in which process, and how often that loaded it from the cache."""

    parent: int
    seconds: float = field(default=0.01)

    def __call__(self, rng):
        from montecarlo_kernel import total

        value = total(rng.normal(size=10))
        time.sleep(self.seconds)
        hits = sum(total.stats.cache_hits.values())
        return {"value": value, "in_parent": os.getpid() == self.parent, "cache_hits": hits}
