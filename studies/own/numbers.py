"""Numbers returned by a user method: real ones, nothing that NumPy would merely convert."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REAL = "iuf"  # NumPy's kinds: whole numbers, with or without a sign, and floating point
IN_WORDS = {"U": "text", "S": "bytes", "c": "complex numbers", "b": "truth values"}


def real_numbers(answer: object) -> Array:
    """The answer as an array. Raises ValueError, saying what it is, for anything but real numbers."""
    try:
        given = np.asarray(answer)
    except (TypeError, ValueError, OverflowError):  # such as rows of unequal length
        raise ValueError(type(answer).__name__) from None
    if given.size == 0:
        return np.empty(given.shape)
    if given.dtype.kind not in REAL:
        raise ValueError(IN_WORDS.get(given.dtype.kind, type(answer).__name__))
    return given.astype(float)
