"""PTP_AXIS, PTP_POS and LIN of the project's channel: from a command's attributes to a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import inf

from ronna_hw.wire.kuka_eki import AckCode, OperationMode
from sim.kuka.controller.controller import FULL_OVERRIDE, Controller
from sim.kuka.controller.messages import Message
from sim.kuka.eki.acknowledgement import Acknowledgement
from sim.kuka.eki.attributes import axes, frame, number, share, whole
from sim.kuka.eki.motion import EkiMotion, line, point_to_point
from sim.world.nominal_arm import pose_of_frame

ACCEPTED = Acknowledgement(AckCode.OK, "accepted")
FASTEST_LINE_M_S = 2.0  # $VEL.CP of this arm
SLOWEST_LINE_M_S = 1e-6
T1_MARGIN = 0.95  # of the tool speed allowed in T1: the path is checked in steps
SMALLEST_TRAVEL_MM = 1e-3  # a turn about the tool centre point
STATUS_LIMIT, TURN_LIMIT = 64, 64  # S and T have six bits


class EkiMoves:
    """Starts motions; `ended` is called with each outcome."""

    def __init__(self, controller: Controller, ended: Callable[[Acknowledgement], None]) -> None:
        self._controller = controller
        self._ended = ended

    def ptp_axis(self, given: Mapping[str, str]) -> Acknowledgement:
        """A1..A6 (deg), Vel and Acc (percent)."""
        return self._point_to_point(axes(given), given)

    def ptp_pos(self, given: Mapping[str, str]) -> Acknowledgement:
        """X..C (mm, deg) in BASE, S, T, Tool, Base, Vel and Acc (percent)."""
        pose = pose_of_frame(frame(given))
        status, turn = whole(given, "S"), whole(given, "T")
        if not (0 <= status < STATUS_LIMIT and 0 <= turn < TURN_LIMIT):
            raise ValueError("S and T are bits of the posture")
        refusal = self._prepared(given)
        if refusal is not None:
            return refusal
        controller = self._controller
        goal = controller.arm.axes_in_posture(pose, status ^ controller.parameters.inverted_status, turn)
        if goal is None:
            return Acknowledgement(AckCode.LIMIT, f"out of reach in the posture S {status} T {turn}")
        return self._point_to_point(goal, given)

    def lin(self, given: Mapping[str, str]) -> Acknowledgement:
        """X..C (mm, deg) in BASE, Tool, Base, Vel (m/s); S and T have no meaning on a line."""
        pose = pose_of_frame(frame(given))
        speed_m_s = number(given, "Vel")
        if not SLOWEST_LINE_M_S <= speed_m_s <= FASTEST_LINE_M_S:
            raise ValueError(f"Vel must be {SLOWEST_LINE_M_S} to {FASTEST_LINE_M_S} m/s")
        refusal = self._prepared(given)
        if refusal is not None:
            return refusal
        controller = self._controller
        arm, parameters = controller.arm, controller.parameters
        goal = arm.base @ pose
        if arm.joints_on_the_way(goal) is None:
            return Acknowledgement(AckCode.LIMIT, "no straight path to that pose")
        speed_mm_s = speed_m_s * 1000.0 * controller.override_percent / FULL_OVERRIDE
        if controller.interlocks.mode is OperationMode.T1:
            speed_mm_s = min(speed_mm_s, T1_MARGIN * parameters.T1_tool_speed_mm_s)
        return self._begin(
            line(
                arm.description,
                arm.tool_point(),
                goal,
                arm.axes_deg,
                arm.joints_for,
                speed_mm_s,
                parameters,
                controller.cycle_ms / 1000.0,
            )
        )

    def _point_to_point(self, goal_deg: list[float], given: Mapping[str, str]) -> Acknowledgement:
        speed, acceleration = share(given, "Vel"), share(given, "Acc")
        controller = self._controller
        ready = controller.ready()
        if ready.code is not AckCode.OK:
            return ready
        for joint, angle in zip(controller.arm.description.joints, goal_deg, strict=True):
            if not joint.lower_deg <= angle <= joint.upper_deg:
                return Acknowledgement(AckCode.LIMIT, f"{joint.name} {angle:.3f} is beyond its end switch")
        speed *= controller.override_percent / FULL_OVERRIDE
        arm, cycle_s, fastest_1_s = controller.arm, controller.cycle_ms / 1000.0, inf
        if controller.interlocks.mode is OperationMode.T1:
            parameters = controller.parameters
            speed *= parameters.T1_axis_speed_share
            travel_mm = max(arm.tool_travel_mm(goal_deg), SMALLEST_TRAVEL_MM)
            fastest_1_s = T1_MARGIN * parameters.T1_tool_speed_mm_s / travel_mm
        return self._begin(
            point_to_point(arm.description, arm.axes_deg, goal_deg, speed, acceleration, cycle_s, fastest_1_s)
        )

    def _prepared(self, given: Mapping[str, str]) -> Acknowledgement | None:
        """Activate the tool and base of a motion if it may start; otherwise the reason why not."""
        controller = self._controller
        ready = controller.ready()
        if ready.code is not AckCode.OK:
            return ready
        frames = controller.frames
        frames.use(whole(given, "Tool", frames.tool_number), whole(given, "Base", frames.base_number))
        return None

    def _begin(self, points: Iterator[list[float] | Message]) -> Acknowledgement:
        self._controller.move(EkiMotion(points, self._ended))
        return ACCEPTED
