"""A difference equation with effects as a system of python-control."""

from typing import Any

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.effects.laws import drive_of
from sysid.diagnosis.export.saved_linear import SavedModel
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.structures.pointwise import check_pointwise


def control_system(saved: SavedModel) -> Any:
    """Return a `control.NonlinearIOSystem` in discrete time.

    Its state is the memory of the difference equation and the whole past of the input is not kept, so
    effects with a memory of their own cannot be taken along.
    """
    import control

    chain, point = saved.chain()
    n = chain.order
    check_pointwise(chain.choices)

    def mapped(port: str, value: float) -> float:
        for i in chain.at[port]:
            apply = chain.choices[i].form.apply
            assert apply is not None
            own = point[2 * n + 1 :][_place(chain, i)]
            value = float(apply(np.array([value]), own, saved.period)[0])
        return value

    def drive(z: float, speed: float, u: float) -> float:
        value = mapped("input", u)
        for i in chain.drives:
            law = drive_of(chain.choices[i].effect, chain.choices[i].form)
            value = law(value, z, speed, np.ascontiguousarray(point[2 * n + 1 :][_place(chain, i)]))
        return value

    def output(x: Floats) -> float:
        # The state holds z(k-1), ..., z(k-n), v(k-1), ..., v(k-n).
        return float(point[n : 2 * n] @ x[n:] - point[:n] @ x[:n] + point[2 * n])

    def update(t: float, x: Floats, u: Floats, params: Any) -> Floats:
        z = output(x)
        v = drive(z, z - x[0], float(u[0]))
        return np.concatenate([[z], x[: n - 1], [v], x[n : 2 * n - 1]])

    def measured(t: float, x: Floats, u: Floats, params: Any) -> Floats:
        return np.array([mapped("output", output(x))])

    return control.NonlinearIOSystem(
        update, measured, states=2 * n, inputs=["u"], outputs=["y"], dt=saved.period, name="diagnosed"
    )


def _place(chain: Chain, i: int) -> slice:
    before = sum(len(c.form.parameters) for c in chain.choices[:i])
    return slice(before, before + len(chain.choices[i].form.parameters))
