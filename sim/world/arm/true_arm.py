"""The arm as it really is: the flange pose for given encoder angles.

The controller relies on its encoders and the nominal chain. The true flange differs by link errors, and by
errors between encoder and joint: offset, two harmonics per turn, sag under gravity, backlash. An arm that has
moved for long is warm, which displaces the flange. At rest there is also a repeatability error: a small one
that depends on the number of the motion only.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, exp, sin

import numpy as np
from numpy.typing import NDArray

from sim.world.arm.joint_chain import JointChain
from sim.world.arm.robot_description import description
from sim.world.noise import noise
from sim.world.scene.model import ArmTruth

Matrix = NDArray[np.float64]
DEVICE = "arm"  # key of the noise
DRIFT = "arm warmth"  # key of the direction of thermal displacement
# The backlash of a joint is the full play on a reversal: it rests half of it to either side.
FLANK_SHARE = 0.5


class TrueArm:
    """From encoder angles, flanks and motion number to the true pose of the flange."""

    def __init__(self, truth: ArmTruth, seed: int) -> None:
        arm = description(truth.variant)
        self._chain = JointChain(arm, truth.links)
        self._seed = seed
        self._repeatability_mm = truth.repeatability_mm
        direction = noise(seed, DRIFT, 0).normal(size=3)
        self._drift_mm = truth.thermal_drift_mm * direction / np.linalg.norm(direction)
        self._drifts = truth.thermal_drift_mm > 0.0
        self._thermal_time_s = truth.thermal_time_s
        self._sag_rad = truth.sag_rad
        self._upper_mm = arm.joints[2].origin_mm[0]
        self._fore_mm = arm.joints[4].origin_mm[0]
        self._joints = tuple(
            zip(
                truth.joint_offset_rad,
                truth.harmonic_1_rad,
                truth.harmonic_1_phase_rad,
                truth.harmonic_2_rad,
                truth.harmonic_2_phase_rad,
                (FLANK_SHARE * value for value in truth.backlash_rad),
                strict=True,
            )
        )

    def moving(self, encoders_rad: Sequence[float], flanks: Sequence[float], moved_s: float = 0.0) -> Matrix:
        """Pose (4, 4) while moving; `flanks` is each joint's position in its backlash, -1 to 1.

        `moved_s` is how long the arm has moved so far.
        """
        pose = self._chain.flange(self._joint_angles(encoders_rad, flanks))
        if self._drifts:
            pose[:3, 3] += (1.0 - exp(-moved_s / self._thermal_time_s)) * self._drift_mm
        return pose

    def at_rest(
        self,
        encoders_rad: Sequence[float],
        flanks: Sequence[float],
        motion_number: int,
        moved_s: float = 0.0,
    ) -> Matrix:
        """Pose (4, 4) at rest after the motion with this number."""
        pose = self.moving(encoders_rad, flanks, moved_s)
        error_mm = noise(self._seed, DEVICE, motion_number).normal(0.0, self._repeatability_mm, 3)
        # Any mounted tool is displaced like the flange.
        pose[:3, 3] += error_mm
        return pose

    def _joint_angles(self, encoders_rad: Sequence[float], flanks: Sequence[float]) -> list[float]:
        angles = [
            angle + offset + first * sin(angle + phase_1) + second * sin(2.0 * angle + phase_2) + half * flank
            for angle, flank, (offset, first, phase_1, second, phase_2, half) in zip(
                encoders_rad, flanks, self._joints, strict=True
            )
        ]
        # Positive angles of both axes lower the arm. The moment about an axis grows with the horizontal
        # distance of its load: full when stretched out, zero upright, reversed behind the axis.
        fore = cos(encoders_rad[1] + encoders_rad[2])
        upper = cos(encoders_rad[1])
        stretch = (self._upper_mm * upper + self._fore_mm * fore) / (self._upper_mm + self._fore_mm)
        angles[1] += self._sag_rad[0] * stretch
        angles[2] += self._sag_rad[1] * fore
        return angles
