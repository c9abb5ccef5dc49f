"""Arm under the names of CRTK, the convention of surgical robots in ROS: metres, radians, seconds.

    with theatre.arms["master"].active() as arm:
        crtk = Crtk(arm)
        crtk.move_jp(crtk.measured_js().position_rad).wait()
        print(crtk.measured_cp().position_m)

Positions are those of the flange in the base of the arm, by its nominal kinematics. What is measured is the
last that the arm has reported: nothing is asked, and a stamp of 0 means that there is none, or an old one.
There is no `servo_jp` or `servo_cp`: set-points are made and monitored by the arm's own process.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import ArmReading, Validity
from ronna_hw.devices.robot import JointMove, LineMove, Motion
from ronna_hw.vectors import JointVector, Quaternion, Vector3

if TYPE_CHECKING:
    from ronna_hw.devices.robot import RobotArm

MM_PER_M = 1000.0
NO_STAMP = 0.0
STATES = {Lifecycle.ACTIVE: "ENABLED", Lifecycle.HOLD: "PAUSED", Lifecycle.FAULT: "FAULT"}
DISABLED = "DISABLED"


class JointState(NamedTuple):
    """Joint angles; those of a stamp of 0 s are not valid."""

    stamp_s: float  # theatre time
    name: tuple[str, ...]
    position_rad: JointVector


class CartesianPose(NamedTuple):
    """Flange in the base of the arm; one with a stamp of 0 s is not valid."""

    stamp_s: float  # theatre time
    position_m: Vector3
    rotation_wxyz: Quaternion


class OperatingState(NamedTuple):
    """State of the arm: DISABLED, ENABLED, PAUSED or FAULT."""

    state: str
    is_homed: bool  # its encoders are absolute: as soon as it reports joints
    is_busy: bool


class MoveHandle:
    """Motion under way."""

    def __init__(self, arm: RobotArm, motion: Motion, timeout_s: float) -> None:
        self._error: Exception | None = None
        self._thread = threading.Thread(
            target=self._run, args=(arm, motion, timeout_s), name=f"{arm.name} move", daemon=True
        )
        self._thread.start()

    @property
    def is_busy(self) -> bool:
        return self._thread.is_alive()

    def wait(self) -> None:
        """Wait until the arm has settled at the target. Raises the errors of `RobotArm.move`."""
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _run(self, arm: RobotArm, motion: Motion, timeout_s: float) -> None:
        try:
            arm.move(motion, timeout_s=timeout_s)
        except Exception as error:  # it is the waiting thread's
            self._error = error


class Crtk:
    """Adapter over one arm. The arm stays usable directly."""

    def __init__(self, arm: RobotArm) -> None:
        self._arm = arm
        self._latest: MoveHandle | None = None

    def measured_js(self) -> JointState:
        """Return the measured joints."""
        reading, stamp_s = self._observe()
        return self._joints(stamp_s, None if reading is None else reading.joints_rad)

    def setpoint_js(self) -> JointState:
        """Return the commanded joints; there are none while nothing streams."""
        reading, stamp_s = self._observe()
        return self._joints(stamp_s, None if reading is None else reading.commanded_rad)

    def measured_cp(self) -> CartesianPose:
        """Return the measured pose of the flange."""
        measured = self.measured_js()
        if measured.stamp_s == NO_STAMP:
            return CartesianPose(NO_STAMP, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
        pose = self._arm.kinematics.forward(measured.position_rad)
        x, y, z = pose.position_mm
        return CartesianPose(measured.stamp_s, (x / MM_PER_M, y / MM_PER_M, z / MM_PER_M), pose.quaternion())

    def operating_state(self) -> OperatingState:
        """Return the state of the arm."""
        seen = self._arm.observe()
        reading = seen.reading
        moves = reading is not None and reading.moving
        is_busy = moves or (self._latest is not None and self._latest.is_busy)
        return OperatingState(STATES.get(seen.state, DISABLED), reading is not None, is_busy)

    def move_jp(self, position_rad: Sequence[float], *, timeout_s: float = 60.0) -> MoveHandle:
        """Begin a joint motion. Raises ARG-001 for no joint angles; `wait` raises the other errors."""
        return self._move(JointMove(position_rad), timeout_s)  # type: ignore[arg-type]  # it makes a tuple

    def move_cp(
        self, position_m: Sequence[float], rotation_wxyz: Sequence[float], *, timeout_s: float = 60.0
    ) -> MoveHandle:
        """Begin a straight line of the flange. Raises ARG-001, FRM-001; `wait` raises the other errors."""
        from ronna_hw.frames import Frame, Transform  # with NumPy and SciPy

        target = Transform.of(
            Frame.ROBOT,
            Frame.FLANGE,
            translation_mm=[value * MM_PER_M for value in position_m],
            quaternion_wxyz=rotation_wxyz,
        )
        return self._move(LineMove(target), timeout_s)

    def _move(self, motion: Motion, timeout_s: float) -> MoveHandle:
        self._latest = MoveHandle(self._arm, motion, timeout_s)
        return self._latest

    def _observe(self) -> tuple[ArmReading | None, float]:
        reading = self._arm.observe().reading
        is_valid = reading is not None and reading.validity is Validity.OK
        return reading, reading.stamp.theatre_time_s if is_valid and reading is not None else NO_STAMP

    def _joints(self, stamp_s: float, joints_rad: JointVector | None) -> JointState:
        names = tuple(self._arm.kinematics.axis_names)
        if joints_rad is None:
            return JointState(NO_STAMP, names, (0.0,) * len(names))
        return JointState(stamp_s, names, joints_rad)
