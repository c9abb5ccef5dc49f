"""Errors that an arm keeps after its calibration: as its record states them, and as looks have found them.

They are the same in all postures, so what is seen in some of them predicts the others nearby. In standard
deviations of the record, they are independent and of unit variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.strategies.strategy import Sides
from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import ErrorSizes, unit_errors
from ronna_hw.frames import Transform, build_rigid
from ronna_hw.vectors import JointVector


@dataclass(frozen=True, eq=False)
class StatedArm:
    """An arm with the sizes of the errors that it keeps."""

    chain: Chain
    sizes: ErrorSizes

    def displacements(self, joints_rad: ArrayLike, points_mm: ArrayLike, arrived: Sides) -> Array:
        """Return displacements (p, 3, k) mm of points (p, 3) mm on its flange by a unit of each error.

        In the base of the arm; `joints_rad` is (p, axes), which `arrived` from these sides.
        """
        joints = np.asarray(joints_rad, dtype=float)
        sides = np.zeros_like(joints)
        if arrived is not None:
            sides[:] = arrived
        return unit_errors(self.chain, joints, np.asarray(points_mm, dtype=float), self.sizes, sides)


@dataclass(frozen=True, eq=False)
class FoundArm:
    """An arm with its errors (k,) as found, in standard deviations of its record."""

    stated: StatedArm
    errors: tuple[float, ...]

    def displace(
        self,
        tool: Transform,
        joints_rad: JointVector,
        arrived: Sides,
        along_mm: tuple[float, float],
    ) -> Transform:
        """Return where a tool really is whose pose without these errors, in the base of the arm, is `tool`.

        Two places on its z axis, `along_mm` from its origin, tell its shift and its tilt; it is not turned
        about that axis.
        """
        places_mm = tool.apply([(0.0, 0.0, z_mm) for z_mm in along_mm])
        moved_mm = self.stated.displacements([joints_rad] * 2, places_mm, arrived) @ np.array(self.errors)
        first_mm, second_mm = along_mm
        slope = (moved_mm[1] - moved_mm[0]) / (second_mm - first_mm)
        rotation = Rotation.from_rotvec(np.cross(tool.rotation_matrix[:, 2], slope)) * tool.rigid.rotation
        origin_mm = places_mm[0] + moved_mm[0] - rotation.apply((0.0, 0.0, first_mm))
        return Transform(tool.target, tool.source, build_rigid(origin_mm, rotation))
