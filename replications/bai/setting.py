"""What the paper's two examples are made of."""

import numpy as np

ALPHA = (-0.8333, -0.1667)
BETA = (1.0, 1.0)
ORDER = 2
THRESHOLD = 1.0
"""The true a of every nonlinearity in the examples."""

TRUE = {"a": THRESHOLD, "alpha1": ALPHA[0], "alpha2": ALPHA[1], "beta1": BETA[0], "beta2": BETA[1]}
PARAMETERS = tuple(TRUE)

SEARCH_UPPER = 3.5
"""Upper end of the range searched for a; the paper's figure 3 shows J over such a range."""

EXAMPLE_1_SAMPLES = 100
EXAMPLE_1_INPUT = 4.0
EXAMPLE_1_NOISE = 0.2
EXAMPLE_2_SAMPLES = 2000
EXAMPLE_2_INPUTS = (2.0, 3.0)
EXAMPLE_2_NOISE = 0.1

TABLE_ROWS = ("preload", "dead-zone", "saturation", "relay", "hysteresis-relay", "hysteresis")
"""Rows of Table 1, in its order."""

PHYSICAL_READINGS = ("hysteresis-relay-schmitt", "hysteresis-play")
"""What the two hysteretic maps of (1.4) are usually taken to be."""

CASES = TABLE_ROWS + PHYSICAL_READINGS

RELAYS = ("relay", "hysteresis-relay", "hysteresis-relay-schmitt")
"""Maps whose output does not change with a between the samples: J is piecewise constant."""


def impulse_response(n: int) -> np.ndarray:
    """Return h_1 .. h_n of the linear system of the examples (h_0 = 0)."""
    response = np.zeros(n + 1)
    for k in range(1, n + 1):
        response[k] = BETA[k - 1] if k <= len(BETA) else 0.0
        for i, alpha in enumerate(ALPHA, start=1):
            if k - i >= 1:
                response[k] += alpha * response[k - i]
    return response[1:]
