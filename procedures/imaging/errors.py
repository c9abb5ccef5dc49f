"""Errors in CT series and sphere localization, CT-001 to CT-028."""

from __future__ import annotations

from procedures.imaging.markers import Candidate, likeliest_first
from ronna_hw.errors import EXIT_REFUSED, DataError, ErrorCode

LISTED_CANDIDATES = 8  # in the message; the error carries all of them


SERIES_NOT_FOUND = ErrorCode(
    "CT-001",
    DataError,
    "The series folder does not exist or is a file.",
    "Give the folder that holds the DICOM files of one CT series.",
)


SERIES_EMPTY = ErrorCode(
    "CT-002",
    DataError,
    "The folder contains no DICOM images.",
    "Give the folder that holds the DICOM files of one CT series; subfolders are not searched.",
)


class SeriesMixed(DataError):
    """The folder contains images from more than one series."""

    code = "CT-003"
    action = "Put each series into its own folder and give one of them."


WRONG_MODALITY = ErrorCode(
    "CT-004",
    DataError,
    "The images are not CT slices.",
    "Export the CT as single-slice CT images.",
)


FILE_DAMAGED = ErrorCode(
    "CT-005",
    DataError,
    "A file is truncated or not readable as DICOM.",
    "If the series is still being copied, wait for its end; else copy or export the file again.",
)


class FramesMixed(DataError):
    """The slices belong to more than one frame of reference."""

    code = "CT-006"
    action = "Export the series again; positions of different frames of reference cannot be compared."


GANTRY_TILTED = ErrorCode(
    "CT-007",
    DataError,
    "The slices are sheared relative to each other.",
    "Scan without gantry tilt, or export a reconstruction without it.",
)


ORIENTATION_UNUSABLE = ErrorCode(
    "CT-008",
    DataError,
    "The image orientation is not a pair of perpendicular unit vectors, or differs between slices.",
    "Export the series again with one valid orientation for all slices.",
)


SLICE_DUPLICATED = ErrorCode(
    "CT-009",
    DataError,
    "Two slices have the same position.",
    "Remove the duplicates; if they differ, export the series again.",
)


SPACING_UNEVEN = ErrorCode(
    "CT-010",
    DataError,
    "Slices are missing or not evenly spaced.",
    (
        "If the series is still being copied, wait for its end; else export the complete series with one "
        "slice spacing."
    ),
)


SLICES_DIFFER = ErrorCode(
    "CT-011",
    DataError,
    "Slices differ in size or pixel spacing.",
    "Export the series again with one matrix and one pixel spacing.",
)


ATTRIBUTE_MISSING = ErrorCode(
    "CT-012",
    DataError,
    "A DICOM attribute needed for geometry or intensities is missing or unusable.",
    "Export the series again with complete headers.",
)


COMPRESSION_UNKNOWN = ErrorCode(
    "CT-013",
    DataError,
    "The pixel data are compressed in a format that no installed decoder supports.",
    "Export without compression, or install the decoders: pip install 'ronna-hw[compressed]'.",
)


PIXELS_UNUSABLE = ErrorCode(
    "CT-014",
    DataError,
    "The pixel format is not that of a CT slice.",
    "Export the CT as monochrome images of one sample per pixel.",
)


SERIES_TOO_SHORT = ErrorCode(
    "CT-015",
    DataError,
    "There are too few slices to form a volume.",
    "Export the whole series.",
)


class MarkerCountWrong(DataError):
    """The number of markers differs from what was expected; `candidates` lists everything examined."""

    code = "CT-016"
    action = (
        "Compare the candidates with the images; scan again, correct the expected count or diameter, or "
        "--pick."
    )
    page_action = "Compare the candidates with the images; scan again, or correct the expected count."
    exit_code = EXIT_REFUSED

    def __init__(self, what: str, *, candidates: tuple[Candidate, ...]) -> None:
        self.candidates = candidates
        likely = likeliest_first(candidates)[:LISTED_CANDIDATES]
        listed = ", ".join(candidate.describe() for candidate in likely)
        more = len(candidates) - LISTED_CANDIDATES
        if more > 0:
            listed += f" and {more} less likely"
        super().__init__(f"{what}; candidates: {listed or 'none'}")


LOCALIZATION_MISUSED = ErrorCode(
    "CT-017",
    DataError,
    "The localizer was given an invalid diameter or count.",
    "Give a marker diameter that the voxels can resolve, and a count that is not negative.",
)


class PicksUnreadable(DataError):
    """The picks file is missing or is not a list of points."""

    code = "CT-018"
    action = "Give CSV rows or a JSON list of L, P, S in mm, a file from --write, or a 3D Slicer point list."


class PickRefused(DataError):
    """No sphere was found at a pick."""

    code = "CT-019"
    action = "Check the images there; pick the middle of the sphere, or omit this sphere."
    exit_code = EXIT_REFUSED


RESCALE_UNUSABLE = ErrorCode(
    "CT-020",
    DataError,
    "The stored values cannot be converted to Hounsfield units.",
    "Export the series again in Hounsfield units, with the scanner's intensities.",
)


SCOUT_VIEW = ErrorCode(
    "CT-021",
    DataError,
    "A file is a scout view (localizer radiograph), not a slice.",
    "Export the slices only, without the scout view.",
)


VOLUME_MALFORMED = ErrorCode(
    "CT-022",
    DataError,
    "A volume built without a series has voxels or a geometry that no CT can have.",
    "Give int16 voxels (slices, rows, columns) in HU and their geometry.",
)


class PatientMoved(DataError):
    """The patient moved between two slices."""

    code = "CT-023"
    action = "Fix the head and scan again; what lies on both sides of the move does not belong together."


class ScanDeformed(DataError):
    """The shapes of the spheres show that the scan is stretched or sheared against what the headers state."""

    code = "CT-024"
    action = "Have the scanner's table feed, pixel size and gantry tilt checked, and scan again."
    exit_code = EXIT_REFUSED


SERIES_MIRRORED = ErrorCode(
    "CT-025",
    DataError,
    "The image orientation contradicts the patient position; no scanner stores slices this way.",
    (
        "Left and right may be swapped: export the series again from the scanner's archive, without a change "
        "of orientation."
    ),
    own_exit_code=EXIT_REFUSED,
)


ADHESIVE_COUNT_WRONG = ErrorCode(
    "CT-026",
    DataError,
    "The CT shows no adhesive rings, or another number than expected.",
    "Look at the skin in the CT: a ring may be bent, touch a support, or be outside the field.",
    own_exit_code=EXIT_REFUSED,
)


KERNEL_UNNAMED = ErrorCode(
    "CT-027",
    DataError,
    "A series for a case does not name its kernel, so the errors of its spheres are unknown.",
    (
        "Export the series again with its acquisition parameters, or have it reconstructed anew with a usual "
        "kernel, soft to sharp. To look at it without a case: ronna-ct localize."
    ),
    own_exit_code=EXIT_REFUSED,
)


NO_SURFACE = ErrorCode(
    "CT-028",
    DataError,
    "The CT shows no head, or no skin or bone of it that is free.",
    "Give a CT in Hounsfield units that shows the head with air around it, also where it is to be scanned.",
    own_exit_code=EXIT_REFUSED,
)
