"""A six-axis arm that follows corrections in real time and stops by itself."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.lifecycle import Device
from ronna_hw.devices.motion import Motion
from ronna_hw.devices.readings import ArmReading, JointVector, LinkStatistics, ToolIdentity

if TYPE_CHECKING:
    from ronna_hw.arm.clearance.surroundings import Surroundings
    from ronna_hw.arm.kinematics import Kinematics
    from ronna_hw.arm.preview import PathPreview
    from ronna_hw.frames import Transform


class StopKind(StrEnum):
    """How to stop. None of them is an emergency stop: that is the controller's."""

    HOLD = "hold"  # along the path, to rest; the stream continues
    PROTECTIVE = "protective_stop"  # highest deceleration the limits allow; latched
    LINK = "link_stop"  # stop replying; the controller then stops the arm itself
    DRIVES_OFF = "request_drives_off"  # ask the controller to switch the drives off


@runtime_checkable
class ConfirmedStart(Protocol):
    """What an arm offers besides `RobotArm` when it may need a person's word before `activate`."""

    @property
    def to_confirm(self) -> str | None:
        """What a person must confirm before the next `activate`, as a question shows it; None for nothing.

        Only looks at what the controller said last; allowed in every state.
        """
        ...

    def confirm_start(self, confirmed_by: str) -> None:
        """Somebody confirmed what `to_confirm` said last: the next `activate`, and only that, goes ahead.

        Raises DEV-006 without a name. Moves nothing.
        """
        ...


@runtime_checkable
class RobotArm(Device, Protocol):
    """`activate` starts the correction stream (the arm may move); `deactivate` ends it."""

    def observe(self) -> LastKnown[ArmReading]:
        """As `Device.observe`; the reading holds the last axes that the controller reported."""
        ...

    @property
    def kinematics(self) -> Kinematics:
        """The nominal kinematics that lines, ranges and clearance are computed with; known in every state."""
        ...

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Measured axes; allowed from CONNECTED."""
        ...

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        """Number of the mounted tool, from the controller's inputs; allowed from CONNECTED."""
        ...

    def move_joints(
        self, target_rad: JointVector, *, speed_fraction: float = 1.0, timeout_s: float = 60.0
    ) -> ArmReading:
        """Synchronised joint move to rest; returns the settled reading.

        `speed_fraction` scales the driver's working speed, 0 < fraction <= 1. `timeout_s` is in theatre
        time where the controller is clocked by it. Raises LimitError before motion when the path leaves
        the joint ranges, StateError outside ACTIVE, MotionInterrupted when `stop` ended it, and the latched
        fault when the link or monitor trips.
        """
        ...

    def move_linear(
        self,
        target: Transform,
        *,
        flange_from_tool: Transform | None = None,
        speed_fraction: float = 1.0,
        timeout_s: float = 60.0,
    ) -> ArmReading:
        """Straight line of the flange to a pose ROBOT <- FLANGE, or of the tool to a pose ROBOT <- TOOL.

        `flange_from_tool` (FLANGE <- TOOL) belongs to the latter. Orientation by slerp; the arm stays in the
        branch of its current pose. Raises FRM-001 before motion for other frames, otherwise as `move_joints`.
        """
        ...

    def preview(self, motion: Motion, *, start_rad: JointVector | None = None) -> PathPreview:
        """What a motion would do when it is driven from `start_rad`, by default from here; nothing moves.

        Raises as `move_joints` and `move_linear` if there is no such path; one that is not clear is reported
        in `refused`.
        """
        ...

    def surround(self, surroundings: Surroundings) -> None:
        """Declare what the arm carries and what surrounds it, from the next motion on.

        Every motion is checked against it before it starts (ARM-007), and monitored while it runs.
        """
        ...

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        """Bring the arm to rest; may be called from another thread than the one that moves."""
        ...

    def resume(self) -> None:
        """HOLD -> ACTIVE. Moves nothing: an interrupted path is never continued, only planned again."""
        ...

    def link_statistics(self) -> LinkStatistics:
        """Health of the link since the last `activate`."""
        ...
