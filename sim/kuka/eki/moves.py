"""Motion commands of the project's EKI channel (PTP_AXIS, PTP_POS, LIN) and strict attribute parsing."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from math import inf

from ronna_hw.wire.kuka_eki import AXIS_ATTRIBUTES, POS_ATTRIBUTES, AckCode, OperationMode
from sim.kuka.controller import FULL_OVERRIDE, Controller
from sim.kuka.motion import Acknowledgement, EkiMotion, line, point_to_point
from sim.kuka.pendant import PendantMessage
from sim.world.nominal_arm import pose_of_frame

LARGEST = 1e6  # mm or degrees: a pose far out of reach, whose squares are still numbers
LEAST_PERCENT = 0.001  # smallest speed: a motion that never ends has no duration
FRAME = POS_ATTRIBUTES[:6]
_ESCAPED = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": " ", "\r": " "})

ACCEPTED = Acknowledgement(AckCode.OK, "accepted")
FASTEST_LINE_M_S = 2.0  # $VEL.CP of this arm
SLOWEST_LINE_M_S = 1e-6
T1_MARGIN = 0.95  # share of T1's tool speed that is used: the path is checked in steps
SMALLEST_TRAVEL_MM = 1e-3  # a turn about the tool centre point
STATUS_LIMIT, TURN_LIMIT = 64, 64  # S and T have six bits


def integer(arguments: Mapping[str, str], name: str, default: int | None = None) -> int:
    """Parse an integer; raises ValueError if it is malformed, or required but missing."""
    if default is not None and name not in arguments:
        return default
    try:
        return int(arguments[name])
    except (KeyError, ValueError):
        raise ValueError(f"{name} is missing or not an integer") from None


def flag(arguments: Mapping[str, str], name: str) -> bool:
    """Parse 0 or 1; raises ValueError for anything else."""
    if arguments.get(name) not in ("0", "1"):
        raise ValueError(f"{name} is 0 or 1")
    return arguments[name] == "1"


def number(arguments: Mapping[str, str], name: str, default: float | None = None) -> float:
    """Parse a number up to `LARGEST` in magnitude; raises ValueError if invalid or required but missing."""
    if default is not None and name not in arguments:
        return default
    try:
        value = float(arguments[name])
    except (KeyError, ValueError):
        value = float("nan")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{name} is missing or not a number up to {LARGEST:g}")
    return value


def share(arguments: Mapping[str, str], name: str) -> float:
    """Parse a percentage up to 100 and return it as a fraction, or 1 if missing."""
    value = number(arguments, name, 100.0)
    if not LEAST_PERCENT <= value <= 100.0:
        raise ValueError(f"{name} must be a percentage from {LEAST_PERCENT} to 100")
    return value / 100.0


def frame(arguments: Mapping[str, str]) -> list[float]:
    """Parse X Y Z (mm) A B C (deg)."""
    return [number(arguments, name) for name in FRAME]


def axes(arguments: Mapping[str, str]) -> list[float]:
    """Parse A1 to A6 (deg)."""
    return [number(arguments, name) for name in AXIS_ATTRIBUTES]


def escape(content: str, longest: int) -> str:
    """Escape an attribute value and truncate it to the length of a KRL string."""
    return content[:longest].translate(_ESCAPED)


class EkiMoves:
    """A client's motion commands, whose outcomes are passed to `report_end`."""

    def __init__(self, controller: Controller, report_end: Callable[[Acknowledgement], None]) -> None:
        self._controller = controller
        self._report_end = report_end

    def ptp_axis(self, arguments: Mapping[str, str]) -> Acknowledgement:
        """Move to A1..A6 (deg) with Vel and Acc (percent)."""
        return self._point_to_point(axes(arguments), arguments)

    def ptp_pos(self, arguments: Mapping[str, str]) -> Acknowledgement:
        """Move to X..C (mm, deg) in BASE with posture S T; Tool, Base, Vel and Acc (percent)."""
        pose = pose_of_frame(frame(arguments))
        status, turn = integer(arguments, "S"), integer(arguments, "T")
        if not (0 <= status < STATUS_LIMIT and 0 <= turn < TURN_LIMIT):
            raise ValueError("S and T are bits of the posture")
        refusal = self._prepare(arguments)
        if refusal is not None:
            return refusal
        controller = self._controller
        goal = controller.arm.axes_in_posture(pose, status ^ controller.parameters.inverted_status, turn)
        if goal is None:
            return Acknowledgement(AckCode.LIMIT, f"out of reach in the posture S {status} T {turn}")
        return self._point_to_point(goal, arguments)

    def lin(self, arguments: Mapping[str, str]) -> Acknowledgement:
        """Move straight to X..C (mm, deg) in BASE with Tool, Base and Vel (m/s), ignoring S and T."""
        pose = pose_of_frame(frame(arguments))
        speed_m_s = number(arguments, "Vel")
        if not SLOWEST_LINE_M_S <= speed_m_s <= FASTEST_LINE_M_S:
            raise ValueError(f"Vel must be {SLOWEST_LINE_M_S} to {FASTEST_LINE_M_S} m/s")
        refusal = self._prepare(arguments)
        if refusal is not None:
            return refusal
        controller = self._controller
        arm, parameters = controller.arm, controller.parameters
        goal = arm.base @ pose
        if arm.joints_at_line_end(goal) is None:
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

    def _point_to_point(self, goal_deg: list[float], arguments: Mapping[str, str]) -> Acknowledgement:
        speed, acceleration = share(arguments, "Vel"), share(arguments, "Acc")
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
            travel_mm = max(arm.peak_tool_speed_mm(goal_deg), SMALLEST_TRAVEL_MM)
            fastest_1_s = T1_MARGIN * parameters.T1_tool_speed_mm_s / travel_mm
        return self._begin(
            point_to_point(arm.description, arm.axes_deg, goal_deg, speed, acceleration, cycle_s, fastest_1_s)
        )

    def _prepare(self, arguments: Mapping[str, str]) -> Acknowledgement | None:
        """Activate the tool and base for a permitted motion, or return the refusal."""
        controller = self._controller
        ready = controller.ready()
        if ready.code is not AckCode.OK:
            return ready
        arm = controller.arm
        arm.use_frames(
            integer(arguments, "Tool", arm.tool_number), integer(arguments, "Base", arm.base_number)
        )
        return None

    def _begin(self, points: Iterator[list[float] | PendantMessage]) -> Acknowledgement:
        self._controller.move(EkiMotion(points, self._report_end))
        return ACCEPTED
