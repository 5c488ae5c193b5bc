"""Branch and bound held against brute force, and the statements of Section 5 about special cases."""

import itertools
import time
from statistics import median

import numpy as np

from replications.lacy import setting
from replications.lacy.examples import ExampleRun
from sysid.errors import IdentifiabilityError
from sysid.linear import simulate_polynomial
from sysid.nonlinearities import SATURATION, KnownMap, MonotonePieces, PiecewiseAffine, sine
from sysid.wiener import Criterion, identify_wiener, naive_fit

SMALL_SAMPLES = 10
CASES = 12
"""Small cases of each nonlinearity for which every sequence is evaluated."""
TIMED = 7
LONG = 200_000


def square() -> KnownMap:
    """Return z = y^2."""
    return MonotonePieces("square", np.square, np.array([-np.inf, 0.0, np.inf]))


def brute_force(u: np.ndarray, sequences: np.ndarray, order: int) -> np.ndarray:
    """Return J_y^2 of every sequence, (n_sequences,), by a batched QR of the regression beside its target."""
    n_samples = u.size
    rows = np.arange(order, n_samples)
    lagged_y = np.stack([-sequences[:, rows - i] for i in range(1, order + 1)], axis=-1)
    lagged_u = np.stack([u[rows - i] for i in range(order + 1)], axis=-1)
    lagged_u = np.broadcast_to(lagged_u, (len(sequences), *lagged_u.shape))
    target = sequences[:, rows, np.newaxis]
    triangle = np.asarray(np.linalg.qr(np.concatenate([lagged_y, lagged_u, target], axis=-1), mode="r"))
    return np.asarray(triangle[:, -1, -1] ** 2)


def agreement_with_brute_force() -> float:
    """Return the share of small cases in which branch and bound finds the minimum of all sequences.

    Sine over [-pi, pi] and y^2, half of the cases with noise; the same minimum counts, not the same
    sequence, as y^2 cannot tell y from -y.
    """
    agreed = total = 0
    for known, name in ((sine((-np.pi, np.pi)), "sine"), (square(), "square")):
        for number in range(CASES):
            rng = np.random.default_rng([number, len(name)])
            while True:
                u = rng.standard_normal(SMALL_SAMPLES)
                y = simulate_polynomial(setting.B, setting.A, u)
                y = y + (number % 2) * 0.1 * rng.standard_normal(y.size)
                if np.max(np.abs(y)) < np.pi:
                    break
            fit = identify_wiener(u, known(y), known, setting.ORDER)
            parts = [
                fit.preimage.lower[fit.preimage.first[k] : fit.preimage.first[k + 1]] for k in range(u.size)
            ]
            sequences = np.array(list(itertools.product(*parts)))
            smallest = float(np.min(brute_force(u, sequences, setting.ORDER)))
            agreed += bool(abs(fit.cost - smallest) <= 1e-9 * float(fit.y @ fit.y) and fit.exact)
            total += 1
    return agreed / total


def sine_seconds() -> float:
    """Return the median time of branch and bound on noisy 20-sample sine records over [-2 pi, 2 pi] [s]."""
    known = setting.nonlinearity("sine")
    times = []
    for number in range(TIMED + 1):
        data = ExampleRun("sine").experiment(np.random.default_rng([number, 20]))
        begin = time.perf_counter()
        identify_wiener(data.u, data.z, known, setting.ORDER)
        times.append(time.perf_counter() - begin)
    return median(times[1:])  # the first may have compiled


