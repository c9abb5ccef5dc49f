"""Which device calls are recorded for replay, and their answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.preview import PathPreview
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.readings import ArmReading, LinkStatistics, StereoReading, ToolIdentity, TrackerFrame
from ronna_hw.devices.robot import OperatingMode

# By name, over all kinds of devices. For `None` only matters whether the call raised.
ANSWERS: dict[str, Any] = {
    "connect": Identity,
    "read_frame": TrackerFrame,
    "grab_pair": StereoReading,
    "read_state": ArmReading,
    "read_tool_identity": ToolIdentity,
    "move_joints": ArmReading,
    "move_linear": ArmReading,
    "preview": PathPreview,
    "limits": MotionLimits,
    "link_statistics": LinkStatistics,
    **dict.fromkeys(("configure", "activate", "deactivate", "resume"), None),
    **dict.fromkeys(("surround", "set_areas", "set_exposure", "scale_exposure", "confirm_start"), None),
}
# Properties that may change on their own; each access is an answer.
LOOKS: dict[str, Any] = {"to_confirm": str | None}
# What a device knows about itself once one of these calls is done; recorded with its answer.
PROPERTIES: dict[str, Any] = {
    "serials": tuple[str, str],
    "notices": tuple[str, ...],
    "operating_mode": OperatingMode,
}
TELLING = ("connect", "configure")


@runtime_checkable
class RecordsCalls(Protocol):
    """A device of another kind: calls of its own that a replay repeats, with what each of them returns."""

    @property
    def recorded_calls(self) -> Mapping[str, Any]: ...


def answers_of(device: object) -> Mapping[str, Any]:
    """The recorded calls of a device, with what each of them returns."""
    return {**device.recorded_calls, **ANSWERS} if isinstance(device, RecordsCalls) else ANSWERS
