"""A diagnosis in words."""

from typing import TYPE_CHECKING

import numpy as np

from sysid.diagnosis.wording import percent, quantity, significant

if TYPE_CHECKING:
    from sysid.diagnosis.diagnose import Diagnosis, Rung


def sentences(diagnosis: "Diagnosis") -> list[str]:
    """Return what was found, the main thing first."""
    record, ladder = diagnosis.record, diagnosis.ladder
    unit = record.unit(record.outputs[0])
    judged = diagnosis.judged
    found = [_headline(diagnosis)]
    found += [f"{choice.effect.name}: {choice.effect.mechanism}" for choice in diagnosis.final.fitted.choices]
    for rung in ladder:
        found.append(_rung(rung, judged, unit))
    if np.isfinite(diagnosis.noise_floor):
        found.append(f"Noise floor: {quantity(diagnosis.noise_floor, unit)} RMSE; no model gets below it.")
    for rung in ladder[1:]:
        for p in rung.model.fitted.parameters_of(rung.effect) if rung is ladder[-1] else ():
            spread = f" ± {significant(1.96 * p.std_error, 2)}" if np.isfinite(p.std_error) else ""
            found.append(f"{rung.effect}: {p.name} = {significant(p.value)}{spread} {p.unit}".rstrip())
    found += [port.sentence for port in diagnosis.ports[:1]]
    if diagnosis.advice:
        found.append(diagnosis.advice)
    return found


def _headline(diagnosis: "Diagnosis") -> str:
    names = " and ".join(diagnosis.accepted)
    best = next((t for t in diagnosis.decision.trials if t.fit is not None), None)
    return {
        "missing-effect": f"Missing in the model: {names or (best.name if best else '')}.",
        "nothing-missing": "Nothing is missing in the model.",
        "coloured-noise": "Nothing is missing in the model but a memory of the noise.",
        "unexplained": "Something is missing in the model that no candidate explains.",
        "not-identifiable": "The model's parameters cannot be told from this record.",
    }[diagnosis.verdict]


def _rung(rung: "Rung", judged: str, unit: str) -> str:
    entry = rung.scores[judged]
    what = f"With {rung.effect}" if rung.effect else "Baseline"
    if entry["rmse"] is None:
        return f"{what}: the free run on {judged} diverges"
    share = f", {percent(entry['nrmse'])} of the signal" if entry["nrmse"] is not None else ""
    removed = f"; {percent(rung.removed)} of the explainable error removed" if rung.step else ""
    return f"{what}: free-run error {quantity(entry['rmse'], unit)} RMSE on {judged}{share}{removed}"
