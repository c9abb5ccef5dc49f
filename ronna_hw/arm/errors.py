"""Errors of arm kinematics, planning and motion."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, DataError, ErrorCode, LimitError, RefusedError


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


TOO_FAST = ErrorCode(
    "ARM-005",
    LimitError,
    "A joint would exceed its working speed or acceleration.",
    "Stay farther from the singular pose, or choose a slower motion.",
)


MOTION_INVALID = ErrorCode(
    "ARM-006",
    DataError,
    "The motion generator rejected its input.",
    "Check the motion's numbers: finite values, positive limits, one value per joint.",
)


class NotClear(LimitError):
    """A body of the arm or its tool comes too close to another body along the path."""

    code = "ARM-007"
    action = (
        "Choose another angle about the tool axis or go via another pose; if the body does not exist, "
        "correct [cell] of the theatre file."
    )


SURROUNDINGS_TOO_LARGE = ErrorCode(
    "ARM-008",
    DataError,
    "[cell] defines more bodies than the real-time process supports.",
    "Use fewer bodies and shorter names in [cell] of the theatre file.",
)


class UnknownArm(ConfigurationError):
    """A calibration record or a driver refers to an arm that is not in the catalogue."""

    code = "ARM-009"
    action = "Correct the name, or install the package that brings the arm."


CALIBRATION_OF_ANOTHER_ARM = ErrorCode(
    "ARM-010",
    ConfigurationError,
    "An arm's factory calibration does not fit its model.",
    "Check the arm's model in the theatre file, and that the controller belongs to this arm.",
)


INSERTION_INVALID = ErrorCode(
    "ARM-012",
    DataError,
    "An insertion is not along the instrument's axis, or a limit of a motion in contact is out of range.",
    "Bring the instrument onto its axis first, and keep speed, force and reach within the stated limits.",
)


FORCE_NOT_SENSED = ErrorCode(
    "ARM-013",
    RefusedError,
    "A force limit was asked for, and the arm does not sense the force on its tool.",
    "Use an arm that senses force, or insert without a force limit and watch the instrument yourself.",
)


LOADED_AT_START = ErrorCode(
    "ARM-014",
    RefusedError,
    "A force acts on the tool before a motion with a force limit, so that it cannot be tared.",
    "Let go of the tool, check that it touches nothing and that mass and centre of gravity are set, "
    "then wait a moment and start again.",
)


class ForceLimitExceeded(LimitError):
    """The force on the tool exceeded the limit of a motion, which stopped."""

    code = "ARM-015"
    action = (
        "Look at the instrument: the arm holds it where it is. In a case `home`, or the step again, leads it "
        "out once that is confirmed; in Python resume, then withdraw without a force limit."
    )
