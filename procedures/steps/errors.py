"""Errors of cart, tools and instruments."""

from __future__ import annotations

from ronna_hw.errors import ErrorCode, LimitError, RefusedError

CART_NOT_LOCKED = ErrorCode(
    "PRO-041",
    RefusedError,
    "The cart's lock was not confirmed, or the cart rolled when leaned on.",
    "Lock the brakes of every wheel, or lower the cart onto its feet, then repeat the step.",
)


CART_OUT_OF_PLACE = ErrorCode(
    "PRO-042",
    RefusedError,
    "The cart is farther from its proposed position than the tolerance allows.",
    "Push the cart as indicated and repeat the step, or make a map from here: ronna-plan place.",
)


DEPTH_STOP_WRONG = ErrorCode(
    "TOOL-004",
    LimitError,
    "The depth stop of the instrument is not at the setting computed for the trajectory.",
    ("Set the depth stop to the expected value, then repeat the step; no instrument is inserted until then."),
    own_exit_code=RefusedError.exit_code,
)


class ReadingTooOld(LimitError):
    """A manual reading is too old to be relied on."""

    code = "TOOL-007"
    action = "Repeat the step: it is read again."
    exit_code = RefusedError.exit_code


class ToolBesideGauge(LimitError):
    """The mounted guide does not match its record: bent, badly seated, wrong mandrel, or the arm sags."""

    code = "TOOL-005"
    action = (
        "Read the dials again, or reseat the guide and its mandrel on the parked arm, then repeat "
        "tool_check; if it still differs, calibrate the guide."
    )
    exit_code = RefusedError.exit_code


class ToolSeenElsewhere(LimitError):
    """The tracker sees the tool's frame away from its recorded position, or not at all."""

    code = "TOOL-006"
    action = (
        "Check that it is the right tool, properly seated and visible to the tracker, and that the frame on "
        "the mount is tight; repeat tool_check."
    )
    exit_code = RefusedError.exit_code
