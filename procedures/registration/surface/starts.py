"""Start of a surface registration: a stated pose, or landmarks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.points import validate_pairs
from procedures.registration.rigid_fit import fit_rigid
from procedures.registration.surface.errors import BAD_SURFACE_INPUT
from procedures.registration.surface.settling import Pose
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform

LANDMARK_SD_MM = 3.0  # of a landmark found with a pointer on skin, each axis (U)


@dataclass(frozen=True, eq=False)
class Start:
    """Approximate pose robot <- CT, with standard deviations of its turn and of its place at the head.

    `landmarks_ct_mm` (n, 3) are those that it was fitted to, if any; `place_mm` is then theirs, per axis.
    """

    robot_from_ct: Transform
    turn_rad: float
    place_mm: float
    landmarks_ct_mm: Array | None = None

    def __post_init__(self) -> None:
        if not (
            np.isfinite([self.turn_rad, self.place_mm]).all() and min(self.turn_rad, self.place_mm) > 0.0
        ):
            raise BAD_SURFACE_INPUT("the error of a start must be positive and finite")

    @classmethod
    def from_landmarks(cls, ct_mm: ArrayLike, robot_mm: ArrayLike, sd_mm: float = LANDMARK_SD_MM) -> Start:
        """Fit at least three landmarks, in the same order in both frames. Raises REG-001, 002, 004."""
        image, physical = validate_pairs(ct_mm, robot_mm)
        fit = fit_rigid(image, physical)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = fit.rotation, fit.translation_mm
        spread_mm = float(np.linalg.svd(image - image.mean(axis=0), compute_uv=False)[1])
        pose = Transform.from_matrix(Frame.ROBOT, Frame.CT, matrix)
        return cls(pose, sd_mm / spread_mm, sd_mm, image)


def pose_of(start: Start) -> Pose:
    """Return the pose CT <- robot of a start."""
    ct_from_robot = start.robot_from_ct.inverse().as_matrix()
    return Pose(ct_from_robot[:3, :3], ct_from_robot[:3, 3])
