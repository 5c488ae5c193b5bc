"""Whether a search may go on to a further stage: those that rarely find more come last."""

from dataclasses import dataclass, field

from sysid.diagnosis.structures.structure import Structure
from sysid.diagnosis.structures.work import Work, Working

# Where one effect hides another, few fits beside what leaves least find both, and on a law that takes the
# place of one of the model's all others build: these may begin up to so many times the work after which no
# other stage does.  A third effect is searched in the longest round of all, so that it must begin earlier.
# To look again at the first of a pair is worth most: it was chosen without the second.  So is a second one
# beside a first that does not hold alone, or another look at what was found beside a poor fit of it.
PROMISING, THIRD, REVISED = 1.7, 0.7, 2.5


class GivenUpError(Exception):
    """A search that counts only if it comes to its end would have to stop before."""


@dataclass
class Allowance:
    """How far a search may go.

    The first effects and a second one beside what was accepted are always searched.  What follows is
    long where a model lacks what no candidate is, for then all of it is tried in vain.  A search that counts
    only as a whole is given up where it may not go on, with `GivenUpError`, a second effect included.

    Attributes
    ----------
    work : Work, optional
        Of the structure; without it a search goes on to its end.
    ended : bool
        Whether something was left out.
    """

    work: Work | None = None
    ended: bool = field(default=False, init=False)
    _begun: int = field(default=0, init=False)

    @property
    def spares(self) -> bool:
        """Whether the search counts only as a whole, and is to be over soon."""
        return self.work is not None and self.work.whole

    def permits(self, share: float = 1.0) -> bool:
        """Tell whether a stage that is worth so much more than others may begin; remember if it may not."""
        if self.work is None:
            return True
        share = min(share, 1.0) if self.spares else share
        if self.work.done - self._begun < share * self.work.given:
            return True
        if self.spares:
            raise GivenUpError
        self.ended = True
        return False

    def permits_beside(self, count: int) -> bool:
        """Tell whether another effect may be searched beside so many."""
        if count > 1:
            return self.permits(THIRD)
        return not self.spares or self.permits()

    def renew(self) -> None:
        """Begin to count anew: the search starts again on other premises, that are closer to the record."""
        self._begun = 0 if self.work is None else self.work.done
        self.ended = False


def allowance_of(structure: Structure, thorough: bool) -> Allowance:
    """Return how far a search with a structure may go: to its end if it shall be thorough."""
    return Allowance(structure.work if isinstance(structure, Working) and not thorough else None)
