"""What all papers share: where their printed values and narratives are, and the run of their studies."""

from abc import abstractmethod
from collections.abc import Mapping
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from sysid.montecarlo import Study, Task
from sysid.replication import Session


def claims_of(paper: str) -> Traversable:
    """Return the file of the printed values of a paper."""
    return resources.files("replications") / "claims" / f"{paper}.toml"


class ReplicatedPaper:
    """A paper whose claims file, notebook and studies go by its name."""

    id: str

    @property
    def claims_file(self) -> Traversable:
        """The printed values."""
        return claims_of(self.id)

    @property
    def notebook(self) -> Path:
        """The narrative of the report."""
        return Path(str(resources.files("reports") / f"{self.id}.py"))

    @abstractmethod
    def plan(self, runs: int) -> Mapping[str, tuple[Task, int]]:
        """Return every case with its task and number of runs."""

    def studies(self, session: Session) -> dict[str, Study]:
        """Run the study of every case, and note how long they took together."""
        with session.timed("studies"):
            return {case: session.study(case, task, n) for case, (task, n) in self.plan(session.runs).items()}
