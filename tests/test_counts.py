"""The step of a quantiser from the values it puts out."""

import numpy as np

from sysid.diagnosis.effects.counts import _gathered


def test_cosines_in_blocks_are_those_of_the_definition():
    """Sums of angles instead of angles: some rounding of products up to 1, nothing else."""
    rng = np.random.default_rng(0)
    y = rng.standard_normal(300)
    for count in (1, 2, 10, 997, 4000):
        k = np.arange(count)
        direct = np.cos(0.7 * y + np.outer(k, 0.02 * y)).mean(axis=1)
        np.testing.assert_allclose(_gathered(0.7 * y, 0.02 * y, count, False), direct, rtol=0, atol=1e-12)
