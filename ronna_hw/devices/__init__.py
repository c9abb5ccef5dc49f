"""Typed device interfaces, their lifecycle, and their readings."""

from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.lifecycle import Device, Identity, Lifecycle, LifecycleGuard
from ronna_hw.devices.motion import JointMove, LineMove, Motion
from ronna_hw.devices.new_frames import new_frames
from ronna_hw.devices.robot import ConfirmedStart, OperatingMode, RobotArm, StopKind
from ronna_hw.devices.stereo import StereoPair
from ronna_hw.devices.tracker import OpticalTracker

__all__ = [
    "ConfirmedStart",
    "Device",
    "Identity",
    "JointMove",
    "LastKnown",
    "Lifecycle",
    "LifecycleGuard",
    "LineMove",
    "Motion",
    "OperatingMode",
    "OpticalTracker",
    "RobotArm",
    "StereoPair",
    "StopKind",
    "new_frames",
]
