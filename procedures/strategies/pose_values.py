"""Six values of a tool pose: place, and the angles of turns about z, y and x, as the thesis has them (5.4).

The last axis is the guide's. Entry and target then fix five values, and gamma alone is free: it differs from
the free angle of the trajectory by a constant.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.strategies.trajectory import Point, require_frames, tool_pose
from ronna_hw.frames import Frame, Transform

# The guide's axis is z of the tool frame, and x of the frame that the angles turn.
TOOL_FROM_TURNED = Rotation.from_matrix([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
VERTICAL_COSINE = 1e-9  # of beta: below it the turns about z and x have one axis, up to rounding


class PoseValues(NamedTuple):
    """Place of the tool origin in mm, and angles in rad of turns about z, the new y and the newest x.

    If the guide points straight up or down, both turn about one axis: alpha is then 0.
    """

    x_mm: float
    y_mm: float
    z_mm: float
    alpha_rad: float
    beta_rad: float
    gamma_rad: float

    @classmethod
    def of(cls, pose: Transform) -> Self:
        """Return the values of a pose ROBOT <- TOOL. Raises FRM-001 for other frames."""
        require_frames(pose, Frame.ROBOT, Frame.TOOL)
        x_mm, y_mm, z_mm = pose.translation_mm.tolist()
        turned = (pose.rigid.rotation * TOOL_FROM_TURNED).as_matrix()
        cosine = math.hypot(turned[0, 0], turned[1, 0])
        beta = math.atan2(-turned[2, 0], cosine)
        if cosine < VERTICAL_COSINE:
            return cls(x_mm, y_mm, z_mm, 0.0, beta, math.atan2(-turned[1, 2], turned[1, 1]))
        alpha = math.atan2(turned[1, 0], turned[0, 0])
        return cls(x_mm, y_mm, z_mm, alpha, beta, math.atan2(turned[2, 1], turned[2, 2]))

    @property
    def place_mm(self) -> Point:
        return self.x_mm, self.y_mm, self.z_mm

    @property
    def angles_deg(self) -> tuple[float, float, float]:
        """Alpha, beta and gamma in degrees."""
        return math.degrees(self.alpha_rad), math.degrees(self.beta_rad), math.degrees(self.gamma_rad)

    @property
    def pose(self) -> Transform:
        """Pose ROBOT <- TOOL with these values."""
        turned = Rotation.from_euler("ZYX", (self.alpha_rad, self.beta_rad, self.gamma_rad))
        return tool_pose(turned * TOOL_FROM_TURNED.inv(), np.array(self.place_mm))
