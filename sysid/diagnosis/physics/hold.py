"""Whether an input was held between samples."""

import numpy as np

from sysid.data import Record
from sysid.data.record import Mask

# A held input has power up to the Nyquist frequency: less than this share above this frequency is none.
UPPER_FREQUENCY, UPPER_POWER = 0.8, 1e-4
# The input counts as smooth between samples when that lowers the held-out error to this share at least.
SMOOTHER = 0.7


def band_limited(record: Record, rows: Mask) -> bool:
    """Tell whether the input has no power near the Nyquist frequency, as one that never was held has not."""
    u = record.u[rows, 0]
    spectrum = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size))) ** 2
    upper = spectrum[int(UPPER_FREQUENCY * spectrum.size) :]
    return bool(upper.sum() < UPPER_POWER * spectrum.sum())
