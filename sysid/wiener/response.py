"""How far an identified linear system is from the true one, as its frequency response shows it."""

from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import UsageError
from sysid.nonlinearities.base import Floats

Complexes = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]

WINDOW = (0.01, 2.0)
"""Frequencies [rad a sample] that are scored."""
POINTS = 400


@dataclass(frozen=True)
class Score:
    """Distance of two frequency responses.

    Attributes
    ----------
    rms_db, max_db : float
        Of the magnitude in the window [dB].
    rms_deg, max_deg : float
        Of the phase in the window [degrees].
    relative_h2 : float
        ||G_hat - G|| / ||G|| on the whole unit circle: the H2 norm where G_hat is stable.
    peak_db : float
        Height of the estimated peak in the window [dB].
    peak_frequency : float
        Its frequency [rad a sample].
    stable : bool
        Whether all poles lie inside the unit circle.
    """

    rms_db: float
    max_db: float
    rms_deg: float
    max_deg: float
    relative_h2: float
    peak_db: float
    peak_frequency: float
    stable: bool

    def to_json(self) -> dict[str, float]:
        """Return the figures as numbers."""
        return {name: float(value) for name, value in asdict(self).items()}


def frequencies(window: tuple[float, float] = WINDOW, points: int = POINTS) -> Floats:
    """Return evenly spaced frequencies [rad a sample]."""
    return np.linspace(*window, points)


def frequency_response(theta: ArrayLike, order: int, omega: ArrayLike) -> Complexes:
    """Return G(exp(i omega)) by python-control.

    Examples
    --------
    >>> frequency_response([-0.5, 0.0, 1.0], 1, [np.pi / 2]).round(4)
    array([-0.4-0.8j])
    """
    import control

    values = np.asarray(theta, dtype=np.float64)
    b, a = values[order:], np.concatenate([[1.0], values[:order]])
    system = control.TransferFunction(b, a, 1.0)
    return np.asarray(system(np.exp(1j * np.asarray(omega, dtype=np.float64))))


def score(
    theta: ArrayLike,
    true: ArrayLike,
    order: int,
    *,
    match_gain: bool = False,
    window: tuple[float, float] = WINDOW,
) -> Score:
    """Compare an identified system with the true one.

    Parameters
    ----------
    theta, true : array_like, shape (2 order + 1,)
        [a1 ... an b0 ... bn].
    order : int
    match_gain : bool
        Scale the estimate by a positive factor so that the mean magnitude in dB agrees: for data that do not
        determine the gain.
    window : (float, float)
        Frequencies that are scored.

    Raises
    ------
    UsageError
        If a parameter is not finite.

    Examples
    --------
    >>> score([-0.5, 0.0, 2.0], [-0.5, 0.0, 1.0], 1).rms_db.__round__(4)
    6.0206
    """
    estimate = np.array(theta, dtype=np.float64)
    if not np.all(np.isfinite(estimate)):
        raise UsageError(f"the parameters {estimate.tolist()} are not finite: score a finished estimate")
    omega = frequencies(window)
    reference = _reference(np.asarray(true, dtype=np.float64).tobytes(), order, window)
    found = frequency_response(estimate, order, omega)
    with np.errstate(divide="ignore"):
        level = 20 * np.log10(np.maximum(np.abs(found), 1e-300) / np.abs(reference))
    if match_gain:
        factor = 10 ** (-float(np.mean(level)) / 20)
        estimate[order:] *= factor
        found, level = found * factor, level - np.mean(level)
    phase = np.degrees(np.angle(found * np.conj(reference)))
    magnitude = 20 * np.log10(np.maximum(np.abs(found), 1e-300))
    top = int(np.argmax(magnitude))
    return Score(
        rms_db=float(np.sqrt(np.mean(level**2))),
        max_db=float(np.max(np.abs(level))),
        rms_deg=float(np.sqrt(np.mean(phase**2))),
        max_deg=float(np.max(np.abs(phase))),
        relative_h2=relative_h2(estimate, true, order),
        peak_db=float(magnitude[top]),
        peak_frequency=float(omega[top]),
        stable=bool(np.all(np.abs(np.roots(np.concatenate([[1.0], estimate[:order]]))) < 1)),
    )


@lru_cache(maxsize=8)
def _reference(true: bytes, order: int, window: tuple[float, float]) -> Complexes:
    """Return the response of the true system, which studies ask for again and again."""
    response = frequency_response(np.frombuffer(true), order, frequencies(window))
    response.setflags(write=False)
    return response


def relative_h2(theta: ArrayLike, true: ArrayLike, order: int) -> float:
    """Return ||G_hat - G|| / ||G|| on the unit circle.

    Where the estimate is unstable this is the L2 norm of the response all the same, with the poles of the
    difference mirrored into the circle, which changes no magnitude on it.

    Examples
    --------
    >>> relative_h2([-0.5, 0.0, 1.5], [-0.5, 0.0, 1.0], 1).__round__(12)
    0.5
    """
    first, second = (np.asarray(one, dtype=np.float64) for one in (theta, true))
    a1, a2 = (np.concatenate([[1.0], one[:order]]) for one in (first, second))
    b1, b2 = first[order:], second[order:]
    if np.array_equal(a1, a2):
        return circle_norm(b1 - b2, a1) / circle_norm(b2, a2)
    difference = np.convolve(b1, a2) - np.convolve(b2, a1)
    return circle_norm(difference, np.convolve(a1, a2)) / circle_norm(b2, a2)


def circle_norm(b: Floats, a: Floats) -> float:
    """Return the root mean square of B/A on the unit circle: the H2 norm of a stable system."""
    import control

    poles = np.roots(a)
    outside = np.abs(poles) > 1
    mirrored = np.where(outside, 1 / np.conj(np.where(outside, poles, 1.0)), poles)
    gain = float(np.prod(np.abs(np.where(outside, poles, 1.0))))
    length = max(b.size, a.size)
    numerator, denominator = np.zeros(length), np.zeros(length)
    numerator[: b.size] = b / gain
    denominator[: a.size] = np.real(np.poly(mirrored))
    # Controllable canonical form; the norm is that of its impulse response, from the Lyapunov equation.
    n = length - 1
    direct = numerator[0]
    transition = np.zeros((n, n))
    transition[0] = -denominator[1:]
    transition[1:, :-1] = np.eye(n - 1)
    readout = numerator[1:] - direct * denominator[1:]
    entry = np.zeros((n, 1))
    entry[0, 0] = 1.0
    gramian = control.dlyap(transition, entry @ entry.T)
    return float(np.sqrt(max(float(readout @ gramian @ readout), 0.0) + direct**2))
