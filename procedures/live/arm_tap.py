"""Tap of one arm: every cycle of its stream from shared memory, otherwise its last known joints.

It asks nothing of the device. On a clock that devices advance, a cycle's theatre time follows the
controller's clock between two looks.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from procedures.live.case_frames import base_frame, flange_frame
from procedures.live.log_entries import ArmDrawing, JointCycles, LogEntry
from procedures.live.records import ArmJoints, FramePose
from ronna_hw.arm import urdf
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.devices.capabilities import RecordsCycles, StreamCycles
from ronna_hw.devices.readings import ArmReading, Validity
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import joint_vector

if TYPE_CHECKING:
    from collections.abc import Callable

    from procedures.workcell.supervised_arm import SupervisedArm
    from ronna_hw.arrays import Array
    from ronna_hw.clock import Clock
    from ronna_hw.devices import RobotArm

POSES_PER_S = 60.0  # theatre time; of the flange
OBSERVED_EACH_S = 0.1  # host time, while nothing streams


class ArmTap:
    """Cycles and poses of one arm since the last look."""

    def __init__(
        self, supervised: SupervisedArm, arm: RobotArm, now_s: Callable[[], float], clock: Clock
    ) -> None:
        self.role = supervised.role
        self._supervised = supervised
        self._arm = arm
        self._now_s = now_s
        self._paced = clock.paced
        self._seen_ns = time.monotonic_ns()  # arrival of the last cycle
        self._anchor = 0, 0.0  # its device clock and theatre time
        self._slot = -1.0  # of the last pose
        self._observed_at_s = 0.0
        self._observed: ArmReading | None = None
        self.latest_pose: FramePose | None = None
        self.latest_joints: ArmJoints | None = None

    def look(self) -> list[LogEntry]:
        """Return what is new, for the log; the latest joints and pose are kept."""
        cycles = self._arm.cycles_since(self._seen_ns) if isinstance(self._arm, RecordsCycles) else None
        if cycles is not None and len(cycles.received_ns):
            return self._take(self._timed(cycles))
        now_s = time.monotonic()
        if now_s - self._observed_at_s < OBSERVED_EACH_S:
            return []
        self._observed_at_s = now_s
        return self._take_reading(self._arm.observe().reading)

    def _take_reading(self, reading: ArmReading | None) -> list[LogEntry]:
        former, shown = self._observed, self.latest_pose
        if reading is not None and reading.validity is not Validity.OK:
            if shown is None or shown.validity is reading.validity:
                return []
            gone = {"rotation": None, "translation_mm": None, "validity": reading.validity}
            self.latest_pose, self._observed = shown.model_copy(update=gone), None
            return [self.latest_pose]
        if reading is None:
            return []
        if former is not None and former.joints_rad == reading.joints_rad:
            return []
        self._observed = reading
        measured = np.array([reading.joints_rad])
        commanded = None if reading.commanded_rad is None else np.array([reading.commanded_rad])
        # On a clock that devices advance, an age in host time says nothing.
        times_s = np.array([reading.stamp.theatre_time_s if self._paced else self._now_s()])
        return self._take(JointCycles(self.role, self._axes, times_s, measured, commanded))

    def draw(self) -> list[LogEntry]:
        """Return the arm as a viewer draws it, if its kind is known."""
        with suppress(RonnaError):
            return [ArmDrawing(self._now_s(), urdf.write_urdf(find_arm(self._arm.kinematics.name)))]
        return []

    @property
    def _axes(self) -> tuple[str, ...]:
        return tuple(map(urdf.joint_name, self._arm.kinematics.axis_names))

    def _timed(self, cycles: StreamCycles) -> JointCycles:
        """Give cycles their theatre times. The first ones after a pause only show where the next begin."""
        now_s, now_ns = self._now_s(), time.monotonic_ns()
        received, clock = cycles.received_ns, cycles.device_clock.astype(np.int64)
        self._seen_ns = int(received[-1])
        (before, before_s), self._anchor = self._anchor, (int(clock[-1]), now_s)
        if self._paced:
            times_s = now_s - (now_ns - received) / 1e9
        elif before < int(clock[0]) and before_s:
            share = (clock - before) / (clock[-1] - before)
            times_s = before_s + (now_s - before_s) * share
        else:
            times_s = np.array([now_s])
        n = len(times_s)
        measured, commanded = cycles.measured_rad[-n:], cycles.commanded_rad[-n:]
        return JointCycles(self.role, self._axes, times_s, measured, commanded)

    def _take(self, cycles: JointCycles) -> list[LogEntry]:
        slots = np.floor(cycles.times_s * POSES_PER_S)
        posed = np.flatnonzero(np.diff(slots, prepend=self._slot) > 0)
        self._slot = float(slots[-1])
        last = len(slots) - 1
        rows = posed if len(posed) and posed[-1] == last else np.append(posed, last)
        poses = self._poses(cycles.times_s[rows], cycles.measured_rad[rows])
        self.latest_pose = poses[-1]
        measured = joint_vector(cycles.measured_rad[-1].tolist())
        commanded = cycles.commanded_rad
        self.latest_joints = ArmJoints(
            theatre_time_s=float(cycles.times_s[-1]),
            arm=self.role,
            measured_rad=measured,
            commanded_rad=None if commanded is None else joint_vector(commanded[-1].tolist()),
        )
        return [cycles, *poses[: len(posed)]]

    def _poses(self, times_s: Array, joints_rad: Array) -> Sequence[FramePose]:
        poses = self._supervised.calibrated.forward_each(joints_rad)
        return [
            FramePose(
                theatre_time_s=at_s,
                parent=base_frame(self.role),
                child=flange_frame(self.role),
                rotation=pose.quaternion(),
                translation_mm=pose.position_mm,
            )
            for at_s, pose in zip(times_s.tolist(), poses, strict=True)
        ]
