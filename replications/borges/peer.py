"""The derivative of 2b by JAX: its jit, scan and forward mode, beside ours."""

import time
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replications.borges import timing
from sysid.local_linear import Experiment, Sizes
from sysid.local_linear import gradients as g
from sysid.local_linear.passes import fly
from sysid.local_linear.structure import course

Floats = NDArray[np.float64]

NAME = "jax_over_ours_2b"
MISSING = "JAX is not installed: `tox -e benchmark` installs it and measures this ratio"


def derivative_by_jax(sizes: Sizes, experiment: Experiment) -> Any:
    """Return the compiled derivative of the simulated output by eta, a function of eta and G."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    n, s, p, q = sizes.n_states, sizes.n_models, sizes.n_outputs, sizes.n_scheduling
    inputs, scheduling = jnp.asarray(experiment.inputs), jnp.asarray(experiment.scheduling)
    cuts = np.cumsum([n * n * s, n * p, s * q])

    def outputs(eta: Any, G: Any) -> Any:
        A, C, widths, centres = jnp.split(eta, cuts)
        local = A.reshape(n, s, n).transpose(1, 0, 2)
        B = G.reshape(n, s, -1).transpose(1, 0, 2)
        off = (scheduling[:, None] - centres.reshape(s, q)) * widths.reshape(s, q)
        weights = jax.nn.softmax(-jnp.sum(off**2, axis=2), axis=1)

        def step(x: Any, now: Any) -> Any:
            weight, u = now
            return weight @ (local @ x + B @ u), C.reshape(p, n) @ x

        return jax.lax.scan(step, jnp.zeros(n), (weights, inputs))[1].ravel()

    return jax.jit(jax.jacfwd(outputs))


def times(seconds: float = 0.5) -> dict[str, float | None]:
    """Return the pinned ratio and the time of JAX's first call; nothing but the ratio, None, without JAX.

    The clock is that of the wall, as JAX has threads of its own.  Ours is timed with the weights, which are
    part of JAX's function too.
    """
    if find_spec("jax") is None:
        return {NAME: None}
    found, eta = timing.problem(1000)
    experiment, G = found.experiments[0], found(eta).gains()
    derivative = derivative_by_jax(found.sizes, experiment)
    begin = time.perf_counter()
    theirs = np.asarray(derivative(eta, G))
    compiling = time.perf_counter() - begin
    one = course(found.sizes, eta, experiment)
    out, flight = np.empty((1000, found.sizes.n_outputs, found.sizes.n_eta)), fly(one, G)
    ours = -g.approach_2b(one, G, out=out)
    difference = float(np.abs(ours - theirs).max() / np.abs(theirs).max())

    def mine() -> Floats:
        return g.approach_2b(course(found.sizes, eta, experiment), G, out=out, into=flight)

    wall = time.perf_counter
    peer = timing.best(lambda: derivative(eta, G).block_until_ready(), seconds, clock=wall)
    return {
        NAME: peer / timing.best(mine, seconds, 50, clock=wall),
        "jax_compiling_seconds": compiling,
        "jax_difference": difference,
    }
