"""Event-driven reference simulation of a body with dry friction, by scipy's integrator."""

import numpy as np
from scipy.integrate import solve_ivp

TOLERANCES = {"rtol": 1e-11, "atol": 1e-13}


def stick_slip(A, B, velocity, push, sliding, u, period, force=lambda x: 0.0):
    """Simulate x' = A x + B u + e_velocity push (force(x) - friction), input held, from rest.

    ``sliding(v)`` is the friction while sliding at a speed v > 0; at rest any force up to sliding(0).
    Between samples the motion is integrated mode by mode, each mode ended by an event.
    """
    n = len(B)
    x, states = np.zeros(n), []
    for value in u:
        states.append(x.copy())
        t = 0.0
        while t < period * (1 - 1e-12):
            side = _side(A, B, velocity, push, sliding, value, x, force)
            x, t = _mode(A, B, velocity, push, sliding, value, x, t, period, side, force)
    return np.array(states)


def _free(A, B, velocity, push, value, x, force):
    rate = A @ x + B * value
    rate[velocity] += push * force(x)
    return rate


def _side(A, B, velocity, push, sliding, value, x, force):
    if x[velocity] != 0.0:
        return np.sign(x[velocity])
    pull = _free(A, B, velocity, push, value, x, force)[velocity] / push
    return np.sign(pull) if abs(pull) > sliding(0.0) * (1 + 1e-12) else 0.0


def _mode(A, B, velocity, push, sliding, value, x, t, end, side, force):
    def rate(_, z):
        d = _free(A, B, velocity, push, value, z, force)
        d[velocity] = d[velocity] - push * side * sliding(abs(z[velocity])) if side else 0.0
        return d

    def turns(time, z):
        return side * z[velocity] if time > t + 1e-9 * end else 1.0

    def slips(_, z):
        return sliding(0.0) - abs(_free(A, B, velocity, push, value, z, force)[velocity] / push)

    event = turns if side else slips
    event.terminal, event.direction = True, -1
    run = solve_ivp(rate, (t, end), x, events=event, method="DOP853", **TOLERANCES)
    x = run.y[:, -1].copy()
    if run.status == 1:
        if side:
            x[velocity] = 0.0
        else:  # nudged over the edge, where it slips
            pull = _free(A, B, velocity, push, value, x, force)[velocity]
            x[velocity] = 1e-12 * np.sign(pull)
    return x, run.t[-1]
