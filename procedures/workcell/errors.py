"""Errors for motions and looks refused by the workcell."""

from __future__ import annotations

from ronna_hw.errors import LimitError, RefusedError


class WrongTool(LimitError):
    """The controller's inputs report a different tool from the one the step needs."""

    code = "PRO-009"
    action = "Mount the named tool, then repeat the step. No motion until then."
    exit_code = RefusedError.exit_code


class GuideHeldAtEntry(RefusedError):
    """The guide is held in front of an entry, so it may only move along its own axis."""

    code = "PRO-014"
    action = "First retreat along the named trajectory."


class TipOffAxis(LimitError):
    """The guide is not on the axis along which it must be withdrawn."""

    code = "PRO-015"
    action = "Do not move the arm. Free the guide by hand, then find out what moved."
    exit_code = RefusedError.exit_code


class InstrumentInGuide(RefusedError):
    """An instrument is in the guide, beyond the entry, so nothing may move."""

    code = "TOOL-001"
    action = "Remove the instrument from the guide and confirm that it is out."


class SphereNotFound(RefusedError):
    """The stereo head sees no sphere at or near its expected position."""

    code = "PRO-008"
    action = "Check that the sphere is mounted, lit and unobstructed, lenses uncovered; or plan without it."


class AnotherArm(RefusedError):
    """The arm's calibration record belongs to another arm."""

    code = "CAL-013"
    action = "Name this arm's own record in [calibration.arm], or calibrate it with ronna-arm calibrate."


class BothArmsHalted(RefusedError):
    """Both arms are held at rest, because something stopped one of them."""

    code = "DUAL-001"
    action = (
        "Find out why, touching neither arm nor instrument, then let a named person acknowledge both arms. "
        "Nothing retreats by itself: the assistant leads its instrument out once that is confirmed."
    )


class SameArmTwice(RefusedError):
    """Master and assistant report the same serial number: both roles would be played by one arm."""

    code = "DUAL-004"
    action = "Correct the addresses of [robot.master] and [robot.assistant] in the theatre file."


class OtherArmMoving(RefusedError):
    """An arm was to move while another motion is under way."""

    code = "DUAL-002"
    action = "Wait for the other motion, or have both paths checked and driven together."


class OtherArmUnknown(RefusedError):
    """An arm was to move while the state of the other one is unknown, or known no more."""

    code = "DUAL-003"
    action = "Connect and start both arms; check the link of the named one."
