"""The order in which a diagnosis lists its candidates: every one that was asked about, best first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.diagnosis.decide.decision import Decision, Trial
from sysid.diagnosis.decide.noise_colour import WHITE_NOISE


def with_every_candidate(decision: Decision, names: Sequence[str], memory: Trial | None) -> Decision:
    """Return a decision whose trials name every candidate.

    The memory of the noise is a candidate like any other.  Its gain is not comparable with that of an
    effect, because what an effect explains looks like memory without it: it comes first if it alone was
    accepted, otherwise behind all that explain anything.  Candidates that were not fitted come last, and
    those that make no sense for the model behind them, without numbers.

    Parameters
    ----------
    decision : Decision
    names : sequence of str
        All candidates.
    memory : Trial, optional
        Of the noise, if it is a candidate.

    Returns
    -------
    Decision
    """
    fitted = [trial for trial in decision.trials if trial.fit is not None]
    others = sorted((trial for trial in decision.trials if trial.fit is None), key=lambda t: t.p_value)
    if memory is not None:
        place = sum(trial.gain > 0.0 for trial in fitted)
        alone = decision.accepted == (memory.name,)
        fitted.insert(0 if alone else place, memory)
    listed = {trial.name for trial in (*fitted, *others)} | set(decision.given)
    unfit = [Trial(name, None, WHITE_NOISE, np.inf, -np.inf, np.nan) for name in names if name not in listed]
    return replace(decision, trials=(*fitted, *others, *unfit))
