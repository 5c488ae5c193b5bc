"""Statistics of the decision: is an effect there, is anything left, can two be told apart."""

from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.effects.base import Floats
from sysid.diagnosis.structures.projection import orthonormal, without

# Simulated records without an effect: p-values are multiples of 1/2000.
REPLICATES = 1999
# Blocks of rows of a paired test.
BLOCKS = 24
# Two errors are told apart when their squares differ by so many standard errors; their logarithms by more,
# for they tell of errors too small to matter, too.
TIED, PLAINLY = 2.0, 4.0
SMALLEST = 1e-300


@dataclass(frozen=True, eq=False)
class ScoreScreen:
    """Score statistics of all candidates, and the distribution of the largest when nothing is missing.

    Attributes
    ----------
    statistics : dict of str to float
        Largest score of each effect over its grid, in units of the noise variance.
    null : ndarray, shape (n_replicates,)
        Largest score over all effects and grids in simulated records with nothing missing, sorted.
    n_points : int
        Points of all grids.
    """

    statistics: dict[str, float]
    null: Floats
    n_points: int = 1

    def p_value(self, statistic: float) -> float:
        """Return the chance that the largest of all scores is as large without anything missing."""
        larger = self.null.size - int(np.searchsorted(self.null, statistic))
        return (1 + larger) / (1 + self.null.size)

    def fitted_p_value(self, ratio: float, n_parameters: int) -> float:
        """Return a bound on the chance that the best fit of all lowers the cost as much.

        A fit may leave the grid: the largest score over the grid understates what it gains by chance.
        Near each point of a grid it gains as much as a linear model with as many parameters, so the
        sum of their chances bounds that of the largest, as does the fineness of the simulation.

        Parameters
        ----------
        ratio : float
            How much the cost falls, in units of the noise variance.
        n_parameters : int
            Parameters of the effect, its shape included.
        """
        return max(chance_of(ratio, n_parameters, self.n_points), 1.0 / (1 + self.null.size))


def chance_of(ratio: float, n_parameters: int, looks: int) -> float:
    """Return a bound on the chance that the cost falls so much at one of several looks.

    Parameters
    ----------
    ratio : float
        How much the cost falls, in units of the noise variance.
    n_parameters : int
        By which it falls.
    looks : int

    Examples
    --------
    >>> round(chance_of(3.841, 1, 1), 4), round(chance_of(3.841, 1, 10), 4)
    (0.05, 0.5001)
    """
    from scipy.special import gammaincc

    return min(looks * float(gammaincc(0.5 * max(n_parameters, 1), 0.5 * max(ratio, 0.0))), 1.0)


def score_screen(
    residual: Floats,
    tangent: Floats,
    directions: dict[str, list[Floats]],
    variance: float,
    rng: np.random.Generator,
) -> ScoreScreen:
    """Compute the scores of all effects, what the model's own parameters can follow projected out.

    The strength of a candidate is zero and its other parameters mean nothing when nothing is missing,
    so no table holds the distribution of the largest score: it is simulated.  All scores are
    squares of projections of one white vector, so only its components in the span of all
    directions need be drawn.

    Parameters
    ----------
    residual : ndarray, shape (n_rows,)
        Whitened.
    tangent : ndarray, shape (n_rows, n_parameters)
        Whitened derivative by the model's own parameters.
    directions : dict of str to list of ndarray, shape (n_rows, n_columns)
        Whitened directions of each effect, one array for each point of its grid.
    variance : float
        Of the noise.
    rng : Generator

    References
    ----------
    Hansen (1996), Inference when a nuisance parameter is not identified under the null hypothesis,
    Econometrica 64.
    """
    Q = orthonormal(tangent)
    names, bases = [], []
    for name, blocks in directions.items():
        for block in blocks:
            basis = orthonormal(block, Q)
            if basis.shape[1]:
                names.append(name)
                bases.append(basis)
    statistics = dict.fromkeys(directions, 0.0)
    if not bases:  # a plain fit that has run off says nothing of small changes, and nothing against a fit
        looks = sum(len(blocks) for blocks in directions.values())
        return ScoreScreen(statistics, np.zeros(REPLICATES), max(looks, 1))
    stacked = np.hstack(bases)
    edges = np.cumsum([0, *(basis.shape[1] for basis in bases)])[:-1]
    scores = np.add.reduceat((stacked.T @ residual) ** 2, edges) / variance
    for name, value in zip(names, scores.tolist(), strict=True):
        statistics[name] = max(statistics[name], value)
    eigenvalues, vectors = np.linalg.eigh(stacked.T @ stacked)
    kept = eigenvalues > 1e-10 * eigenvalues[-1]
    root = vectors[:, kept] * np.sqrt(eigenvalues[kept])
    drawn = root @ rng.standard_normal((int(kept.sum()), REPLICATES))
    null = np.zeros(REPLICATES)
    for part in np.split(drawn**2, edges[1:]):
        np.maximum(null, part.sum(axis=0), out=null)
    return ScoreScreen(statistics, np.sort(null), len(bases))


