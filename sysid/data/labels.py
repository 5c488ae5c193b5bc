"""Words and types that records and their checks share."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

ESTIMATION_LABELS = ("train", "est")
VALIDATION_LABEL = "val"
TEST_PREFIX = "test"
MINIMUM_ROWS = 20
