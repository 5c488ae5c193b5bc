"""Preimages: against the definition, with data outside the range, and what cannot have one."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid.errors import DataError, ModelError, UsageError
from sysid.nonlinearities import (
    DEAD_ZONE,
    EVEN_DEAD_ZONE,
    PRELOAD,
    RELAY,
    SATURATION,
    SIGN,
    MonotonePieces,
    PiecewiseAffine,
    Quantiser,
    sine,
)

SQUARE = MonotonePieces("square", np.square, [-np.inf, 0.0, np.inf])
ARCTAN = MonotonePieces("arctan", np.arctan, [-np.inf, np.inf])
CUBIC = MonotonePieces("cubic", lambda y: y**3 - 3 * y, [-4.0, -1.0, 1.0, 4.0])
MAPS = {
    "sine": sine(),
    "part of a sine": sine((0.3, 4.0)),
    "square": SQUARE,
    "arctan": ARCTAN,
    "cubic": CUBIC,
    "sign": SIGN,
    "quantiser": Quantiser(0.5),
    "adc": Quantiser(0.5, largest=3),
    **{
        one.name: PiecewiseAffine.of(one, 0.8)
        for one in (DEAD_ZONE, SATURATION, PRELOAD, RELAY, EVEN_DEAD_ZONE)
    },
    "bounded dead zone": PiecewiseAffine.of(DEAD_ZONE, 0.8, domain=(-0.5, 3.0)),
}


def parts(preimage, k):
    return list(
        zip(
            preimage.lower[preimage.first[k] : preimage.first[k + 1]],
            preimage.upper[preimage.first[k] : preimage.first[k + 1]],
            strict=True,
        )
    )


@pytest.mark.parametrize("name", MAPS)
def test_the_preimage_of_an_output_holds_its_input_and_only_solutions(name):
    known = MAPS[name]
    rng = np.random.default_rng(1)
    y = rng.uniform(0.35, 2.9, 40) if "part" in name else rng.uniform(-0.45, 2.9, 40)
    if name not in ("part of a sine", "bounded dead zone"):
        y = rng.uniform(-3.8, 3.8, 40)
    z = known(y)
    preimage = known.preimage(z)
    assert preimage.moved.size == 0
    # Bisection and arcsin are good to rounding; near an extremum that is the square root of it.
    np.testing.assert_allclose(preimage.nearest(y), y, atol=2e-6)
    for k in range(y.size):
        found = parts(preimage, k)
        assert all(a[1] < b[0] for a, b in itertools.pairwise(found))
        for low, high in found:
            inside = np.clip(np.linspace(0.01, 0.99, 5) * 2 - 1, low, high) if low < high else np.array([low])
            inside = inside[(inside > low) & (inside < high)] if low < high else inside
            np.testing.assert_allclose(known(inside), z[k], atol=1e-8)


@pytest.mark.parametrize(
    ("known", "count", "kind"),
    [
        (sine(), 4, "finite sets"),
        (SQUARE, 2, "finite sets"),
        (CUBIC, 3, "finite sets"),
        (ARCTAN, 1, "one point"),
        (SIGN, 1, "boxes"),
        (MAPS["even-dead-zone"], 2, "finite sets"),
    ],
)
def test_how_many_parts(known, count, kind):
    preimage = known.preimage(known([0.9, 0.95]))
    assert preimage.counts.tolist() == [count, count]
    assert preimage.kind == kind


def test_a_union_of_points_and_an_interval_is_mixed():
    known = MAPS["even-dead-zone"]
    preimage = known.preimage([0.0, 1.0])
    assert preimage.kind == "mixed"
    assert parts(preimage, 0) == [(-0.8, 0.8)]
    np.testing.assert_allclose(parts(preimage, 1), [(-1.8, -1.8), (1.8, 1.8)])
    assert preimage.is_even


@pytest.mark.parametrize(
    ("known", "z", "expected"),
    [
        (sine(), 1.5, np.pi / 2),
        (sine((0.0, np.pi / 2)), -0.5, 0.0),
        (MAPS["saturation"], 3.0, 0.8),
        (MAPS["preload"], 0.3, 0.0),  # the gap of the preload: 0.8 is the nearest value, at y = 0
        (SIGN, 0.2, 0.0),
        (Quantiser(1.0), 0.4, 0.5),
        (SQUARE, -1.0, 0.0),
    ],
)
def test_a_datum_outside_the_range_is_moved_to_its_nearest_point(known, z, expected):
    preimage = known.preimage([known(1.0), z])
    assert preimage.moved.tolist() == [1]
    assert preimage.nearest(np.array([1.0, expected]))[1] == pytest.approx(expected, abs=1e-9)


def test_the_weight_of_a_point_is_the_inverse_slope():
    assert PiecewiseAffine("steep", [-1, 0, 1], [2.0, 4.0], [0.0, 0.0]).preimage([2.0]).weight == [0.25]
    assert SQUARE.preimage([9.0]).weight == pytest.approx([1 / 6, 1 / 6], rel=1e-6)


@given(st.floats(-50, 50), st.floats(0.01, 3))
def test_a_quantiser_cell_holds_its_input(y, step):
    known = Quantiser(step)
    preimage = known.preimage(known([y]))
    assert preimage.lower[0] - 1e-9 * step <= y <= preimage.upper[0] + 1e-9 * step


def test_scale_and_sign_are_seen():
    assert SIGN.preimage([1.0, -1.0]).has_no_scale
    assert not Quantiser(1.0).preimage([1.0, 0.0]).has_no_scale
    assert SQUARE.preimage([1.0, 4.0]).is_even
    assert not sine().preimage([0.5]).is_even


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sine((-np.inf, 1.0)), "infinitely many"),
        (lambda: PiecewiseAffine("x", [0, 1], [1.0, 2.0], [0.0, 0.0]), "one edge more"),
        (lambda: PiecewiseAffine("x", [1, 0, 2], [1.0, 2.0], [0.0, 0.0]), "do not ascend"),
        (lambda: PiecewiseAffine("x", [0, 1], [np.nan], [0.0]), "not finite"),
        (lambda: PiecewiseAffine.interpolating("x", [0.0, 0.0], [1.0, 2.0]), "do not interpolate"),
        (lambda: Quantiser(0.0), "the step is 0.0"),
        (lambda: Quantiser(1.0, largest=0), "largest multiple is 0"),
        (lambda: MonotonePieces("x", np.square, [1.0]), "do not enclose"),
        (lambda: MonotonePieces("x", np.square, [-1.0, 1.0]), "strictly monotone"),
        (lambda: ARCTAN.preimage([0.0, 1.6]), "value 1.6 of sample 1 has no preimage"),
        (lambda: SIGN.preimage([[1.0]]), "one sequence"),
        (lambda: SIGN.preimage([1.0, np.nan]), "sample 1 is nan"),
    ],
)
def test_what_cannot_have_a_preimage_is_one_clear_error(make, message):
    with pytest.raises((UsageError, ModelError, DataError), match=message):
        make()
