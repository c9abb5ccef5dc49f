"""What a calibration of the stereo head is refused for. CAL-001, an expired record, belongs to the record."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError, RefusedError


class TooFewPoses(DataError):
    """Too few poses show the ball in both images."""

    code = "CAL-002"
    action = "Check light, focus and what hides the ball, then calibrate again with more poses."


class DegeneratePoses(DataError):
    """The orientations do not differ enough: tool frame and ball cannot be told apart."""

    code = "CAL-003"
    action = "Look at the ball from orientations tilted by 20 degrees and more to all sides, and turned."


class DoesNotFit(DataError):
    """No pair of cameras on a flange explains the observations."""

    code = "CAL-004"
    action = "Check that ball and mount stand firmly and that arm variant and images are of one run; repeat."


class BadObservations(DataError):
    """A file of observations, or a baseline, is missing or has mistakes; all of them are listed."""

    code = "CAL-005"
    action = "Give the folder that ronna-stereo calibrate wrote, unchanged."


class HeadMoved(RefusedError):
    """The head does not see the ball where it saw it at calibration: a camera or the mount has moved."""

    code = "CAL-006"
    action = "Do not use this calibration: check the screws of cameras and mount, then calibrate again."


class CheckUncertain(DataError):
    """The looks of a check scatter so much that a camera's twist could hide in them."""

    code = "CAL-007"
    action = "Check that ball and arm stand still, then repeat the check with more visits."
    exit_code = EXIT_REFUSED


class NotTheBaseline(DataError):
    """A check was made at other poses, or with another calibration, than its baseline."""

    code = "CAL-008"
    action = "Give the baseline of the calibration that is in use, and keep its poses."


class NoBall(RefusedError):
    """Nobody said where the ball is, and the tracker sees none that the arm can look at."""

    code = "CAL-009"
    action = "Say where the ball is with --ball X Y Z, or clear the tracker's line of sight to it."


class PosesOutOfReach(RefusedError):
    """Too few of the planned poses about the ball are within reach and clear of everything."""

    code = "CAL-010"
    action = "Put the ball nearer to the middle of the arm's reach, with free space around it."
