"""Micro-move test of an unverified controller's response to corrections.

Each axis moves out and back so little that nothing on the arm moves by more than 0.05 mm. The last axis comes
first: it moves almost nothing, and a controller that accumulates corrections is exposed there.
"""

from __future__ import annotations

from dataclasses import replace
from math import degrees, dist, radians
from typing import NoReturn

from drivers.kuka_rsi.errors import HANDSHAKE_FAILED, STREAM_ERRORS
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm_stream.client import LinkClient
from ronna_hw.arm_stream.records import LinkState, MotionResult, Move, StopOrder
from ronna_hw.vectors import JointVector

# Safety against a controller whose axes are not what they are taken for (U).
LARGEST_SHIFT_MM = 0.05

REACH_BEYOND_FLANGE_MM = 150.0  # for a tool: nothing on the arm may move farther than the limit
# Safety against a controller whose axes are not what they are taken for (U).
LARGEST_ANGLE_RAD = radians(0.02)

SLOW_FRACTION = 0.1  # of the working speed
STRAY_RAD = radians(0.002)  # for an axis that should not move: twenty digits of the wire
FOLLOWED_SHARE = 0.75  # share of the commanded angle that must be measured
POLL_S = 0.002  # host time between checks of the measured axes
AXIS_LIMIT_CYCLES = 500  # for one axis to move and settle: about five times what it takes
TELEGRAMS_LIMIT_S = 10.0  # host time
CYCLES_WATCHED = 25  # before anything moves
PROBE_RAD = 1e-4


class MicroMove:
    """Micro-move test of one arm; any stop beyond the first `stop_count` interrupts it."""

    def __init__(
        self, name: str, link: LinkClient, kinematics: Kinematics, limits: MotionLimits, stop_count: int
    ) -> None:
        self._name = name
        self._link = link
        self._kinematics = kinematics
        # An axis close to an end of its range moves away from it.
        self._limits = replace(limits.slowed(SLOW_FRACTION), range_margin_rad=0.0)
        self._stops = stop_count

    def verify(self) -> None:
        """Move each axis out and back and check the measured response.

        Raises RSI-018 when the cycle differs or an axis does not move exactly as commanded, RSI-010 when more
        than `stop_count` stops have been ordered, and RSI-007 when the real-time process has ended. The
        caller then ends the stream, since accumulating corrections continue as long as they are sent.
        """
        self._require_cycle()
        start = self._link.state.commanded_rad
        for axis in reversed(range(len(AXIS_NAMES))):
            angle = micro_angle(self._kinematics, start, axis)
            self._move_and_watch(start, _with_axis_moved(start, axis, angle), axis)
            moved_rad = self._link.state.measured_rad[axis] - start[axis]
            if not FOLLOWED_SHARE * abs(angle) <= abs(moved_rad) <= abs(angle) + STRAY_RAD:
                self._refuse(f"{AXIS_NAMES[axis]} moved by {degrees(moved_rad):.4f} deg", angle)
            self._move_and_watch(start, start, axis)

    def _require_cycle(self) -> None:
        initial = self._link.state
        seen = self._link.wait(lambda s: s.cycles >= initial.cycles + CYCLES_WATCHED, TELEGRAMS_LIMIT_S)
        if seen is None or seen.lost - initial.lost >= CYCLES_WATCHED:
            lost = "no telegrams" if seen is None else f"{seen.lost - initial.lost} cycles lost by IPOC"
            raise HANDSHAKE_FAILED(
                f"{self._name}: the cycle differs: {lost} within {CYCLES_WATCHED} telegrams"
            )

    def _move_and_watch(self, start: JointVector, target: JointVector, axis: int) -> None:
        link = self._link
        plan = plan_joint_move(self._kinematics, link.state.commanded_rad, target, self._limits)
        number = link.command(Move(plan), self._stops)
        initial_cycles = link.state.cycles
        while True:
            state = link.state
            self._require_small(state, start, axis)
            if state.fault or (state.command_number >= number and state.result is not MotionResult.RUNNING):
                break
            if state.cycles - initial_cycles > AXIS_LIMIT_CYCLES:
                self._refuse(f"{AXIS_NAMES[axis]} does not settle", LARGEST_ANGLE_RAD)
            if not link.alive:  # no cycle will come, and no fault
                raise link.death_error()
            if link.stalled_s > TELEGRAMS_LIMIT_S:
                self._refuse(f"no telegram was answered for {link.stalled_s:.1f} s", LARGEST_ANGLE_RAD)
            link.wait(lambda _: False, POLL_S)  # theatre time passes meanwhile
        if state.result in (MotionResult.STOPPED, MotionResult.REFUSED_STOP) and not state.fault:
            raise STREAM_ERRORS.stopped(
                f"{self._name}: stopped while {AXIS_NAMES[axis]} was tested",
                action="Acknowledge the arm and start it again: what it does with corrections is not "
                "verified.",
            )
        if state.fault or state.result is not MotionResult.DONE:
            self._refuse(f"{AXIS_NAMES[axis]} was stopped: {state.fault.name} {state.result.name}", 0.0)

    def _require_small(self, state: LinkState, start: JointVector, axis: int) -> None:
        for number, (measured_rad, start_rad) in enumerate(zip(state.measured_rad, start, strict=True)):
            allowed_rad = STRAY_RAD + (LARGEST_ANGLE_RAD if number == axis else 0.0)
            if abs(moved_rad := measured_rad - start_rad) > allowed_rad:
                motion_text = f"{AXIS_NAMES[number]} moved by {degrees(moved_rad):.4f} deg"
                self._refuse(f"{motion_text} while {AXIS_NAMES[axis]} was commanded", allowed_rad)

    def _refuse(self, what: str, limit_rad: float) -> NoReturn:
        self._link.stop(StopOrder.HOLD)
        raise HANDSHAKE_FAILED(
            f"{self._name}: the controller does not move as commanded: {what}",
            limit=f"{degrees(limit_rad):.4f} deg",
        )


def micro_angle(kinematics: Kinematics, joints_rad: JointVector, axis: int) -> float:
    """Return a rotation towards mid-range that displaces flange and tool point by at most 0.05 mm."""
    tool_point_mm = (0.0, 0.0, REACH_BEYOND_FLANGE_MM)
    start_pose = kinematics.forward(joints_rad)
    moved_pose = kinematics.forward(_with_axis_moved(joints_rad, axis, PROBE_RAD))
    moved_mm = max(
        dist(start_pose.position_mm, moved_pose.position_mm),
        dist(start_pose.apply(tool_point_mm), moved_pose.apply(tool_point_mm)),
    )
    angle = min(LARGEST_ANGLE_RAD, LARGEST_SHIFT_MM * PROBE_RAD / max(moved_mm, 1e-9))
    middle = 0.5 * (kinematics.lower_rad[axis] + kinematics.upper_rad[axis])
    return angle if joints_rad[axis] <= middle else -angle


def _with_axis_moved(joints_rad: JointVector, axis: int, angle_rad: float) -> JointVector:
    return tuple(a + angle_rad * (k == axis) for k, a in enumerate(joints_rad))
