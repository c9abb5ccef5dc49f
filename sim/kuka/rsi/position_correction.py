"""POSCORR and POSCORRMON: corrections that move the tool centre point, clamped and monitored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import degrees

import numpy as np
from numpy.typing import NDArray

from ronna_hw.wire.kuka_context import (
    POSCORRMON_DEFAULT_MAX_ROTATION_DEG,
    POSCORRMON_DEFAULT_MAX_TRANSLATION_MM,
    PositionCorrection,
    PositionMonitor,
)
from sim.kuka.controller.messages import Message, near_singularity, out_of_range
from sim.world.nominal_arm import pose_of_frame
from sim.world.rigid import rotation_from_vector

Matrix = NDArray[np.float64]
ACTIVE_BIT = 1  # bit 0 of Stat; bits 1 to 3 mean X, Y, Z at a limit, bit 4 the rotation
ROTATION_BIT = 16
TOOL_REFERENCE = "Tool"


class PositionCorrector:
    """The two objects of one run, from RSI_ON on.

    `start` is the pose (4, 4) of the tool centre point at RSI_ON and `reference` the rotation (3, 3) of the
    correction system, both in $ROBROOT. `inverse` finds joints (deg) for a pose, near given joints.
    """

    def __init__(
        self,
        start: Matrix,
        reference: Matrix,
        base_deg: Sequence[float],
        inverse: Callable[[Matrix, Sequence[float]], list[float] | None],
        correction: PositionCorrection | None,
        monitor: PositionMonitor | None,
        *,
        relative: bool,
    ) -> None:
        self._limits = correction or PositionCorrection()
        self._largest_mm = monitor.max_translation_mm if monitor else POSCORRMON_DEFAULT_MAX_TRANSLATION_MM
        self._largest_deg = monitor.max_rotation_deg if monitor else POSCORRMON_DEFAULT_MAX_ROTATION_DEG
        self._start = start
        self._reference = start[:3, :3] if self._limits.reference == TOOL_REFERENCE else reference
        self._inverse = inverse
        self._relative = relative
        self._shift_mm = np.zeros(3)
        self._turn = np.eye(3)
        self._base_deg = list(base_deg)
        self.joints_deg: list[float] = self._base_deg
        self.stat = 0

    def take(self, inputs: Sequence[float]) -> Message | None:
        """Apply one cycle's X Y Z (mm) A B C (deg); a message if a monitor trips or no joints are found."""
        step = pose_of_frame(inputs)
        shift_mm = step[:3, 3] + self._shift_mm if self._relative else step[:3, 3]
        turn = step[:3, :3] @ self._turn if self._relative else step[:3, :3]
        self._shift_mm = np.clip(shift_mm, self._limits.lower_mm, self._limits.upper_mm)
        self._turn = self._limited(turn)
        self.stat = ACTIVE_BIT
        for number in range(3):
            if self._shift_mm[number] != shift_mm[number]:
                self.stat |= 2 << number
        if self._turn is not turn:
            self.stat |= ROTATION_BIT
        distance_mm = float(np.linalg.norm(self._shift_mm))
        if distance_mm > self._largest_mm:
            return out_of_range("POSCORRMON", "translation", distance_mm, self._largest_mm)
        angle_deg = degrees(_angle(self._turn))
        if angle_deg > self._largest_deg:
            return out_of_range("POSCORRMON", "rotation", angle_deg, self._largest_deg)
        if distance_mm == 0.0 and angle_deg == 0.0:
            self.joints_deg = self._base_deg  # exact, unlike the result of an iteration
            return None
        goal = self._start.copy()
        goal[:3, 3] += self._reference @ self._shift_mm
        goal[:3, :3] = self._reference @ self._turn @ self._reference.T @ goal[:3, :3]
        joints = self._inverse(goal, self.joints_deg)
        if joints is None:
            return near_singularity()
        self.joints_deg = joints
        return None

    def _limited(self, turn: Matrix) -> Matrix:
        angle_deg = degrees(_angle(turn))
        if angle_deg <= self._limits.max_rotation_deg:
            return turn
        vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        unit = vector / np.linalg.norm(vector)
        return rotation_from_vector(unit * np.radians(self._limits.max_rotation_deg))


def _angle(rotation: Matrix) -> float:
    """Angle of a rotation matrix, rad; exact near zero as well."""
    vector = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    return float(np.arctan2(np.linalg.norm(vector), np.trace(rotation) - 1.0))
