"""What makes a fit doubtful, in words."""

from typing import Protocol


class Searched(Protocol):
    """A fit that was searched for from several starts."""

    @property
    def restarts_agree(self) -> bool: ...  # noqa: D102
    @property
    def converged(self) -> bool: ...  # noqa: D102
    @property
    def status(self) -> str: ...  # noqa: D102


def doubts(fit: Searched, disagreement: str, subject: str = "") -> tuple[str, ...]:
    """Say that searches from different starts disagreed, and that the best one did not converge.

    Parameters
    ----------
    fit : Searched
    disagreement : str
        What to say of searches that disagree, and what the user can do.
    subject : str, optional
        What was fitted, with its article.
    """
    found = () if fit.restarts_agree else (disagreement,)
    if fit.converged:
        return found
    return (*found, f"The fit{f' of {subject}' if subject else ''} did not converge: {fit.status}.")
