"""The search for the shapes of an effect in a linear model."""

import numpy as np
import pytest

from sysid.data import make_record
from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.levenberg import Minimum
from sysid.diagnosis.linear.narrowing import Narrowing
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.search import EffectSearch
from sysid.diagnosis.linear.structure import LinearStructure
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort

POINT = np.array([-1.4, 0.6, 0.3, -0.1])


def choice(name, form=0):
    (effect,) = find_effects([name])
    return Choice(effect, effect.forms[form])


def data_with(picked, values, n=600):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(-1, 1, n // 3), 3)
    data = Data(u, np.zeros(n), np.ones(n, dtype=bool), np.array([0, n]), 0.5)
    y = Chain(2, [picked], False, False).run(data, np.concatenate([POINT, values])).y
    return Data(u, y + 0.01 * np.std(y) * rng.standard_normal(n), data.used, data.begin, data.period)


@pytest.mark.parametrize(
    ("name", "form", "values"),
    [("in_relay", 0, [0.35]), ("in_relay", 1, [0.3, 0.5, 0.2]), ("in_deadzone", 1, [0.2, 0.4])],
)
def test_a_fine_search_from_the_grid_of_a_coarse_one_is_a_fine_search(name, form, values):
    picked = choice(name, form)
    data, chain = data_with(picked, values), Chain(2, [picked], False, False)
    grid = EffectSearch(chain, data, WHITE, [POINT]).searched()
    again = EffectSearch(chain, data, WHITE, grid.starts, grid.found).search(Effort.FINE)
    afresh = EffectSearch(chain, data, WHITE, [POINT]).search(Effort.FINE)
    assert [end.cost for end in again] == [end.cost for end in afresh]
    assert np.array_equal(again[0].point, afresh[0].point)


def test_a_structure_searches_each_grid_once(monkeypatch):
    picked = choice("in_deadzone")
    data = data_with(picked, [0.3])
    structure = LinearStructure(make_record(data.u, data.y, period=0.5), 2, initial_state="rest")
    rows, searched = structure.record.learning, []
    inner = EffectSearch.searched
    monkeypatch.setattr(EffectSearch, "searched", lambda self: searched.append(1) or inner(self))
    baseline = structure.baseline(rows)
    coarse = structure.fit([picked], rows, WHITE, baseline, effort=Effort.COARSE)
    fine = structure.fit([picked], rows, WHITE, baseline, effort=Effort.FINE)
    assert len(searched) == 1
    assert fine.cost <= coarse.cost


def test_golden_sections_fit_each_cell_once_and_find_the_best():
    """A cost that is constant between thirty thresholds, with its least value in one cell."""
    thresholds = np.linspace(0.0, 1.0, 31)
    fits = []

    def cell(point):
        return int(np.searchsorted(thresholds, point[0])).to_bytes(2, "big")

    def fit(point):
        fits.append(cell(point))
        return Minimum(point, 1.0 + abs(int.from_bytes(fits[-1], "big") - 17), True)

    narrowing = Narrowing(fit(np.array([0.5])), np.array([0]), [np.array([0.0, 0.5, 1.0])], fit, cell)
    fits.clear()
    narrowing.sweep(14, closer=True)
    assert narrowing.best.cost == 1.0
    assert len(fits) == len(set(fits))


def test_golden_sections_of_two_shapes_leave_neither_out():
    def fit(point):
        return Minimum(point, float((point[0] - 0.37) ** 2 + (point[1] - 0.81) ** 2), True)

    grids = [np.array([0.0, 0.5, 1.0])] * 2
    narrowing = Narrowing(fit(np.array([0.5, 0.5])), np.array([0, 1]), grids, fit, lambda point: None)
    narrowing.sweep(14, closer=False)
    # Sixteen sections of a range of one leave 0.618^15.
    assert np.abs(narrowing.best.point - [0.37, 0.81]).max() < 1e-3