@dataclass(frozen=True)
class Remainder:
    """What a flexible set of directions still finds in a residual.

    Attributes
    ----------
    p_value : float
        Of the F test against a residual that nothing explains.
    explained : float
        Sum of squares explained beyond what chance explains, at least 0.
    variance : float
        Of what is left, the noise.
    """

    p_value: float
    explained: float
    variance: float


def remainder(residual: Floats, tangent: Floats, probes: Floats) -> Remainder:
    """Test whether anything is left in a whitened residual, by an F test on probe directions."""
    from scipy.special import fdtrc

    Q = orthonormal(tangent)
    P = orthonormal(probes, Q)
    projected = without(residual, Q)
    total = float(projected @ projected)
    explained = float(np.sum((P.T @ projected) ** 2))
    n, q = residual.size - Q.shape[1], P.shape[1]
    if q == 0 or n - q < 10 or total == 0.0:
        return Remainder(1.0, 0.0, total / max(n, 1))
    variance = (total - explained) / (n - q)
    p_value = float(fdtrc(q, n - q, explained / q / max(variance, 1e-300)))
    return Remainder(p_value, max(explained - q * variance, 0.0), variance)


def block_separation(first: Floats, second: Floats) -> float:
    """Return by how many standard errors the second squared error is larger than the first, in blocks.

    The rows are cut into blocks so long that their means are nearly independent.

    Source: Diebold & Mariano (1995), Journal of Business & Economic Statistics 13, with block means
    for the long-run variance.
    """
    blocks = _block_means(second**2 - first**2)
    error = float(blocks.std(ddof=1)) / np.sqrt(blocks.size)
    return float(blocks.mean()) / error if error > 0.0 else 0.0


def told_apart(better: Floats, worse: Floats) -> bool:
    """Tell whether the second squared error is larger than the first beyond chance.

    Where a model loses the plant its error grows for as long as nothing brings it back, and lies in a few
    blocks: their mean says little, their orders of magnitude all the more.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> noise = rng.standard_normal(480)
    >>> lost = noise + np.exp(np.repeat(rng.uniform(0.0, 20.0, 24), 20))
    >>> bool(block_separation(noise, lost) > TIED), told_apart(noise, lost), told_apart(noise, noise[::-1])
    (False, True, False)
    """
    if block_separation(better, worse) >= TIED:
        return True
    blocks = np.log(np.maximum([_block_means(worse**2), _block_means(better**2)], SMALLEST))
    rise = blocks[0] - blocks[1]
    error = float(rise.std(ddof=1)) / np.sqrt(rise.size)
    return bool(rise.mean() > PLAINLY * max(error, SMALLEST))


def excess_in_blocks(first: Floats, second: Floats) -> float:
    """Return by how many standard errors the mean square of the second is larger, over different rows.

    In blocks, so that a few large errors, such as those of a quantiser, count as few.

    Examples
    --------
    >>> quiet, loud, once = np.ones(240), np.full(240, 2.0), np.ones(240)
    >>> quiet[::2], loud[::2], once[7] = 0.9, 2.2, 50.0
    >>> excess_in_blocks(quiet, loud) > 100.0, excess_in_blocks(quiet, once) < 1.1
    (True, True)
    """
    inside, outside = _block_means(first**2), _block_means(second**2)
    error = np.sqrt(inside.var(ddof=1) / inside.size + outside.var(ddof=1) / outside.size)
    more = float(outside.mean() - inside.mean())
    return more / max(float(error), 1e-300)


def _block_means(values: Floats) -> Floats:
    return np.array([part.mean() for part in np.array_split(values, min(BLOCKS, values.size))])
