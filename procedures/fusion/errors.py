"""Errors of fusing another series with a CT, FUS-001 to FUS-009."""

from __future__ import annotations

from ronna_hw.errors import EXIT_REFUSED, EXIT_USAGE, DataError, ErrorCode, RonnaError

FUSION_MISSING = ErrorCode(
    "FUS-001",
    RonnaError,
    "SimpleITK, which registers two series, is not installed.",
    "Run make setup in the clone, or in its environment: pip install 'ronna-hw[fusion]'.",
    own_exit_code=EXIT_USAGE,
)


class NothingToFuse(DataError):
    """A series shows no head, or only part of the one that the CT shows."""

    code = "FUS-002"
    action = "Give two series of the whole head of one patient; the CT in Hounsfield units."
    exit_code = EXIT_REFUSED


OTHER_PATIENT = ErrorCode(
    "FUS-003",
    DataError,
    "The two series have different patient identifiers.",
    "Stop and find out whose each is; nothing was registered.",
    own_exit_code=EXIT_REFUSED,
)


class StartsDisagree(DataError):
    """Registrations from several starts do not lead to one result."""

    code = "FUS-004"
    action = "Compare both series: are they of one head, and does the other series show enough of it?"
    exit_code = EXIT_REFUSED


class PartsDisagree(DataError):
    """Parts of the head, registered alone, contradict the whole by more than a target may be off."""

    code = "FUS-005"
    action = (
        "Take a series of the whole head with thin slices and its geometric distortion corrected in three "
        "dimensions, or choose the targets in the CT."
    )
    exit_code = EXIT_REFUSED


class LandmarksDisagree(DataError):
    """Landmarks that a person gave in both series do not meet."""

    code = "FUS-006"
    action = (
        "Look at the chequerboard and at the landmarks; give them in one order, in the frame of each series."
    )
    exit_code = EXIT_REFUSED


FUSION_UNREADABLE = ErrorCode(
    "FUS-007",
    DataError,
    "The file of a fusion is missing, unreadable, or of another CT.",
    "Make it again with ronna-ct fuse CT_DIR OTHER_DIR --out FILE, on the CT of the plan.",
)


SAME_SERIES = ErrorCode(
    "FUS-008",
    DataError,
    "Both folders contain the same series.",
    "Give the CT first, then the series to fuse with it.",
)


OTHER_FUSION = ErrorCode(
    "FUS-009",
    DataError,
    "The fusion is of another series, or not that by which targets of the plan were chosen.",
    "Give the folder that was fused, and the fusion that the plan names; to use another fusion, first mark "
    "its targets as chosen in the CT.",
)
