"""Giri's two-segment map against its definition, its derivative and its special cases."""

import numpy as np
import pytest

from sysid.errors import ModelError
from sysid.nonlinearities import DEAD_ZONE, PRELOAD, SEGMENT, Segments

EXAMPLE = (1.0, 2.0, 1.0, -2.0, 1.0, -2.0)


def test_values_of_the_papers_example():
    v = [-6.0, -3.0, -2.0, 0.0, 1.0, 3.0, 6.0]
    np.testing.assert_array_equal(SEGMENT(v, *EXAMPLE), [-10.0, -4.0, 0.0, 0.0, 0.0, 3.0, 6.0])
    np.testing.assert_array_equal(Segments(*EXAMPLE)(v), SEGMENT(v, *EXAMPLE))


def test_special_cases_are_the_hard_maps():
    v = np.random.default_rng(0).uniform(-4, 4, 200)
    np.testing.assert_allclose(SEGMENT(v, 1, 1, 0.7, -0.7, 0, 0), DEAD_ZONE(v, 0.7), atol=1e-15)
    np.testing.assert_allclose(SEGMENT(v, 1, 1, 0, 0, 0.7, -0.7), PRELOAD(v, 0.7), atol=1e-15)


def test_slope_is_the_derivative():
    v = np.random.default_rng(1).uniform(-4, 4, 50)
    found = SEGMENT.slope(v, *EXAMPLE)
    for i in range(6):
        step = np.zeros(6)
        step[i] = 1e-4  # piecewise linear in each parameter: the difference is exact but for rounding
        high, low = SEGMENT(v, *(np.array(EXAMPLE) + step)), SEGMENT(v, *(np.array(EXAMPLE) - step))
        np.testing.assert_allclose(found[:, i], (high - low) / 2e-4, atol=1e-9)


def test_offsets_prolong_the_segments():
    segments = Segments(0.7, 1.9, 1.2, -0.4, 0.3, 0.2)
    for v, slope, offset in ((3.0, 0.7, segments.offsets[0]), (-3.0, 1.9, segments.offsets[1])):
        assert float(segments(v)) == pytest.approx(slope * v + offset)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ((1.0, 1.0, -0.1, 0.0, 0.0, 0.0), "D1 is -0.1"),
        ((1.0, 1.0, 0.1, 0.2, 0.0, 0.0), "D2 is 0.2"),
        ((np.nan, 1.0, 0.1, 0.0, 0.0, 0.0), "K1 is nan"),
    ],
)
def test_wrong_parameters_are_named(parameters, message):
    with pytest.raises(ModelError, match=message):
        Segments(*parameters)


def test_a_wrong_number_of_parameters_is_named():
    with pytest.raises(ModelError, match="2 parameters were given; it takes 6"):
        SEGMENT([1.0], 1.0, 2.0)
