"""Printing errors of Chapter 5, each proved by a number."""

import numpy as np
from numpy.typing import NDArray

from replications.errata import Erratum
from replications.pepona.chapter5_pwarx import PAIRS, n_parameters, submodel
from replications.pepona.chapter5_setting import EXAMPLES, Example
from sysid.lft import PiecewiseStructure, Rows, identifiability, rows_of
from sysid.lft.joint import jacobian
from sysid.nonlinearities.piecewise_affine import PiecewiseAffineMap

Floats = NDArray[np.float64]
SAMPLES = 400


def errata5() -> list[Erratum]:
    """Return every printing error with its numbers."""
    return [
        _number_of_parameters(),
        _input_delay(),
        _switching(),
        _last_lag(),
        _sign(),
        _necessity(),
        _sufficiency(),
        _regression(),
        _pwarx_parameters(),
        _numbering(),
    ]


def _noise_free(example: Example) -> tuple[Floats, Floats]:
    u = np.random.default_rng(5).uniform(-example.input, example.input, SAMPLES)
    return u, example.model.simulate(u)


def _left(example: Example, rows: Rows, moved: Floats, known: Floats | None = None) -> float:
    """Return the largest error of noise-free predictions from the moved map, of the size of the output."""
    linear = example.model.linear[: example.structure.n_known]
    predicted = (rows.known if known is None else known) @ linear + moved
    return float(np.abs(rows.y - predicted).max() / np.abs(rows.y).max())


def _filtered(example: Example, rows: Rows, w: Floats) -> Floats:
    filter_ = np.append(1.0, example.model.g)
    return np.asarray(sum(c * rows.delayed(w, lag) for lag, c in enumerate(filter_)))


def _number_of_parameters() -> Erratum:
    example = EXAMPLES["5.2"]
    s = example.structure
    n_a, n_b, n_g = s.n_a, len(s.b_lags) - 1, s.n_g
    return Erratum(
        "number-of-parameters",
        "(5.9)",
        r"n_L = n_a + n_b + n_g + 2",
        r"n_L = n_a + n_b + n_g + 1",
        "difference from the number of coefficients in Example 5.2",
        float(abs(n_a + n_b + n_g + 2 - len(example.linear))),
        float(abs(n_a + n_b + n_g + 1 - len(example.linear))),
        "B has n_b + 1 coefficients, and g_0 = 1 is not estimated.",
    )


def _input_delay() -> Erratum:
    example = EXAMPLES["5.2"]
    u, y = _noise_free(example)
    rows = rows_of(example.structure, u, y)
    moved = _filtered(example, rows, example.model.map(rows.z))
    printed = rows.known.copy()
    printed[:, 1] = u[example.structure.first :]
    return Erratum(
        "input-delay",
        "(5.10b)",
        r"\zeta_k = [-y_{k-1} \dots -y_{k-n_a}\; u_k\; u_{k-1} \dots u_{k-n_b}]^T",
        r"\zeta_k = [-y_{k-1} \dots -y_{k-n_a}\; u_{k-n_k}\; u_{k-n_k-1} \dots u_{k-n_k-n_b}]^T",
        "largest error of (5.8) without noise in Example 5.2, of the largest output",
        _left(example, rows, moved, printed),
        _left(example, rows, moved),
        "The delay n_k of (5.5a) is lost; (5.13) has it.",
    )


def _switching() -> Erratum:
    example = EXAMPLES["5.3"]
    rows = rows_of(example.structure, *_noise_free(example))
    labels, theta = example.model.map.mode(rows.z), example.model.map.theta
    filter_ = np.append(1.0, example.model.g)
    present = np.zeros(rows.y.size)
    for lag, c in enumerate(filter_):
        present += c * np.einsum("ij,ij->i", theta[labels[rows.now]], rows.phi[rows.now - lag])
    return Erratum(
        "switching",
        "(5.11), (5.12)",
        r"\sum_i (\theta^{(i)})^T \delta_{ik}\, G(q)\, \phi_k",
        r"\sum_i (\theta^{(i)})^T G(q)\,(\delta_{ik}\, \phi_k)",
        "largest error of the prediction without noise in Example 5.3, of the largest output",
        _left(example, rows, present),
        _left(example, rows, _filtered(example, rows, example.model.map(rows.z))),
        "As printed today's mode acts on past arguments; (5.13) switches each with its own time.",
    )


