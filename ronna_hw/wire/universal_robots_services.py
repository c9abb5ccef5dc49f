"""Vocabulary of a Universal Robots controller's primary interface and dashboard.

The primary interface sends packages: int32 size with the header, uint8 kind, payload, all big-endian. A robot
state is a package of parts, each with uint32 size and uint8 kind. Controllers of different ages send parts of
different lengths: the layouts end with the last field that both sides use. The dashboard takes a command in a
line of text, whatever its case, and answers with a line. Angles are in rad, lengths in m.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Final

PACKAGE_HEADER: Final = ">iB"
PART_HEADER: Final = ">IB"
MODE_PART: Final = ">Q7?BBdd"  # until the speed slider's fraction and the speed scaling
JOINT_PART: Final = ">3d4fB"  # actual, target, speed; current, voltage, temperature, unused; mode: six times
MASTERBOARD_PART: Final = ">IIBBddbbddffffB"  # from the digital inputs until the safety mode
KINEMATICS_PART: Final = ">6I24dI"  # checksums; theta, a, d, alpha of the joints; status
MESSAGE_HEADER: Final = ">QbB"  # time in us, source, kind


class PackageKind(IntEnum):
    """Kind of a package of the primary interface."""

    ROBOT_STATE = 16
    MESSAGE = 20


class PartKind(IntEnum):
    """Kind of a part of a robot state."""

    MODE = 0
    JOINTS = 1
    MASTERBOARD = 3
    CARTESIAN = 4
    KINEMATICS = 5
    CONFIGURATION = 6


class MessageKind(IntEnum):
    """Kind of a message."""

    TEXT = 0
    VERSION = 3
    SAFETY_MODE = 5
    ERROR = 6
    KEY = 7
    RUNTIME_EXCEPTION = 10


BANNER: Final = "Connected: Universal Robots Dashboard Server"
ARM_TYPE: Final = "UR5"  # as the dashboard calls both generations


class Query(StrEnum):
    """Command of the dashboard that changes nothing."""

    ROBOT_MODE = "robotmode"
    SAFETY_MODE = "safetymode"
    ROBOT_MODEL = "get robot model"
    SERIAL_NUMBER = "get serial number"
    REMOTE_CONTROL = "is in remote control"
    RUNNING = "running"
    ADD_TO_LOG = "addToLog"  # the text follows


class DashboardOrder(StrEnum):
    """Command of the dashboard that acts on the arm or its program."""

    POWER_ON = "power on"
    POWER_OFF = "power off"
    BRAKE_RELEASE = "brake release"
    STOP = "stop"
    CLOSE_SAFETY_POPUP = "close safety popup"
    UNLOCK_PROTECTIVE_STOP = "unlock protective stop"
    RESTART_SAFETY = "restart safety"


ROBOT_MODE_HEAD: Final = "Robotmode:"  # begins an answer; then the mode
SAFETY_MODE_HEAD: Final = "Safetymode:"
RUNNING_HEAD: Final = "Program running:"
ACCEPTED: Final[dict[DashboardOrder, str]] = {  # how the answer to an order begins that is carried out
    DashboardOrder.POWER_ON: "Powering on",
    DashboardOrder.POWER_OFF: "Powering off",
    DashboardOrder.BRAKE_RELEASE: "Brake releasing",
    DashboardOrder.STOP: "Stopped",
    DashboardOrder.CLOSE_SAFETY_POPUP: "closing safety popup",
    DashboardOrder.UNLOCK_PROTECTIVE_STOP: "Protective stop releasing",
    DashboardOrder.RESTART_SAFETY: "Restarting safety",
}
