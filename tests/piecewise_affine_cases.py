"""The maps of Pepona's examples 5.1, 5.2 and 5.3 on points that their own systems visit."""

import numpy as np

BURN_IN = 100


def two_modes(z, theta, h):
    """Return w and the mode of each point: the first one where h^T [z, 1] <= 0, eq. (5.26b)."""
    phi = np.column_stack([z, np.ones(len(z))])
    modes = (phi @ h > 0).astype(int)
    return np.einsum("kj,kj->k", phi, np.asarray(theta)[modes]), modes


def example_1(rng, n=100, noise=0.2):
    """Eq. (5.25b): slopes 1 and -0.5 that meet at zero."""
    u = rng.uniform(-2, 2, n)
    return u, np.where(u >= 0, u, -0.5 * u) + rng.uniform(-noise, noise, n), (u >= 0).astype(int)


THETA_2, H_2 = np.array([[0.5, 1.0, -0.25], [-0.7, 1.5, 0.0]]), np.array([1.5, -0.5, 1.0])
THETA_3, H_3 = np.array([[0.2, -0.8, -2.2], [-0.5, 0.2, 0.0]]), np.array([1.0, 0.0, 1.0])


def example_2(rng, n=1000, noise=0.25):
    """Eq. (5.26): z = (y(k-2), u(k-2))."""
    total = n + BURN_IN
    u, e = rng.uniform(-1, 1, total), rng.uniform(-0.25, 0.25, total)
    y, w = np.zeros(total), np.zeros(total)
    for k in range(2, total):
        phi = np.array([y[k - 2], u[k - 2], 1.0])
        w[k] = THETA_2[int(H_2 @ phi > 0)] @ phi
        y[k] = 0.4 * y[k - 1] + 1.2 * u[k - 1] + w[k] - 0.5 * w[k - 1] + e[k]
    z = np.column_stack([y[:-2], u[:-2]])[-n:]
    w, modes = two_modes(z, THETA_2, H_2)
    return z, w + rng.uniform(-noise, noise, n), modes


def example_3(rng, n=1000, noise=0.2):
    """Eq. (5.29): z = (y(k-1), u(k-1))."""
    total = n + BURN_IN
    u, e = rng.uniform(-1, 1, total), rng.uniform(-0.2, 0.2, total)
    y, w, g = np.zeros(total), np.zeros(total), (-0.9) ** np.arange(5)
    for k in range(5, total):
        phi = np.array([y[k - 1], u[k - 1], 1.0])
        w[k] = THETA_3[int(H_3 @ phi > 0)] @ phi
        y[k] = g @ w[k : k - 5 : -1] + e[k]
    z = np.column_stack([y[:-1], u[:-1]])[-n:]
    w, modes = two_modes(z, THETA_3, H_3)
    return z, w + rng.uniform(-noise, noise, n), modes


EXAMPLES = {"5.1": example_1, "5.2": example_2, "5.3": example_3}
