"""Chi-square of a fit's residuals when its points share errors.

An error of the tool frame displaces all points together if the tool's orientation differs between them, and
does not average out like independent errors. It is judged with the full covariance of all coordinates.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from procedures.registration.weighted_rigid_fit import pose_jacobian

Array = NDArray[np.float64]


def chi_square_of_shared(
    residuals_mm: Array, fiducials_mm: Array, covariance_mm2: Array, shared_mm: Array
) -> float:
    """Chi-square, with 3n - 6 degrees of freedom, of the residuals (n, 3) mm of a rigid fit with any weights.

    `fiducials_mm` (n, 3) are the mapped points, `covariance_mm2` (n, 3, 3) is the independent part,
    `shared_mm` (n, 3, k) the displacement of every point by each of k unit errors. What a rigid motion can
    explain does not count.
    """
    columns = shared_mm.reshape(-1, shared_mm.shape[-1])
    weight = np.linalg.inv(block_diag(*covariance_mm2) + columns @ columns.T)
    pose = pose_jacobian(fiducials_mm, fiducials_mm.mean(axis=0)).reshape(-1, 6)
    weighted = weight @ pose
    residuals = residuals_mm.reshape(-1)
    explained = weighted.T @ residuals
    whole = residuals @ weight @ residuals
    return float(whole - explained @ np.linalg.solve(pose.T @ weighted, explained))
