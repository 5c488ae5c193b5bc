"""Printing errors of the paper: each printed form shown wrong by a number, its correction shown right."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from replications.borges import setting
from replications.borges.derivatives import point
from replications.errata import Erratum
from sysid.local_linear import LocalLinearModel, blocked_cost
from sysid.local_linear import gradients as g
from sysid.local_linear.blocked import BLOCK
from sysid.local_linear.passes import fly, regressors, sensitivities
from sysid.local_linear.printed import kronecker_regressors, redundant_directions
from sysid.local_linear.problem import At
from sysid.local_linear.projected import tangent
from sysid.local_linear.recursion import plain
from sysid.local_linear.structure import Course

Floats = NDArray[np.float64]

ROWS = 40
"""Samples on which (8) is evaluated; its time is quadratic in them."""

PRINTED_BLOCK = 64


def errata() -> list[Erratum]:
    """Return every erratum with its numbers."""
    problem, eta = point()
    at = problem(eta)
    return [
        _time_order(at),
        _projection_matrix(at),
        _column_order(at),
        _excitation_in_sum(at),
        _gradient_of_cost(at),
        _local_inputs(at),
        _jacobian(at),
        _algorithm_1(at),
    ]


def _short(at: At) -> Course:
    one = at.courses[0]
    return Course(one.sizes, one.local, one.C, one.weights[:ROWS], one.slopes[:ROWS], one.A[:ROWS],
    one.z[:ROWS],
                  one.inputs[:ROWS])  # fmt: skip


def _row_by_row(phi: Floats, one: Course) -> Floats:
    """Return columns in the order of the rows of G from the order of vec(G)."""
    n, channels = one.sizes.n_states, one.sizes.channels
    return phi.reshape(-1, channels, n).transpose(0, 2, 1).reshape(-1, n * channels)


def _relative(found: Floats, expected: Floats) -> float:
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


def ascending_regressors(one: Course) -> Floats:
    """Return Phi by (8) with the product of A_h in ascending order of h, as printed."""
    blocks = []
    for k in range(one.A.shape[0]):
        total = np.zeros((one.sizes.n_outputs, one.sizes.n_linear))
        for j in range(k):
            product = np.eye(one.sizes.n_states)
            for h in range(j + 1, k):
                product = product @ one.A[h]
            total += np.kron(one.z[j], one.C @ product)
        blocks.append(total)
    return np.vstack(blocks)


def _time_order(at: At) -> Erratum:
    one = _short(at)
    expected = regressors(one, respond=plain).reshape(-1, one.sizes.n_linear)
    return Erratum(
        "time-order",
        "(6), (8)",
        r"C \prod_{h=j+1}^{k-1} \mathcal A_h \quad (h \text{ ascending})",
        r"C\, \mathcal A_{k-1} \mathcal A_{k-2} \cdots \mathcal A_{j+1}",
        "largest difference of the regressors from a simulation of (1), relative to the largest",
        _relative(_row_by_row(ascending_regressors(one), one), expected),
        _relative(_row_by_row(kronecker_regressors(one), one), expected),
        "The matrices do not commute: the last one in time stands on the left.",
    )


def _projection_matrix(at: At) -> Erratum:
    one, found = at.courses[0], at.solution
    sizes, eta = one.sizes, at.problem.sizes.pack(one.local, one.C, np.ones((4, 1)), np.zeros((4, 1)))
    n, s, p = sizes.n_states, sizes.n_models, sizes.n_outputs
    M = redundant_directions(one.local, one.C)
    dynamics = np.arange(n * n * s).reshape(s * n, n).T.ravel()
    output = n * n * s + np.arange(n * p).reshape(n, p).T.ravel()
    moved = M[np.concatenate([dynamics, output])]
    assert moved.shape == tangent(sizes, eta)[: sizes.n_dynamic].shape
    jacobian = np.vstack(g.exact(one, found))[:, : sizes.n_dynamic]
    effect = np.abs(jacobian @ moved).max() / (np.linalg.norm(jacobian) * np.linalg.norm(moved))
    return Erratum(
        "projection-matrix",
        "(13)",
        r"\sum_i \Pi_i^T \otimes \begin{bmatrix} A\Pi_i^T \\ C\Pi_i^T \end{bmatrix}"
        r" - A \otimes \begin{bmatrix} I_n \\ 0 \end{bmatrix}",
        r"\begin{bmatrix} \sum_i \Pi_i^T \otimes A\Pi_i^T - A^T \otimes I_n \\ I_n \otimes C \end{bmatrix}",
        "effect on the residual of a step along the columns (the printed terms have different shapes)",
        float("inf"),
        float(effect),
        "The two terms are sn(n + l) by nn and n(n + l) by snn. A is to be transposed, and C, which all "
        "local models share, has one block of rows of its own.",
    )


def _column_order(at: At) -> Erratum:
    one = at.courses[0]
    n, channels = one.sizes.n_states, one.sizes.channels
    rng = np.random.default_rng(3)
    G = rng.standard_normal((n, channels))
    phi = regressors(one).reshape(-1, n, channels)
    model = LocalLinearModel.of(one.sizes, at.problem.sizes.pack(one.local, one.C, *_weights(at)), G)
    experiment = at.problem.experiments[0]
    expected = model.simulate(experiment.inputs[:, :-1], experiment.scheduling).ravel()
    pairs = [(a, b) for b in range(channels) for a in range(2)] + [
        (a, b) for a in range(2, n) for b in range(channels)
    ]
    printed = np.column_stack([phi[:, a, b] for a, b in pairs])
    right = np.column_stack([phi[:, a, b] for b in range(channels) for a in range(n)])
    stacked = G.T.ravel()
    return Erratum(
        "column-order",
        "(17), (18)",
        r"\Phi = [y_{1,1}\; y_{2,1}\; y_{1,2}\; \dots\; y_{n,s(m+1)}]",
        r"\Phi = [y_{1,1}\; y_{2,1}\; \dots\; y_{n,1}\; y_{1,2}\; \dots\; y_{n,s(m+1)}]",
        r"largest relative difference of Phi vec(G) from the simulated output",
        _relative(printed @ stacked, expected),
        _relative(right @ stacked, expected),
        "All n rows of a column of G come before the next column; the print is right for n = 2 alone.",
    )


def _weights(at: At) -> tuple[Floats, Floats]:
    _, _, widths, centres = at.problem.sizes.unpack(point()[1])
    return widths, centres


def _excitation_in_sum(at: At) -> Erratum:
    one = at.courses[0]
    phi = regressors(one)
    x, worst = np.zeros(one.sizes.n_states), 0.0
    for k in range(ROWS):
        worst = max(worst, float(np.abs(one.C @ x - phi[k, :, one.sizes.channels + 4]).max()))
        x = one.A[k] @ x
        x[1] += one.z[k, 0, 4]
    return Erratum(
        "excitation-in-sum",
        "(19), (31)",
        r"\sum_i p_i (A_i x_{\alpha,\beta} + E_{\alpha,\beta} \tilde u_k)",
        r"\sum_i p_i A_i x_{\alpha,\beta} + E_{\alpha,\beta} (p(\phi_k) \otimes \tilde u_k)",
        "largest difference from the column of Phi that the system stands for (as printed E has s(m + 1) "
        "columns and meets a vector of m + 1)",
        float("inf"),
        worst,
        "The weights enter by the Kronecker product, once, and not by the sum.",
    )


def _gradient_of_cost(at: At) -> Erratum:
    one, found = at.courses[0], at.solution
    jacobian = g.approach_1(one, found)
    expected = g.cost_gradient(one, found)
    half = jacobian.T @ found.residual
    return Erratum(
        "gradient-of-cost",
        "(27)",
        r"\tilde E_N \frac{\partial \tilde E_N}{\partial \eta_j}",
        r"2\,\tilde E_N^T \frac{\partial \tilde E_N}{\partial \eta_j}",
        "largest relative difference from the gradient by a backward pass of the adjoint system",
        _relative(half, expected),
        _relative(2.0 * half, expected),
        "A factor and a transpose are missing; a search that only compares directions does not notice.",
    )


def common_input_sensitivities(one: Course, G: Floats) -> Floats:
    """Return (42) as printed: the same B and O, the mean of the local ones, in every term."""
    flight = fly(one, G)
    n, s, m1 = one.sizes.n_states, one.sizes.n_models, one.inputs.shape[1]
    mean = G.reshape(n, s, m1).mean(axis=1)
    alone = np.einsum("ieb,kb->kie", one.local, flight.x[:-1]) + (one.inputs @ mean.T)[:, np.newaxis]
    mixed = np.einsum("ki,kie->ke", one.weights, alone)
    moves = np.einsum("ki,kjid,kie->kejid", one.weights, one.slopes, alone - mixed[:, np.newaxis])
    printed = type(flight)(flight.x, flight.drives, np.ascontiguousarray(moves.reshape(flight.moves.shape)))
    return sensitivities(one, printed)


def _local_inputs(at: At) -> Erratum:
    one, found = at.courses[0], at.solution
    expected = -g.approach_2a(one, found)
    G = at.gains()
    shape = expected.shape
    return Erratum(
        "local-inputs",
        "(42)",
        r"\frac{\partial p_i}{\partial \eta_j} (A_i x_k + \hat B u_k + \hat O)",
        r"\frac{\partial p_i}{\partial \eta_j} (A_i x_k + \hat B_i u_k + \hat O_i)",
        "largest relative difference of the sensitivities from (d Phi / d eta) theta",
        _relative(common_input_sensitivities(one, G).reshape(shape), expected),
        _relative(sensitivities(one, fly(one, G)).reshape(shape), expected),
        "Without the index B and O drop out, as derivatives of weights sum to zero.",
    )


def _jacobian(at: At) -> Erratum:
    one, found = at.courses[0], at.solution
    expected = g.approach_1(one, found)
    return Erratum(
        "jacobian",
        "(37), (39)",
        r"\frac{\partial \tilde E_N}{\partial \eta_j} ="
        r" \frac{\partial E_N(\hat\theta_\ell, \eta)}{\partial \eta_j}",
        r"\frac{\partial \tilde E_N}{\partial \eta_j} ="
        r" (I - P) \frac{\partial E_N(\hat\theta_\ell, \eta)}{\partial \eta_j}"
        r" - (\Phi^\dagger)^T \frac{\partial \Phi^T}{\partial \eta_j} \tilde E_N",
        "largest relative difference from the derivative (29)",
        _relative(g.approach_2b(one, at.gains()), expected),
        _relative(found.back(*g.exact(one, found)), expected),
        "The chain rule (38) is right and its second term is not zero: what vanishes is its product with the "
        "residual. So 2a and 2b give the gradient of the cost, and a wrong Gauss-Newton matrix.",
    )


def algorithm_1(phi: Floats, block: int) -> tuple[Floats, Floats]:
    """Return Q_1 and R_1 by Algorithm 1 as printed, whose indices begin at one."""
    q1, r1 = np.linalg.qr(phi[:block])
    columns = r1.shape[0]
    first = block
    while first + 1 <= phi.shape[0] - block:
        qa, r1 = np.linalg.qr(np.vstack([r1, phi[first : first + block + 1]]))
        q1 = np.vstack([q1 @ qa[:columns], qa[columns:]])
        first += block
    return q1, r1


def _algorithm_1(at: At) -> Erratum:
    sizes, experiment, y = at.problem.sizes, at.problem.experiments[0], at.problem.y[0]
    phi = regressors(at.courses[0]).reshape(-1, sizes.n_linear)
    q1, r1 = algorithm_1(phi, PRINTED_BLOCK)
    expected = phi.T @ phi
    found = blocked_cost(sizes, course_eta(at), experiment, y, PRINTED_BLOCK)
    assert q1.shape[0] != phi.shape[0]
    R = found.R[: sizes.n_linear, : sizes.n_linear]
    return Erratum(
        "algorithm-1",
        "Algorithm 1",
        r"\text{for } i = N_b + 1 : N_b : N - N_b, \quad \Phi(i : i + N_b, :)",
        r"\text{for } i = N_b + 1 : N_b : N, \quad \Phi(i : \min(i + N_b - 1, N), :)",
        r"largest relative difference of R'R from Phi'Phi",
        _relative(r1.T @ r1, expected),
        _relative(R.T @ R, expected),
        "Blocks overlap by a row, the last one is left out, and Q has not as many rows as Phi. Without Q, "
        "the factor of [Phi Y] gives parameters and cost in the memory of one block.",
    )


def course_eta(at: At) -> Floats:
    """Return the eta of a point made by `point`."""
    one = at.courses[0]
    return at.problem.sizes.pack(one.local, one.C, *_weights(at))


def condition_numbers() -> dict[str, float]:
    """Return what normal equations do to theta, and what Q of Algorithm 1 costs."""
    problem, eta = point()
    A, C, widths, centres = problem.sizes.unpack(eta)
    wide = problem(problem.sizes.pack(A, C, 0.5 * widths, centres))
    phi = regressors(wide.courses[0]).reshape(-1, problem.sizes.n_linear)
    theta = np.random.default_rng(2).standard_normal(problem.sizes.n_linear)
    y = phi @ theta
    by_qr = g.eliminate(phi, y).theta
    by_normal = cho_solve(cho_factor(phi.T @ phi), phi.T @ y)
    size = np.linalg.norm(theta)
    n_samples, columns = 1_000_000, problem.sizes.n_linear
    blocks = np.arange(1, n_samples // BLOCK)
    accumulated = float(np.sum(2.0 * blocks * BLOCK * setting.N_OUTPUTS * columns**2))
    return {
        "condition/phi": float(np.linalg.cond(phi)),
        "condition/theta_error/qr": float(np.linalg.norm(by_qr - theta) / size),
        "condition/theta_error/normal-equations": float(np.linalg.norm(by_normal - theta) / size),
        "algorithm-1/operations_for_q_over_r": accumulated
        / (2.0 * n_samples * setting.N_OUTPUTS * columns**2),
    }
