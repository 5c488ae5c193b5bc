"""Monte-Carlo studies: seeded runs on many workers, checkpoints, statistics."""

from sysid.montecarlo.runner import Failure, Runner, Study, Task

__all__ = ["Failure", "Runner", "Study", "Task"]
