"""Names for the arrays of numerics."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]  # flags, one for each element of another array
