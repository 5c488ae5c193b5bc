"""The free run of a linear model over a whole record, whatever rows it was fitted on."""

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask
from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import minimise
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.structures.structure import WHITE
from sysid.linear.simulation import first_rows


def free_run(record: Record, chain: Chain, data: Data, rows: Mask, point: Floats) -> Floats:
    """Run every row of the record; starts of experiments without rows of the fit are estimated."""
    used, starts, other = np.zeros(record.n_samples, dtype=bool), [], []
    shared, number = 2 * chain.order + int(chain.constant), 0
    for e, part in enumerate(record.slices):
        if rows[part].any():
            starts.append(point[shared + number * chain.order : shared + (number + 1) * chain.order])
            number += 1
            continue
        y = record.y[part, 0]
        skip = record.skip.get(str(record.split[part][0]), 0)
        used[part] = first_rows(y, skip, chain.order)[0]
        starts.append(np.zeros(chain.order))
        other += list(range(shared + e * chain.order, shared + (e + 1) * chain.order))
    begin = np.array([*record.starts, record.n_samples])
    y = np.where(used, record.y[:, 0], 0.0)
    whole = Data(record.u[:, 0].copy(), y, used, begin, record.period)
    own = np.concatenate(starts) if chain.free_start else np.empty(0)
    full = np.concatenate([point[:shared], own, point[chain.n_linear(data) :]])
    if chain.free_start and other and used.any():
        free = np.zeros(full.size, dtype=bool)
        free[other] = True
        end = minimise(chain, whole, full, WHITE, free=free, iterations=4)
        full = full if end is None else end.point
    run = chain.run(whole, full)
    return np.full(record.n_samples, np.inf) if run is None else run.y
