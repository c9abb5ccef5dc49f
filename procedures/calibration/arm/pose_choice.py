"""Selects the measurement poses that reveal most about an arm: greedy D-optimal design.

Each pose adds the information that it provides beyond what is already known; the one that adds most is next.
Initially only the prior of an uncalibrated arm is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.calibration.arm.error_model import ArmModel
from procedures.calibration.arm.looks import LookArrays

Array = NDArray[np.float64]

LOOK_SIGMA_MM = 0.02  # of a measurement, per axis: repeatability of a good arm, and the stereo head
SPHERE_SIGMA_MM = 10.0  # prior uncertainty of a sphere's position


def most_telling(model: ArmModel, candidates: LookArrays, count: int) -> NDArray[np.intp]:
    """Indices of `count` poses in order of selection; fewer if there are not enough."""
    values = np.zeros(model.size + 3 * candidates.spheres)
    slopes = model.slopes(values, candidates) / LOOK_SIGMA_MM
    known = np.ones(len(values))
    known[model.size :] = SPHERE_SIGMA_MM**2
    covariance: Array = np.diag(known)
    rest = np.ones(len(slopes), dtype=bool)
    chosen = []
    for _ in range(min(count, len(slopes))):
        spread = slopes @ covariance @ slopes.transpose(0, 2, 1)
        gain = np.linalg.det(np.eye(3) + spread)
        best = int(np.argmax(np.where(rest, gain, 0.0)))
        rest[best] = False
        chosen.append(best)
        through = covariance @ slopes[best].T
        covariance = covariance - through @ np.linalg.solve(np.eye(3) + spread[best], through.T)
    return np.array(chosen, dtype=np.intp)