def special_cases() -> dict[str, float]:
    """Return R and q of the special cases of Section 5, and the number of minimisers for y^2."""
    rng = np.random.default_rng(5)
    u = rng.standard_normal(12)
    y = simulate_polynomial(setting.B, setting.A, u) * 2
    arctan = MonotonePieces("arctan", np.arctan, np.array([-np.inf, np.inf])).preimage(np.arctan(y))
    saturation = PiecewiseAffine.of(SATURATION, 0.5)
    saturated = saturation.preimage(saturation(y))
    square_fit = identify_wiener(u, np.square(y), square(), setting.ORDER, keep=2)
    first, second = square_fit.candidates[:2]
    equal = abs(first.cost - second.cost) < 1e-12 and np.allclose(first.y, -second.y)
    recovered = min(float(np.max(np.abs(s * square_fit.theta[2:] - setting.TRUE[2:] * 2))) for s in (1, -1))
    return {
        "special/arctan/regions": round(10**arctan.log10_regions),
        "special/arctan/free": float(np.sum(~arctan.is_point)),
        "special/saturation/regions": round(10**saturated.log10_regions),
        "special/square/free": float(np.sum(~square().preimage(np.square(y)).is_point)),
        "special/square/minimisers": 2.0 if equal else 1.0,
        "special/square/error_up_to_sign": recovered,
        "special/square/sign_is_identifiable": float(square_fit.identifiability.gain_sign),
        "special/sign/constant_regions": float(setting.nonlinearity("sign").slope.size),  # type: ignore[attr-defined]
    }


def section_4_numbers() -> dict[str, float]:
    """Return J_theta at its minimum, and the fewest equations for order two."""
    rng = np.random.default_rng(4)
    u, y = rng.standard_normal(14), rng.standard_normal(14)
    problem = Criterion(u, setting.ORDER)
    theta = problem.parameters(y)
    rows = np.arange(setting.ORDER, 14)
    phi = np.column_stack([-y[rows - 1], -y[rows - 2], u[rows], u[rows - 1], u[rows - 2]])
    least = float(np.sum((y[rows] - phi @ theta) ** 2))
    fewest = 0
    for p in range(1, 10):
        try:
            Criterion(u[: setting.ORDER + p], setting.ORDER)
        except IdentifiabilityError:
            continue
        fewest = p
        break
    return {
        "section-4/j_theta_at_minimum": abs(least - problem.value(y)) / problem.value(y),
        "section-4/fewest_equations": float(fewest),
    }


def scale_numbers() -> dict[str, float]:
    """Return what J_y and the relative criterion say about shrinking y, for a sign record."""
    data = ExampleRun("sign").experiment(np.random.default_rng(0))
    problem = Criterion(data.u, setting.ORDER)
    y = data.y + data.w
    # A large free transient that dies at once: the signs are right, the input does not count.
    transient = 1e-3 * y
    transient[:3] = np.sign(y[:3]) * [1e8, 1e8, 1e2]
    return {
        "scale/j_y_shrunk_over_j_y": problem.value(1e-3 * y) / problem.value(y),
        "scale/relative_shrunk_over_relative": problem.relative(1e-3 * y) / problem.relative(y),
        "scale/relative_at_truth": problem.relative(y),
        "scale/relative_at_transient": problem.relative(transient),
    }


def asymptotic_bias() -> dict[str, float]:
    """Return the bias of least squares on y + w at S/N = 10 in a record so long that chance does not count.

    It has no nonlinearity at all: this is what the equation error keeps in the best of cases.
    """
    data = setting.experiment("sign", LONG, np.random.default_rng(12))
    bias = naive_fit(data.u, data.y + data.w, setting.ORDER) - setting.TRUE
    return {f"asymptotic-bias/{name}": float(b) for name, b in zip(setting.PARAMETERS, bias, strict=True)}


def outside_numbers() -> dict[str, float]:
    """Return how many data leave the range when the noise is added behind the sine instead of before it."""
    known = setting.nonlinearity("sine")
    before, behind = [], []
    for number in range(50):
        rng = np.random.default_rng([number, 3])
        data = ExampleRun("sine").experiment(rng)
        noise = rng.standard_normal(data.z.size)
        noise *= np.linalg.norm(data.z - data.z.mean()) / np.linalg.norm(noise) / setting.SIGNAL_TO_NOISE
        before.append(known.preimage(data.z).moved.size)
        behind.append(known.preimage(np.sin(data.y) + noise).moved.size)
    return {
        "outside-range/noise-before/mean": float(np.mean(before)),
        "outside-range/noise-behind/mean": float(np.mean(behind)),
    }
