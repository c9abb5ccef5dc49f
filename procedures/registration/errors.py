"""Errors in point correspondence and registration, REG-001 to REG-013."""

from __future__ import annotations

from ronna_hw.errors import DataError, ErrorCode, RefusedError

BAD_POINTS = ErrorCode(
    "REG-001",
    DataError,
    "A point array is not (n, 3) with finite coordinates in mm, or paired arrays differ in length.",
    "Give finite points in mm as an (n, 3) array, one row per pair in both sets.",
)


TOO_FEW_POINTS = ErrorCode(
    "REG-002",
    DataError,
    "Fewer than three pairs, or points of a layout, were given for a rigid transform.",
    "Measure at least three fiducials; five are recommended.",
)


class CollinearPoints(DataError):
    """The points are collinear, so the rotation about their line is undetermined."""

    code = "REG-003"
    action = "Use fiducials that span a plane."


DUPLICATE_POINTS = ErrorCode(
    "REG-004",
    DataError,
    "Two points in a set are closer than two spheres can be, so one sphere was measured twice.",
    "Remove the duplicate point; it would silently count twice.",
)


BAD_COVARIANCE = ErrorCode(
    "REG-005",
    DataError,
    "The covariances are not (n, 3, 3), symmetric and positive definite, in mm2.",
    "Give one symmetric positive definite 3x3 matrix in mm2 per pair.",
)


NOT_CONVERGED = ErrorCode(
    "REG-006",
    DataError,
    "A weighted fit or a cloud registration did not converge, as when its inputs contradict each other.",
    "Check pairing and covariances (for clouds, the start); fit without covariances to see the residuals.",
)


class BadParameter(DataError):
    """A standard deviation, count, prior, confidence or setting of a matcher is invalid."""

    code = "REG-007"
    action = "Give a positive finite length in mm."


NO_UNIQUE_MATCH = ErrorCode(
    "REG-008",
    RefusedError,
    "The correspondence is not unique, so it must not be used.",
    (
        "First make sure that this is the CT of the patient on the table, that left and right in it are "
        "right, and that no sphere was displaced; then add fiducials, or correct the patient's position in "
        "the plan, or its range in the theatre file (recline_deg, head_turn_deg)."
    ),
)


UNSOUND_REGISTRATION = ErrorCode(
    "REG-009",
    RefusedError,
    "The registration is mirrored or ill-posed, so it must not be used.",
    "Check left and right in the series and in the pairing; measure a fiducial outside the plane.",
)


RESIDUAL_TOO_LARGE = ErrorCode(
    "REG-010",
    RefusedError,
    "The residuals are larger than the known localization errors can explain.",
    "Find the fiducial that moved (leave-one-out residuals), or localize again.",
)


SYMMETRIC_CLOUD = ErrorCode(
    "REG-011",
    DataError,
    "A cloud of unpaired points fits in more than one orientation.",
    "Give an approximate transform as the start, or register paired fiducials.",
)


class LayoutNotFound(RefusedError):
    """The spheres of a scan do not contain the requested layout, or match it in more than one way."""

    code = "REG-012"
    action = (
        "Check that the scan and the layout belong together and that the layout is in mm; without "
        "--layout every sphere is listed."
    )


class HeadElsewhere(RefusedError):
    """The head, by a point of it, is elsewhere than expected, or a mirror image cannot be ruled out."""

    code = "REG-013"
    action = (
        "The CT may be mirrored: compare left and right, front and back of the patient with the CT and its "
        "export. Do not continue with this CT before that is clear."
    )
