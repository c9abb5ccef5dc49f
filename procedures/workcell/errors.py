"""Errors for motions and looks refused by the workcell."""

from __future__ import annotations

from ronna_hw.errors import ErrorCode, LimitError, RefusedError


class WrongTool(LimitError):
    """The controller's inputs report a different tool from the one the step needs."""

    code = "PRO-009"
    action = "Mount the named tool, then repeat the step. No motion until then."
    exit_code = RefusedError.exit_code


GUIDE_HELD_AT_ENTRY = ErrorCode(
    "PRO-014",
    RefusedError,
    "The guide is held in front of an entry, so it may only move along its own axis.",
    "First retreat along the named trajectory.",
)


class TipOffAxis(LimitError):
    """The guide is not on the axis along which it must be withdrawn."""

    code = "PRO-015"
    action = "Do not move the arm. Free the guide by hand, then find out what moved."
    exit_code = RefusedError.exit_code


INSTRUMENT_IN_GUIDE = ErrorCode(
    "TOOL-001",
    RefusedError,
    "An instrument is in the guide, beyond the entry, so nothing may move.",
    "Remove the instrument from the guide and confirm that it is out.",
)


SPHERE_NOT_FOUND = ErrorCode(
    "PRO-008",
    RefusedError,
    "The stereo head sees no sphere at or near its expected position.",
    "Check that the sphere is mounted, lit and unobstructed, lenses uncovered; or plan without it.",
)


class AnotherArm(RefusedError):
    """The arm's calibration record belongs to another arm."""

    code = "CAL-013"
    action = "Name this arm's own record in [calibration.arm], or calibrate it with ronna-arm calibrate."


class BothArmsHalted(RefusedError):
    """Both arms are held at rest, because something stopped one of them."""

    code = "DUAL-001"
    action = (
        "Find out why, touching neither arm nor instrument, but switch off a drill that turns; then let a "
        "named person acknowledge both arms. Nothing retreats by itself: the assistant leads its instrument "
        "or drill out once that is confirmed."
    )


SAME_ARM_TWICE = ErrorCode(
    "DUAL-004",
    RefusedError,
    "Master and assistant report the same serial number: both roles would be played by one arm.",
    "Correct the addresses of [robot.master] and [robot.assistant] in the theatre file.",
)


OTHER_ARM_MOVING = ErrorCode(
    "DUAL-002",
    RefusedError,
    "An arm was to move while another motion is under way.",
    "Wait until the other motion has ended.",
)


class OtherArmUnknown(RefusedError):
    """An arm was to move while the state of the other one is unknown, or known no more."""

    code = "DUAL-003"
    action = "Connect and start both arms; check the link of the named one."
