"""Error of the arm at a target, as far as its looks at skin and spheres show it.

Spheres that are looked at in the posture of the target err with it: what the common adjustment leaves there
of them is the arm's, and it is made up for. Looks at the skin, from many sides, tell the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from procedures.registration.surface.misfit import POSE, MisfitModel
from ronna_hw.arrays import Array


@dataclass(frozen=True, eq=False)
class FoundArm:
    """Errors (k) of the arm by an adjustment, under each hypothesis (h): their sizes, and what is known.

    `sizes` (h, k) are best linear unbiased predictions in standard deviations, `known` (h, k, k) the part of
    their covariance that the looks take away. `gains` (h, k, n) are the effects of the errors of the rows on
    the sizes.
    """

    sizes: Array
    known: Array
    gains: Array

    @classmethod
    def of(cls, model: MisfitModel, jacobian: Array, residuals_mm: Array, along_mm: Array) -> FoundArm:
        """Find errors that displace the looks by `along_mm` (n, k) against their residuals."""
        both = np.column_stack([jacobian, residuals_mm, along_mm])
        sizes, known, gains = [], [], []
        for factor in model.factors:
            weighted = cho_solve(factor, both, check_finite=False)
            product = both.T @ weighted
            left = product - product[:, :POSE] @ np.linalg.solve(product[:POSE, :POSE], product[:POSE])
            by_pose = np.linalg.solve(product[:POSE, :POSE], weighted[:, :POSE].T)
            gains.append(weighted[:, POSE + 1 :].T - product[POSE + 1 :, :POSE] @ by_pose)
            sizes.append(-left[POSE + 1 :, POSE])  # a tool that is off by this records the opposite
            known.append(left[POSE + 1 :, POSE + 1 :])
        return cls(np.array(sizes), np.array(known), np.array(gains))

    def corrections_mm(self, at_target_mm: Array) -> Array:
        """Return how far (h, 3) to send the arm beside a target that the errors displace by (3, k)."""
        return np.asarray(-self.sizes @ at_target_mm.T)

    def covariances_mm2(self, at_target_mm: Array) -> Array:
        """Return the covariances (h, 3, 3) of these corrections, which the error at the target loses."""
        return np.asarray(at_target_mm @ self.known @ at_target_mm.T)
