"""Errors in calibrations and checks. CAL-001 (expired record) is defined with the record."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError, ErrorCode, RefusedError

TOO_FEW_POSES = ErrorCode(
    "CAL-002",
    DataError,
    "Too few poses show the ball in both images.",
    "Check illumination, focus and occlusion of the ball, then calibrate again with more poses.",
)


class DegeneratePoses(DataError):
    """The orientations vary too little to separate the tool frame from the ball position."""

    code = "CAL-003"
    action = "View the ball from orientations tilted by 20 degrees or more in all directions, and rotated."


class DoesNotFit(DataError):
    """The observations do not fit any rigid pair of cameras on the flange."""

    code = "CAL-004"
    action = (
        "Check that ball, frame and mount are rigid, that nothing was moved meanwhile (a cart, the tracker), "
        "and that images and arm variant match this run; repeat."
    )


BAD_OBSERVATIONS = ErrorCode(
    "CAL-005",
    DataError,
    "A file of observations or a baseline is missing or invalid; the message lists all errors.",
    "Give the folder that the calibrate command wrote, unchanged.",
)


HEAD_MOVED = ErrorCode(
    "CAL-006",
    RefusedError,
    "The head sees the ball away from its calibrated position, so a camera or the mount has moved.",
    (
        "Do not use this calibration: check the screws of cameras and mount, then repeat the calibrations of "
        "stereo head, tracker frame and tool tip: frame and tip have not moved with the head."
    ),
)


CHECK_UNCERTAIN = ErrorCode(
    "CAL-007",
    DataError,
    "The views in a check scatter so much that a rotated camera could go unnoticed.",
    "Check that ball and arm are rigid, then repeat the check with more visits.",
    own_exit_code=EXIT_REFUSED,
)


class NotTheBaseline(DataError):
    """The poses or the calibration used in a check differ from those of its baseline."""

    code = "CAL-008"
    action = "Use the baseline of the current calibration, with its poses."


NO_BALL = ErrorCode(
    "CAL-009",
    RefusedError,
    "No ball position was given, and the tracker sees no ball within reach of the arm.",
    "Give the position of the ball with --ball X Y Z, or clear the tracker's line of sight to it.",
)


POSES_OUT_OF_REACH = ErrorCode(
    "CAL-010",
    RefusedError,
    "Too few of the planned poses around the ball are reachable and free of collisions.",
    "Place the ball nearer to the middle of the workspace, with free space around it.",
)


UNOBSERVABLE = ErrorCode(
    "CAL-011",
    RefusedError,
    "The measurements leave too much of the arm undetermined.",
    (
        "Measure more spheres, farther apart, from more strongly tilted and rotated poses; "
        "then calibrate again."
    ),
)


ARM_CHANGED = ErrorCode(
    "CAL-012",
    RefusedError,
    "The arm, or the head on it, no longer matches its calibration.",
    "Check the mount's screws and the arm's mastering, then run ronna-arm calibrate again.",
)


NO_ARM_RECORD = ErrorCode(
    "CAL-014",
    RefusedError,
    "An arm calibration record is required, but there is none.",
    "Run ronna-arm calibrate, and name its record in [calibration.arm] of the theatre file.",
)


FRAME_NOT_CARRIED = ErrorCode(
    "CAL-015",
    DataError,
    "The tool tracked as the reference frame does not rotate with the flange.",
    (
        "Check that the frame on the mount is the tool named in the record, that it is screwed tight, "
        "and that no other frame of that kind is in view; then calibrate again."
    ),
)


TRACKER_MOVED = ErrorCode(
    "CAL-016",
    DataError,
    "The reference frame appears to have moved although the arm returned to the same pose.",
    "Lock the tracker's stand, the arm's platform and the frame on the mount, then calibrate again.",
)


FAR_FROM_RECORD = ErrorCode(
    "CAL-017",
    RefusedError,
    "The result differs from the initial record by more than any mount allows.",
    (
        "Correct the record in the theatre file (millimetres, quaternion with the scalar first, as in "
        "the drawing), or mount the part as drawn. Then calibrate again."
    ),
)


READING_IMPLAUSIBLE = ErrorCode(
    "CAL-018",
    RefusedError,
    "A dial reading from the stand is implausible.",
    "Read the three dials again and give x y z in millimetres, along the axes of the robot.",
)


BALL_AND_DIVOT_APART = ErrorCode(
    "CAL-019",
    DataError,
    "The stand's divot and ball do not coincide.",
    "Clean the seats of ball and divot, zero the dials, screw the stand down; then repeat.",
)


class OfAnotherTheatre(RefusedError):
    """The measurements or the arm calibration do not belong to the records in the theatre file."""

    code = "CAL-020"
    action = (
        "Name the folder of this theatre's measurements. If its records have changed since they were made, "
        "calibrate again."
    )


class ArmOlderThanHead(RefusedError):
    """The stereo head was calibrated after the arm, which invalidates the arm calibration."""

    code = "CAL-021"
    action = "Run ronna-arm calibrate; no motion until then."


BASES_DISAGREE = ErrorCode(
    "CAL-022",
    DataError,
    "Tracker and stereo head disagree about where the assistant's base is.",
    (
        "Check that both carts are locked, that the frames on both arms are those of the records and screwed "
        "tight, and that the ball is the assistant's; then calibrate the bases again."
    ),
)


class PlatformMoved(RefusedError):
    """The bases of the two arms are no longer where they were calibrated."""

    code = "CAL-023"
    action = (
        "Look for a cart that has moved, a frame or holder that is loose. Lock both carts, send the arms "
        "home, with the pendant where a way is refused, then localize again: the bases are calibrated anew."
    )
    way_mm: tuple[float, float, float] | None = None  # as the assistant's frame was seen, robot frame
