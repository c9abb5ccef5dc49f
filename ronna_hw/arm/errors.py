"""Errors of arm kinematics, planning and motion."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError, LimitError, RefusedError


class Unreachable(LimitError):
    """The pose is out of the arm's reach."""

    code = "ARM-001"
    action = "Move the target, the patient or the cart so that the pose comes within reach."


class Singular(LimitError):
    """A joint angle is undefined at this pose, and joint speeds grow without bound near it."""

    code = "ARM-002"
    action = "Choose another angle about the tool axis, or another branch."


class OutOfJointRange(LimitError):
    """A joint would leave its range."""

    code = "ARM-003"
    action = "Choose another branch or another angle about the tool axis, or approach from another pose."


class TooFast(LimitError):
    """A joint would exceed its working speed or acceleration."""

    code = "ARM-005"
    action = "Stay farther from the singular pose, or choose a slower motion."


class MotionInvalid(DataError):
    """The motion generator rejected its input."""

    code = "ARM-006"
    action = "Check the motion's numbers: finite values, positive limits, one value per joint."


class NotClear(LimitError):
    """A body of the arm or its tool comes too close to another body along the path."""

    code = "ARM-007"
    action = (
        "Choose another angle about the tool axis or go via another pose; if the body does not exist, "
        "correct [cell] of the theatre file."
    )


class SurroundingsTooLarge(DataError):
    """[cell] defines more bodies than the real-time process supports."""

    code = "ARM-008"
    action = "Use fewer bodies and shorter names in [cell] of the theatre file."


class UnknownArm(ConfigurationError):
    """A calibration record or a driver refers to an arm that is not in the catalogue."""

    code = "ARM-009"
    action = "Correct the name, or install the package that brings the arm."


class CalibrationOfAnotherArm(ConfigurationError):
    """An arm's factory calibration does not fit its model."""

    code = "ARM-010"
    action = "Check the arm's model in the theatre file, and that the controller belongs to this arm."


class ArmsTooClose(LimitError):
    """Two arms would come, or have come, too close to each other."""

    code = "ARM-011"
    action = "Move one arm out of the way first, or choose another path for one of them."


class InsertionInvalid(DataError):
    """An insertion is not along the instrument's axis, or a limit of a motion in contact is out of range."""

    code = "ARM-012"
    action = (
        "Bring the instrument onto its axis first, and keep speed, force and reach within the stated limits."
    )


class ForceNotSensed(RefusedError):
    """A force limit was asked for, and the arm does not sense the force on its tool."""

    code = "ARM-013"
    action = (
        "Use an arm that senses force, or insert without a force limit and watch the instrument yourself."
    )


class LoadedAtStart(RefusedError):
    """A force acts on the tool before a motion with a force limit, so that it cannot be tared."""

    code = "ARM-014"
    action = (
        "Let go of the tool, check that it touches nothing and that mass and centre of gravity are set, "
        "then wait a moment and start again."
    )


class ForceLimitExceeded(LimitError):
    """The force on the tool exceeded the limit of a motion, which stopped."""

    code = "ARM-015"
    action = (
        "Look at the instrument: the arm holds it where it is. In a case `home`, or the step again, leads it "
        "out once that is confirmed; in Python resume, then withdraw without a force limit."
    )
