"""Parts of a search for an effect in a linear model, each beside the plain way, in one run."""

import numpy as np
import pytest

from sysid.diagnosis.effects import find_effects
from sysid.diagnosis.linear.chain import Chain
from sysid.diagnosis.linear.rows import Data
from sysid.diagnosis.linear.search import EffectSearch
from sysid.diagnosis.linear.triangles import damped_step, scaled_triangle
from sysid.diagnosis.structures.structure import WHITE, Choice, Effort

ROWS = 1200
POINT = np.array([-1.4, 0.6, 0.3, -0.1])


def chain_of(name, form):
    (effect,) = find_effects([name])
    return Chain(2, [Choice(effect, effect.forms[form])], False, False)


def measured(chain, values):
    rng = np.random.default_rng(0)
    u, y = np.repeat(rng.uniform(-1, 1, ROWS // 3), 3), np.zeros(ROWS)
    data = Data(u, y, np.ones(ROWS, dtype=bool), np.array([0, ROWS]), 0.5)
    y = chain.run(data, np.concatenate([POINT, values])).y
    return Data(u, y + 0.01 * np.std(y) * rng.standard_normal(ROWS), data.used, data.begin, data.period)


@pytest.mark.parametrize("way", ["compiled", "numpy"])
@pytest.mark.benchmark(group="a damped step of eight unknowns, 1200 rows")
def test_step(benchmark, way):
    rng = np.random.default_rng(0)
    lines, error, no = rng.standard_normal((8, ROWS)), rng.standard_normal(ROWS), np.zeros(8, dtype=bool)

    def compiled():
        R, c, lengths = scaled_triangle(lines.copy(), error, no, no)
        return damped_step(R, c, 1e-4)[0] / lengths

    def plain():
        lengths = np.linalg.norm(lines, axis=1)
        stacked = np.vstack([(lines / lengths[:, np.newaxis]).T, 1e-2 * np.eye(8)])
        Q, R = np.linalg.qr(stacked)
        return np.linalg.solve(R, Q[:ROWS].T @ error) / lengths

    assert np.allclose(compiled(), plain())
    benchmark(compiled if way == "compiled" else plain)


@pytest.mark.parametrize("lines", ["all", "of what moves"])
@pytest.mark.parametrize(("name", "values"), [("in_relay", [0.3, 0.5, 0.2]), ("op_gain", [0.3, 0.8])])
@pytest.mark.benchmark(group="a Jacobian, 1200 rows")
def test_jacobian(benchmark, name, values, lines):
    chain = chain_of(name, -1)
    data, point = measured(chain, values), np.concatenate([POINT, values])
    run, free = chain.run(data, point), np.arange(point.size) < 4
    benchmark(chain.jacobian, data, point, run, None if lines == "all" else free)


@pytest.mark.parametrize("grid", ["searched", "known"])
@pytest.mark.benchmark(group="a fine search of a relay of two sides, 1200 rows")
def test_search(benchmark, grid):
    chain = chain_of("in_relay", 1)
    data = measured(chain, [0.3, 0.5, 0.2])
    known = EffectSearch(chain, data, WHITE, [POINT]).searched()

    def search():
        found = known.found if grid == "known" else None
        return EffectSearch(chain, data, WHITE, known.starts, found).search(Effort.FINE)

    assert benchmark(search)
