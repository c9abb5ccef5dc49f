"""Array type of the numerics: floats of any shape, which docstrings and comments state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