def _last_lag() -> Erratum:
    example = EXAMPLES["5.3"]
    u, y = _noise_free(example)
    rows = rows_of(example.structure, u, y)
    w = example.model.map(rows.z)
    n_g = example.structure.n_g
    late = rows.phi[rows.now - n_g].copy()
    late[:, 0] = rows.phi[rows.now - n_g + 1, 0]
    theta = example.model.map.theta[example.model.map.mode(rows.z)[rows.now - n_g]]
    printed = _filtered(example, rows, w)
    printed += example.model.g[-1] * (np.einsum("ij,ij->i", theta, late) - rows.delayed(w, n_g))
    return Erratum(
        "last-lag",
        "(5.13), the line of g_{n_g}",
        r"\theta_1^{(i)} y_{k-n_g}",
        r"\theta_1^{(i)} y_{k-n_g-1}",
        "largest error of the prediction without noise in Example 5.3, of the largest output",
        _left(example, rows, printed),
        _left(example, rows, _filtered(example, rows, w)),
        "The first argument is y(k-1), n_g samples later; the lines above and the input are right.",
    )


def _sign() -> Erratum:
    rng = np.random.default_rng(3)
    past, theta, alpha = rng.standard_normal(SAMPLES), np.array([0.5, -0.7]), 0.3
    a1, mode = -0.4, (past > 0.2).astype(int)
    before = -a1 * past + theta[mode] * past
    size = float(np.abs(before).max())
    printed = -(a1 + alpha) * past + (theta[mode] - alpha) * past
    right = -(a1 + alpha) * past + (theta[mode] + alpha) * past
    return Erratum(
        "sign",
        "(5.18) and below",
        r"(a_1 + \sum_i \theta_1^{(i)}\delta_{ik})\, y_{k-1}, \qquad \bar a_1 = a_1 + \alpha,\;"
        r" \bar\theta_1^{(i)} = \theta_1^{(i)} - \alpha",
        r"(-a_1 + \sum_i \theta_1^{(i)}\delta_{ik})\, y_{k-1}, \qquad \bar a_1 = a_1 + \alpha,\;"
        r" \bar\theta_1^{(i)} = \theta_1^{(i)} + \alpha",
        "change of the output by the transformation that should leave it as it is, of its size",
        float(np.abs(printed - before).max()) / size,
        float(np.abs(right - before).max()) / size,
        "A(q) = 1 + a_1/q enters the prediction with a minus.",
    )


def deficiency(structure: PiecewiseStructure, g: tuple[float, ...]) -> int:
    """Return by how much the Jacobian of a model of two modes misses full rank, regressors being noise."""
    rng = np.random.default_rng(0)
    u, y = rng.uniform(-1, 1, 3000), rng.standard_normal(3000)
    rows = rows_of(structure, u, y)
    width = rows.phi.shape[1]
    map_ = PiecewiseAffineMap(
        rng.standard_normal((2, width)),
        np.vstack([np.zeros(width), np.append(rng.standard_normal(width - 1), 0.1)]),
    )
    linear = np.concatenate([np.zeros(structure.n_known), g])
    columns = jacobian(structure, rows, map_.mode(rows.z), linear, map_.theta)
    sizes = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
    return int(np.sum(sizes < 1e-10 * sizes[0]))


NOT_NECESSARY = PiecewiseStructure(0, (2,), 1, (("u", 1),))
"""u(k-2) stands in B(q) u and in w(k-1), but u(k-1) stands in w(k) alone."""
NOT_SUFFICIENT = PiecewiseStructure(0, (), 1, (("u", 1),))
"""Nothing is common, but with g1 = -1 G(q) removes the constant."""


