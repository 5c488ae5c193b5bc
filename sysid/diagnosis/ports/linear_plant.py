"""A linear output-error model as the plant around a port."""

from collections.abc import Sequence

import numpy as np

from sysid.data import Record
from sysid.data.units import per_second
from sysid.diagnosis.ports.kernels import BEHIND, KNOWN, OUTPUT, RATE
from sysid.diagnosis.ports.plants import Matrices, Port
from sysid.linear.forms import Floats, section_coefficients
from sysid.linear.output_error import OutputErrorFit
from sysid.linear.reduction import shifted

# A pole this near to 1 is an integrator: a constant in the equation then makes no constant output.
INTEGRATOR = 1e-9


class LinearPlant:
    """A linear output-error model in the sections it was fitted in, transposed.

    The Kautz form has one state for each column and its weights behind it; transposed, the weights
    stand in front, so that any number of inputs shares the states of one A.
    """

    black_box = True

    def __init__(self, fit: OutputErrorFit):
        structure = fit.structure
        self.fit = fit
        self.order = structure.order
        self.lag = max(structure.delay, 1) - 1
        self.free_start = structure.free_start or structure.constant
        self.period = fit.period
        self.n_inputs = len(fit.inputs)
        a1, a2 = section_coefficients(fit.reflections)
        sections = np.column_stack([a1, a2]).ravel()[: self.order]
        weights = np.array(fit.weights, dtype=np.float64)
        if structure.constant:
            static = float(np.sum(fit.a))
            weights[-1] = weights[-1] / static if abs(static) > INTEGRATOR else 0.0
        self.start = np.concatenate([sections, weights])
        self.origins: tuple[Floats, ...] = (self.start,)

    def ports(self, record: Record, kinds: Sequence[str]) -> tuple[Port, ...]:
        """Return one port for each input, one behind, and two forces."""
        y, y_unit = record.outputs[0], record.unit(record.outputs[0])
        u, u_unit = record.inputs[0], record.unit(record.inputs[0])
        speed = f"rate of {y}", per_second(y_unit)
        found = [
            Port(
                "input",
                i,
                KNOWN,
                1.0,
                0,
                False,
                name,
                record.unit(name),
                f"added to {name}",
                record.unit(name),
            )
            for i, name in enumerate(record.inputs)
        ]
        found += [
            Port("output", 0, BEHIND, 1.0, 0, True, f"{y} of the model", y_unit, f"added to {y}", y_unit),
            Port("position", 0, OUTPUT, -1.0, 0, True, y, y_unit, f"taken from {u}", u_unit),
            Port("velocity", 0, RATE, -1.0, 0, False, *speed, f"taken from {u}", u_unit),
        ]
        return tuple(port for port in found if port.kind in kinds)

    def channels(self, u: Floats) -> Floats:
        """Return the delayed inputs, the direct ones and a constant."""
        structure = self.fit.structure
        ahead = shifted(u, structure)
        # The state at row k holds the delayed input of row k: it is driven by the one of the next row.
        parts = [np.vstack([ahead[1:], ahead[-1:]])]
        if structure.direct:
            parts.append(u)
        if structure.constant:
            parts.append(np.ones((u.shape[0], 1)))
        return np.ascontiguousarray(np.hstack(parts))

    def map_input(self, u: Floats, channel: int) -> Floats:
        """Return the input itself: its delay comes behind the map."""
        return u[:, channel].copy()

    def matrices(self, parameters: Floats, port: Port) -> Matrices | None:
        """Return the transposed Kautz form with derivatives by sections and weights."""
        structure, n, m = self.fit.structure, self.order, self.n_inputs
        P = parameters.size
        A, dA, b, db, out = _kautz(parameters[:n])
        n_channels = m * (1 + structure.direct) + structure.constant
        B, dB = np.zeros((n, n_channels)), np.zeros((P, n, n_channels))
        D, dD = np.zeros(n_channels), np.zeros((P, n_channels))
        for channel in range(m):
            place = n + channel * n
            w = parameters[place : place + n]
            B[:, channel] = w @ out
            dB[place : place + n, :, channel] = out
        rest = n + m * n
        D[m:] = parameters[rest:]
        dD[rest:, m:] = np.eye(P - rest)
        d_A = np.zeros((P, n, n))
        d_A[:n] = dA.transpose(0, 2, 1)
        dC = np.zeros((P, n))
        dC[:n] = db
        G, dG = 0.0, np.zeros(P)
        if port.mode == BEHIND:
            G = 1.0
        elif port.kind == "input" and structure.direct:
            G = float(D[m + port.channel])
            dG = np.ascontiguousarray(dD[:, m + port.channel])
        E, dE = np.ascontiguousarray(B[:, port.channel]), np.ascontiguousarray(dB[:, :, port.channel])
        return Matrices(
            (np.ascontiguousarray(A.T), B, b, D, E, G, np.zeros(n), np.zeros(n_channels)),
            (d_A, dB, dC, dD, dE, dG, np.zeros((P, n)), np.zeros((P, n_channels))),
        )


def _kautz(sections: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return A, b and the columns' rows of the Kautz form after the input is taken in, with derivatives.

    Section j keeps x_j(k) and x_j(k-1), x_j = value_j - a1 x_j(k-1) - a2 x_j(k-2), gives the columns
    x_j(k) + x_j(k-1) and x_j(k) - x_j(k-1), and hands on a2 x_j(k) + a1 x_j(k-1) + x_j(k-2).  Each
    signal is a row of weights on (old states, input), carried along with its derivatives.
    """
    n = sections.size
    value, d_value = np.zeros(n + 1), np.zeros((n, n + 1))
    value[n] = 1.0
    new, d_new = np.zeros((n, n + 1)), np.zeros((n, n, n + 1))
    out = np.zeros((n, n))
    for first in range(0, n, 2):
        unit = np.eye(n + 1)
        if first + 1 == n:
            new[first], d_new[:, first] = value - sections[first] * unit[first], d_value
            d_new[first, first] = d_value[first] - unit[first]
            out[first, first] = 1.0
            break
        a1, a2 = sections[first : first + 2]
        last, older = unit[first], unit[first + 1]
        x = value - a1 * last - a2 * older
        dx = d_value.copy()
        dx[first] -= last
        dx[first + 1] -= older
        new[first], d_new[:, first] = x, dx
        new[first + 1] = last
        value = a2 * x + a1 * last + older
        d_value = a2 * dx
        d_value[first] += last
        d_value[first + 1] += x
        out[first, first : first + 2] = 1.0, 1.0
        out[first + 1, first : first + 2] = 1.0, -1.0
    return new[:, :n], d_new[:, :, :n], new[:, n].copy(), d_new[:, :, n], out
