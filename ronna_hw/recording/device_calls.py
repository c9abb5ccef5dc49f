"""Which calls on devices are kept for a replay, and what they answer."""

from __future__ import annotations

from typing import Any

from ronna_hw.arm.preview import PathPreview
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.readings import ArmReading, LinkStatistics, StereoReading, ToolIdentity, TrackerFrame

# By name, over all kinds of devices. `None` answers nothing: what matters is whether it raised.
ANSWERS: dict[str, Any] = {
    "connect": Identity,
    "read_frame": TrackerFrame,
    "grab_pair": StereoReading,
    "read_state": ArmReading,
    "read_tool_identity": ToolIdentity,
    "move_joints": ArmReading,
    "move_linear": ArmReading,
    "preview": PathPreview,
    "link_statistics": LinkStatistics,
    **dict.fromkeys(("configure", "activate", "deactivate", "resume"), None),
    **dict.fromkeys(("surround", "set_areas", "set_exposure", "scale_exposure", "confirm_start"), None),
}
# Properties that may change by themselves; each look at them is an answer.
LOOKS: dict[str, Any] = {"to_confirm": str | None}
# What a device knows of itself once one of these calls is done; they are kept with its answer.
PROPERTIES: dict[str, Any] = {"serials": tuple[str, str], "notices": tuple[str, ...]}
TELLING = ("connect", "configure")
