"""Records of a few hundred rows, in which many questions meet little noise."""

import numpy as np
import pytest

import sysid
from benchmarks.hidden_effects.plan import assign
from sysid.data import make_record
from sysid.demonstration import draw_case


def short_case(family, effect, seed, rows):
    """Return the first rows of a case as a record, and its noise."""
    case = draw_case(np.random.default_rng(seed), family, [effect])
    half = rows // 2
    sets = np.repeat(["est", "val", "test"], [half, half // 2, rows - half - half // 2])
    noise = (case.y - case.noise_free)[:rows]
    return case, make_record(case.u[:rows], case.y[:rows], case.plant.period, split=sets), noise


@pytest.mark.parametrize(
    ("family", "effect", "seed"),
    [
        ("difference-equation", "in_saturation", 26),
        ("mass-spring-damper", "quad_drag", 125),
        ("dc-motor", "quad_drag", 113),
    ],
)
def test_the_noise_of_a_short_record_is_not_lost_in_the_questions(family, effect, seed):
    case, record, noise = short_case(family, effect, seed, 400)
    linear = family == "difference-equation"
    found = sysid.diagnose(
        record,
        "linear" if linear else family,
        case.plant.order if linear else None,
        initial_state="rest",
        start=None if linear else dict(case.plant.parameters),
    )
    assert found.accepted == (effect,)
    # The colour of what the questions left said 0.2 to 0.9 of it; some per cent may be left of a detail.
    assert found.noise_floor == pytest.approx(np.std(noise[record.learning]), rel=0.1)


def test_what_only_led_out_of_a_poor_minimum_is_not_kept():
    """The mode was found beside its place; any second effect lowers the error by moving it."""
    assignment = assign(9410, 10)
    case = assignment.case
    assert case.names == ("extra_mode",)
    record = make_record(case.u, case.y, case.plant.period, split=case.sets)
    found = sysid.diagnose(
        record, order=case.plant.order, initial_state="rest", effects=assignment.candidates, seed=1
    )
    assert found.accepted == ("extra_mode",)
