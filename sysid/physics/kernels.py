"""Compiled recursion of a discretised linear model, with its sensitivities."""

import numpy as np

from sysid._compile import compiled
from sysid.linear.forms import Floats


@compiled
def affine_run(A: Floats, B: Floats, C: Floats, D: Floats, u: Floats, start: Floats, y: Floats) -> None:
    """Fill y(k) = C x(k) + D [u(k); 1], x(k+1) = A x(k) + B [u(k); 1]."""
    n, m, q = A.shape[0], u.shape[1], C.shape[0]
    x, following = start.copy(), np.empty(n)
    for k in range(u.shape[0]):
        for o in range(q):
            value = D[o, m]
            for i in range(n):
                value += C[o, i] * x[i]
            for j in range(m):
                value += D[o, j] * u[k, j]
            y[k, o] = value
        for i in range(n):
            value = B[i, m]
            for j in range(n):
                value += A[i, j] * x[j]
            for j in range(m):
                value += B[i, j] * u[k, j]
            following[i] = value
        for i in range(n):
            x[i] = following[i]


@compiled
def affine_sensitivities(
    A: Floats,
    B: Floats,
    C: Floats,
    D: Floats,
    A_slopes: Floats,
    B_slopes: Floats,
    C_slopes: Floats,
    D_slopes: Floats,
    u: Floats,
    u_slopes: Floats,
    start: Floats,
    y: Floats,
    J: Floats,
) -> None:
    """Fill y and J(k) = dy(k)/d[parameters, start].

    Slopes are derivatives by the parameters, on the first axis; those of C, D and u may be empty.
    """
    n, m, q, p = A.shape[0], u.shape[1], C.shape[0], A_slopes.shape[0]
    x, following = start.copy(), np.empty(n)
    S, T = np.zeros((n, p + n)), np.empty((n, p + n))
    for i in range(n):
        S[i, p + i] = 1.0
    for k in range(u.shape[0]):
        for o in range(q):
            value = D[o, m]
            J[k, o, :] = 0.0
            for i in range(n):
                value += C[o, i] * x[i]
                if C[o, i] != 0.0:
                    for c in range(p + n):
                        J[k, o, c] += C[o, i] * S[i, c]
            for j in range(m):
                value += D[o, j] * u[k, j]
            y[k, o] = value
            for c in range(C_slopes.shape[0]):
                value = D_slopes[c, o, m]
                for i in range(n):
                    value += C_slopes[c, o, i] * x[i]
                for j in range(m):
                    value += D_slopes[c, o, j] * u[k, j]
                J[k, o, c] += value
            for c in range(u_slopes.shape[0]):
                for j in range(m):
                    J[k, o, c] += D[o, j] * u_slopes[c, k, j]
        for i in range(n):
            value = B[i, m]
            for j in range(m):
                value += B[i, j] * u[k, j]
            for c in range(p):
                slope = B_slopes[c, i, m]
                for j in range(m):
                    slope += B_slopes[c, i, j] * u[k, j]
                for j in range(n):
                    slope += A_slopes[c, i, j] * x[j]
                T[i, c] = slope
            for c in range(p, p + n):
                T[i, c] = 0.0
            for c in range(u_slopes.shape[0]):
                for j in range(m):
                    T[i, c] += B[i, j] * u_slopes[c, k, j]
            for j in range(n):
                value += A[i, j] * x[j]
                for c in range(p + n):
                    T[i, c] += A[i, j] * S[j, c]
            following[i] = value
        for i in range(n):
            x[i] = following[i]
        S, T = T, S
