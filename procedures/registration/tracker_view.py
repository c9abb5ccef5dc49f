"""Spheres as the tracker sees them, whose errors are none of the arm's.

Its volumetric accuracy is some tenths of a millimetre, too poor for a registration. A sphere that is a
millimetre off its place in the CT still shows beside the others. Errors of the CT are the same for tracker
and looks, so both are weighed at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from procedures.registration.arm_adjustment import PlannedAdjustment
from procedures.registration.rigid_fit import fit_rigid, pose_jacobian
from procedures.registration.target_prediction import AXES
from ronna_hw.arrays import Array


@dataclass(frozen=True, eq=False)
class TrackerView:
    """Residuals (n, 3) mm of the spheres as seen, from a nearby pose of the head that has them at points."""

    residuals_mm: Array
    points_mm: Array  # (n, 3)
    own_mm2: Array  # (n, 3, 3) of the tracker's errors
    common_mm2: Array  # (3n, 3n) of the errors that looks at the spheres have too

    @classmethod
    def of(cls, image_mm: Array, seen_mm: Array, own_mm2: Array, common_mm2: Array) -> Self:
        """Compare spheres (n, 3) mm in the CT with those seen, errors in the frame of these."""
        fit = fit_rigid(image_mm, seen_mm)
        mapped_mm = image_mm @ fit.rotation.T + fit.translation_mm
        return cls(seen_mm - mapped_mm, mapped_mm, own_mm2, common_mm2)

    def weigh_with(self, planned: PlannedAdjustment, rows: Sequence[Sequence[int]]) -> Array:
        """Return weights (h, 3m + 3n, 3m + 3n) of looks and view, excluding what a pose of each explains.

        `rows` are the looks at each sphere.
        """
        looks, spheres = len(planned.points_mm), len(self.points_mm)
        by_sphere = self.common_mm2.reshape(spheres, AXES, -1)
        shared = np.zeros((looks, AXES, AXES * spheres))
        for one, own in zip(by_sphere, rows, strict=True):
            shared[list(own)] = one
        cross, seen = shared.reshape(AXES * looks, -1), self.common_mm2 + block_diag(*self.own_mm2)
        pose = block_diag(*(_pose_columns(one) for one in (planned.points_mm, self.points_mm)))
        weights = []
        for information in planned.informations:
            weight = np.linalg.inv(np.block([[np.linalg.inv(information), cross], [cross.T, seen]]))
            on_pose = weight @ pose
            weights.append(weight - on_pose @ np.linalg.solve(pose.T @ on_pose, on_pose.T))
        return np.array(weights)


def _pose_columns(points_mm: Array) -> Array:
    return pose_jacobian(points_mm, points_mm.mean(axis=0)).reshape(-1, 6)
