"""Errors of a scan during the operation, CBCT-001 to CBCT-008."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, DataError, ErrorCode, RonnaError

SCAN_MISSING = ErrorCode(
    "CBCT-001",
    DataError,
    "There is no scan of the operation in the folder of the case.",
    "Scan the clamped head with its spheres, put the series into the folder named, then repeat the step.",
)


OTHER_PATIENT = ErrorCode(
    "CBCT-002",
    DataError,
    "The scan of the operation and the planning CT have different patient identifiers, or one has none.",
    "Stop and find out whose each is; nothing was taken from the scan.",
    own_exit_code=EXIT_REFUSED,
)


NOT_LATER = ErrorCode(
    "CBCT-003",
    DataError,
    "The scan is not known to be one of the operation: it is the planning CT itself or another "
    "reconstruction of that, is older, or has no date.",
    "Export the series that was made after the head was clamped, then repeat the step.",
    own_exit_code=EXIT_REFUSED,
)


OTHER_HEAD = ErrorCode(
    "CBCT-004",
    DataError,
    "The bone of the scan is not that of the planning CT.",
    "Check that both are of this patient and that the scan shows enough of the skull; repeat the scan with "
    "the field on the upper half of the head.",
    own_exit_code=EXIT_REFUSED,
)


class BoneUncertain(RonnaError):
    """Parts of the scan's bone, registered alone, contradict the whole by more than a target may be off."""

    code = "CBCT-005"
    action = "Repeat the scan with more of the skull in its field and the head still."
    exit_code = EXIT_REFUSED


class SpheresContradict(RonnaError):
    """The spheres and the bone place the scan differently in the planning CT.

    Either one of the scans is mirrored or of another head, or the spheres moved together since the CT, as on
    a frame that was refitted elsewhere.
    """

    code = "CBCT-006"
    action = (
        "Find out whether the frame or several screws were changed since the CT and whether a scan is "
        "mirrored. If the spheres were implanted anew, plan on a CT that shows them."
    )
    exit_code = EXIT_REFUSED


class TooFewWhole(RonnaError):
    """The scan shows too few whole spheres; those that its field cuts are named and not used."""

    code = "CBCT-007"
    action = "Aim the field at the spheres, which should be whole with some air around them; scan again."
    exit_code = EXIT_REFUSED