def _necessity() -> Erratum:
    found = identifiability(NOT_NECESSARY, [0.5])
    missing = deficiency(NOT_NECESSARY, (0.5,))
    return Erratum(
        "lemma-necessity",
        "Lemma 5.1, necessity",
        r"\text{one common regressor of } (\zeta_k, z_{k-l}) \Rightarrow \text{not identifiable}",
        r"\text{not identifiable} \Leftrightarrow G(q)\,\alpha^T\phi_k \in \mathrm{span}(\zeta_k)"
        r" \text{ for an } \alpha \neq 0",
        "missing rank of the Jacobian for y = b u(k-2) + w(k) + g w(k-1), w(k) = f(u(k-1)), not the claimed",
        abs(missing - float(not found.lemma)),
        abs(missing - float(not found.identifiable)),
        "The change of theta reaches y through all of G(q); the proof takes n_g = 0. Here u(k-2) is common, "
        "and yet nothing undoes the change at u(k-1).",
    )


def _sufficiency() -> Erratum:
    found = identifiability(NOT_SUFFICIENT, [-1.0])
    missing = deficiency(NOT_SUFFICIENT, (-1.0,))
    return Erratum(
        "lemma-sufficiency",
        "Lemma 5.1, sufficiency",
        r"\text{no common regressor of } (\zeta_k, z_{k-l}) \Rightarrow \text{identifiable}",
        r"\text{no common regressor of } (\zeta_k, z_{k-l}) \text{ and } G(1) \neq 0 \Rightarrow"
        r" \text{identifiable}",
        "missing rank of the Jacobian for y = w(k) - w(k-1), w(k) = f(u(k-1)), against the claim",
        abs(missing - float(not found.lemma)),
        abs(missing - float(not found.identifiable)),
        "The offset of the map is lost where G(1) = 0. Nor does (5.19) prove more: w is not measured, so it "
        "is no linear regression.",
    )


def _regression() -> Erratum:
    example = EXAMPLES["5.2"]
    s = example.structure
    return Erratum(
        "regression",
        "(5.19)",
        r"y_k = [\zeta_k^T\; w_k \dots w_{k-n_g}]\,\eta_L + \varepsilon_k",
        r"y_k - w_k = [\zeta_k^T\; w_{k-1} \dots w_{k-n_g}]\,\eta_L + \varepsilon_k",
        "number of regressors less number of parameters in Example 5.2",
        float(abs(s.n_known + s.n_g + 1 - s.n_linear)),
        float(abs(s.n_known + s.n_g - s.n_linear)),
        "The coefficient of w(k) is 1, as in (5.8) and (5.23).",
    )


def _pwarx_parameters() -> Erratum:
    example = EXAMPLES["5.2"]
    counted = sum(submodel(example.true, i, j).size for i, j in PAIRS)
    return Erratum(
        "pwarx-parameters",
        "Example 5.2, below (5.28)",
        r"21\ (\Theta_{1,1}, \Theta_{1,2}, \Theta_{2,1}, \Theta_{2,2})",
        r"28 = 4 \cdot 7",
        "difference from the number of entries of the four vectors",
        float(abs(21 - counted)),
        float(abs(n_parameters(example)[1] - counted)),
        "Each Theta has seven entries, six for r and one for the constant.",
    )


def _numbering() -> Erratum:
    labels = ("5.1", "5.1", "5.2", "5.3")
    return Erratum(
        "numbering",
        "Chapter 5",
        r"\text{Example 5.1 (5.14), Example 5.1 (5.25), Example 5.2, Example 5.3}",
        r"\text{Example 5.1, Example 5.2, Example 5.3, Example 5.4}",
        "examples less different numbers",
        float(len(labels) - len(set(labels))),
        0.0,
        "Here 5.1 is that of (5.25), unless the equation is named.",
    )
