"""Typed interfaces, lifecycle and readings of devices."""

from ronna_hw.devices.lifecycle import Device, Identity, LastKnown, Lifecycle, LifecycleGuard
from ronna_hw.devices.robot import (
    ConfirmedStart,
    JointMove,
    LineMove,
    Motion,
    OperatingMode,
    RobotArm,
    StopKind,
)
from ronna_hw.devices.sensors import OpticalTracker, StereoPair, new_frames

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
