"""The size of residuals when some of them are outliers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MAD_TO_SIGMA = 1.4826  # median absolute deviation to standard deviation, for normal noise


def robust_sigma(residuals: NDArray[np.float64]) -> float:
    """Standard deviation of residuals about zero, from the median of their absolute values, in their unit.

    Half of them may be outliers.
    """
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals)))
