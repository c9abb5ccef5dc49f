"""Validates a pairing against the stated errors of both devices (thesis, 5.3).

The thesis says that the known errors of both sets are used to validate a successful pairing, but not
how. Here the pairs are fitted, and the sum of squared residuals must not exceed what the stated
standard deviations explain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.registration.correspondence import MatchStatus
from procedures.registration.hypotheses import gate
from procedures.registration.rigid_fit import fit_rigid, residuals
from procedures.registration.similarity_matrix import SimilarityPairs

Array = NDArray[np.float64]

REFUSED_SHARE = 1e-3  # of the correct pairings; our choice, the thesis gives none


def validate_many(
    image_mm: Array,
    physical_mm: Array,
    found: Sequence[SimilarityPairs],
    variance_mm2: float,
    refused_share: float = REFUSED_SHARE,
) -> tuple[SimilarityPairs, ...]:
    """Check pairings of image points (b, n, 3) with physical points (b, m, 3), mm, against the stated errors.

    `variance_mm2` is the stated variance per axis of both sets together. A UNIQUE pairing whose residuals
    are larger than those of all but `refused_share` of the correct ones becomes INCONSISTENT; the others are
    returned unchanged.
    """
    by_size: dict[int, list[int]] = {}
    for number, one in enumerate(found):
        if one.status is MatchStatus.UNIQUE:
            by_size.setdefault(len(one.pairs), []).append(number)
    judged = list(found)
    for size, numbers in by_size.items():
        pairs = np.array([found[number].pairs for number in numbers])
        image = np.take_along_axis(image_mm[numbers], pairs[:, :, :1], axis=1)
        physical = np.take_along_axis(physical_mm[numbers], pairs[:, :, 1:], axis=1)
        left = residuals(fit_rigid(image, physical), image, physical)
        too_large = np.square(left).sum(axis=(1, 2)) > gate(size, refused_share) * variance_mm2
        for number in np.array(numbers)[too_large].tolist():
            judged[number] = SimilarityPairs(MatchStatus.INCONSISTENT, np.empty((0, 2), dtype=np.intp))
    return tuple(judged)
