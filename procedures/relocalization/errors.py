"""Errors in stereo head measurements, STE-001 to STE-020. Data errors are also `ValueError`s."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError, ErrorCode, RefusedError


class BadImage(DataError):
    """The input is not a single grey image of 8 or 12 bits."""

    code = "STE-001"
    action = "Give a 2-D array of uint8, or of uint16 with 12-bit values, at least 48 pixels on each side."


class NoContrast(DataError):
    """The image is dark or uniform and shows no structure."""

    code = "STE-002"
    action = "Bring a lit sphere into view; check lens caps and lights, then lengthen the exposure."


class NoSphere(DataError):
    """The image has structure, but no bright disc with enough of its rim in view."""

    code = "STE-003"
    action = "Search around this pose; if that fails, check that the sphere is present, clean and lit."


BAD_MEASUREMENT = ErrorCode(
    "STE-004",
    DataError,
    "Input numbers are not finite or have the wrong shape.",
    "Measure again; do not edit the numbers.",
)


class RaysDoNotMeet(DataError):
    """The two lines of sight are too far apart to belong to the same sphere."""

    code = "STE-005"
    action = "Check that both cameras see the same sphere, then check the stereo calibration."


class WrongSize(DataError):
    """The object seen by both cameras is too large or too small to be the sphere at its distance."""

    code = "STE-006"
    action = "Check what is in view: glare, another sphere, or a marker of a different diameter."


SERVO_DIVERGES = ErrorCode(
    "STE-007",
    DataError,
    "The servo residual does not decrease from step to step.",
    "Check the stereo calibration and that the patient's head is still, then start again.",
)


SERVO_EXHAUSTED = ErrorCode(
    "STE-008",
    DataError,
    "The servo residual still exceeds its tolerance after the last allowed step.",
    "Leave out this sphere, or check lens, light and arm, then start again.",
)


class SphereNotInView(DataError):
    """The whole search pattern was covered without finding the sphere."""

    code = "STE-009"
    action = "Put the ball there, in view of both cameras, or give its position with --ball X Y Z."


WRONG_CAMERA = ErrorCode(
    "STE-010",
    DataError,
    "The image comes from a camera other than the calibrated one.",
    "Use the calibration of the mounted head, or calibrate it.",
    own_exit_code=EXIT_REFUSED,
)


class Saturated(DataError):
    """The whole image is saturated, so a search elsewhere would not help."""

    code = "STE-011"
    action = "Shorten the exposure or lower the gain; look for a lamp or window shining into the lens."


class PairNotUsable(DataError):
    """Images are repeatedly incomplete, missing or outdated, or left and right have different triggers."""

    code = "STE-012"
    action = "Check both cameras with ronna-procedure doctor; check cables, trigger and network load."


class NotTrusted(DataError):
    """A sphere is in view, but not completely or clearly enough for a reliable centre."""

    code = "STE-013"
    action = (
        "Remove the obstruction, clean sphere and lens, check focus and light, or view it from elsewhere."
    )


HEAD_TURNED = ErrorCode(
    "STE-014",
    RefusedError,
    "A camera of the stereo head has moved since its calibration.",
    "Do not use these positions: check the stereo head with ronna-stereo check, then calibrate it.",
)


class NoLine(DataError):
    """The image shows no laser line."""

    code = "STE-015"
    action = "Check that the projector lights and that its line falls into view; then lengthen the exposure."


LINES_DO_NOT_MATCH = ErrorCode(
    "STE-016",
    DataError,
    "The lines in both images have no part in common, or run along the baseline of the cameras.",
    "Check that both cameras see the line, that it lies across the baseline, and the stereo calibration.",
)


NOT_IN_A_PLANE = ErrorCode(
    "STE-017",
    DataError,
    "The points of one laser line do not lie in a plane.",
    "Check the stereo calibration and that nothing reflects the line; then scan this line again.",
)


LINE_MOVED = ErrorCode(
    "STE-018",
    RefusedError,
    "The plane or the width of the laser line differs from its record.",
    "Check that both pictures are this head's and not exchanged, the projector's mount and focus, and "
    "the head with ronna-stereo check. To record the line anew, remove laser-line.json beside the baseline.",
)


NO_LINE_PICTURES = ErrorCode(
    "STE-019",
    DataError,
    "The folder has no pairs of pictures of a laser line, or one of them cannot be read.",
    "Give a folder with NAME-left.png and NAME-right.png; without the line, NAME-left-dark.png and so on.",
)


LINE_PLANE_UNKNOWN = ErrorCode(
    "STE-020",
    DataError,
    "The pictures of the laser line do not tell its plane.",
    "Take pictures of the line at three or more distances, 5 mm apart, and give them all.",
)
