"""Error of the arm at a target, as far as its looks at skin and spheres show it.

Looks from many sides see the head in places that contradict each other by what the arm errs between them. The
part that the target shares is made up for: little of it by skin that was pressed and swollen, half and more
by a phantom, most by spheres that are looked at in the posture of the target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from procedures.registration.surface.misfit import Adjustment, PoseMixture
from ronna_hw.arrays import Array


@dataclass(frozen=True, eq=False)
class FoundArm:
    """Errors (k) of the arm by an adjustment, under each component (c) of its mixture.

    `sizes` (c, k) are best linear unbiased predictions in standard deviations, `known` (c, k, k) the part of
    their covariance that the looks take away. `gains` (c, k, n) are the effects of the errors of the rows on
    the sizes.
    """

    sizes: Array
    known: Array
    gains: Array

    @classmethod
    def of(
        cls, adjustment: Adjustment, mixture: PoseMixture, residuals_mm: Array, along_mm: Array
    ) -> FoundArm:
        """Find errors that displace the looks by `along_mm` (n, k) against their residuals."""
        count, errors = len(mixture.weights), along_mm.shape[1]
        sizes, known = np.empty((count, errors)), np.empty((count, errors, errors))
        gains = np.empty((count, errors, len(along_mm)))
        for number in np.unique(mixture.hypothesis):
            one, chosen = adjustment.hypotheses[number], np.flatnonzero(mixture.hypothesis == number)
            rows = one.rows
            half = solve_triangular(
                one.factor, np.column_stack([residuals_mm, along_mm]), lower=True, check_finite=False
            )
            left = half - rows.pose @ (rows.by_pose @ half)  # what no movement explains
            for row in chosen:
                skin = rows.skin[:, mixture.region[row]]
                by_skin = half.T @ skin / rows.spread[mixture.region[row]] ** 0.5
                product = half.T @ left - np.outer(by_skin, by_skin)
                sizes[row] = -product[1:, 0]  # a tool that is off by this records the opposite
                known[row] = product[1:, 1:]
                beside = np.outer(by_skin[1:], skin) / rows.spread[mixture.region[row]] ** 0.5
                gains[row] = solve_triangular(
                    one.factor, left[:, 1:] - beside.T, lower=True, trans=1, check_finite=False
                ).T
        return cls(sizes, known, gains)

    def corrections_mm(self, at_target_mm: Array) -> Array:
        """Return how far (h, 3) to send the arm beside a target that the errors displace by (3, k)."""
        return np.asarray(-self.sizes @ at_target_mm.T)

    def covariances_mm2(self, at_target_mm: Array) -> Array:
        """Return the covariances (h, 3, 3) of these corrections, which the error at the target loses."""
        return np.asarray(at_target_mm @ self.known @ at_target_mm.T)
