"""Interface of an arm driven by real-time corrections, and its motions as value objects."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from ronna_hw.arguments import WrongArgument, show
from ronna_hw.devices.lifecycle import Device, LastKnown
from ronna_hw.devices.readings import ArmReading, LinkStatistics, ToolIdentity
from ronna_hw.vectors import JointVector

if TYPE_CHECKING:
    from ronna_hw.arm.clearance.bodies import Surroundings
    from ronna_hw.arm.kinematics import Kinematics
    from ronna_hw.arm.motion.limits import MotionLimits
    from ronna_hw.arm.path_preview import PathPreview
    from ronna_hw.frames import Transform


@dataclass(frozen=True)
class JointMove:
    """Synchronised motion of all joints, straight to `target_rad`.

    `speed_fraction` is a fraction of the working speed of the driver, 0 < fraction <= 1. One that need not
    settle ends when its last set-point is sent, since another motion follows at once. A motion is a value, so
    that the motion previewed is the motion driven. A target that is a list or an array becomes a
    tuple; raises ARG-001 if it is no sequence of numbers.
    """

    target_rad: JointVector
    speed_fraction: float = 1.0
    settles: bool = True

    def __post_init__(self) -> None:
        given: Any = self.target_rad
        if not isinstance(given, tuple):  # a list or an array is no value
            try:
                target_rad = tuple(map(float, given))
            except (TypeError, ValueError):
                raise WrongArgument(
                    "the target is no joint vector",
                    expected="one number per joint, in rad",
                    got=show(given),
                ) from None
            object.__setattr__(self, "target_rad", target_rad)


@dataclass(frozen=True)
class LineMove:
    """Straight-line motion of the flange to ROBOT <- FLANGE, or of the tool to ROBOT <- TOOL.

    `flange_from_tool` (FLANGE <- TOOL) is given with the latter. `speed_fraction` as in `JointMove`.
    """

    target: Transform
    flange_from_tool: Transform | None = None
    speed_fraction: float = 1.0


Motion = JointMove | LineMove


def require_motion(given: object) -> None:
    """Raise ARG-001 for anything but a motion, such as bare joint angles."""
    if not isinstance(given, JointMove | LineMove):
        raise WrongArgument(
            "an arm moves by a motion",
            expected="JointMove(target_rad) or LineMove(target)",
            got=show(given),
            action="Wrap joint angles: arm.move(JointMove((0.0, -1.3, 1.7, 0.0, 1.1, 0.0))).",
        )


STOP_LIMIT_S = 5.0  # host time for an arm to come to rest


class StopKind(StrEnum):
    """Kind of stop, excluding the controller's own emergency stop."""

    HOLD = "hold"  # along the path, to rest; the stream continues
    PROTECTIVE = "protective_stop"  # highest deceleration the limits allow; latched
    LINK = "link_stop"  # stop replying; the controller then stops the arm itself
    DRIVES_OFF = "request_drives_off"  # ask the controller to switch the drives off


def stop_mistake(arm: str, kind: object, timeout_s: object) -> WrongArgument:
    """Build the error for a stop with a wrong kind or time limit, which has held the arm all the same."""
    return WrongArgument(
        f"{arm}: stop was given a wrong argument; the arm was stopped at HOLD all the same",
        expected=f"kind {', '.join(map(repr, map(str, StopKind)))}, timeout_s a number above 0",
        got=f"kind {show(kind)}, timeout_s {show(timeout_s)}",
        action="Or StopKind of ronna_hw.devices; a time limit alone is stop(timeout_s=2.0).",
    )


class OperatingMode(StrEnum):
    """Operating mode in which this program can move an arm (ISO 10218-1)."""

    AUTOMATIC = "automatic"
    REDUCED_SPEED = "manual at reduced speed"  # with a person at the arm


@runtime_checkable
class ConfirmedStart(Protocol):
    """Optional interface of an arm that may require a person's confirmation before `activate`."""

    @property
    def to_confirm(self) -> str | None:
        """Question for the operator to confirm before the next `activate`, or None.

        Passive: uses only the controller's last report; allowed in every state.
        """

    def confirm_start(self, confirmed_by: str) -> None:
        """Confirm the last `to_confirm`, permitting only the next `activate`.

        Raises DEV-006 without a name. Moves nothing.
        """


@runtime_checkable
class RobotArm(Device, Protocol):
    """Robot arm. `activate` starts the correction stream, so the arm may move; `deactivate` ends it."""

    def observe(self) -> LastKnown[ArmReading]:
        """Same as `Device.observe`; the reading contains the axes last reported by the controller."""

    @property
    def kinematics(self) -> Kinematics:
        """Nominal kinematics for lines, ranges and clearance; available in every state."""

    @property
    def operating_mode(self) -> OperatingMode:
        """Mode of the running stream, or the last reported mode; AUTOMATIC until one is reported.

        Passive; allowed in every state.
        """

    def limits(self, mode: OperatingMode | None = None) -> MotionLimits:
        """Return the motion limits of an operating mode (default: the current one); available in every state.

        Motions, previews and the monitor keep to exactly these.
        """

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Read the measured axes. Allowed from CONNECTED."""

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        """Read the number of the mounted tool from the controller's inputs. Allowed from CONNECTED."""

    def move(self, motion: Motion, *, timeout_s: float = 60.0) -> ArmReading:
        """Carry out a motion to rest at its target and return the settled reading.

        All joints move together; along a line the orientation follows by slerp, and the arm stays in the
        branch of its current pose. `timeout_s` is in theatre time if that clocks the controller. An error or
        interruption that ends the call, such as Ctrl-C, stops the arm at HOLD. Raises ARG-001 for bare joint
        angles, LimitError before motion if the path leaves the joint ranges, FRM-001
        for a line between other frames, StateError outside ACTIVE, MotionInterrupted when `stop` ended it,
        and the latched fault when link or monitor trips.
        """

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        """Predict a motion from `start_rad`, by default the current position, without moving.

        Raises like `move` if there is no such path; one that is not clear is reported in `refused`.
        """

    def surround(self, surroundings: Surroundings) -> None:
        """Declare the mounted tool and the surroundings of the arm for all later motions.

        Every motion is checked against them before it starts (ARM-007), and monitored while it runs.
        """

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = STOP_LIMIT_S) -> None:
        """Stop the arm; may be called from a different thread than the motion.

        `kind` is one of `StopKind`, or its word such as "hold". With a wrong argument the arm is stopped at
        HOLD, and ARG-001 raised afterwards.

        No motion begins while it is carried out: it raises StateError or MotionInterrupted. A start under way
        fails, or ends in HOLD.
        """

    def resume(self) -> None:
        """Leave HOLD for ACTIVE without moving: an interrupted path is re-planned, never continued."""

    def link_statistics(self) -> LinkStatistics:
        """Return the health of the link since the last `activate`."""
