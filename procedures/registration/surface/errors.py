"""Errors in the registration of surfaces, SRF-001 to SRF-037."""

from __future__ import annotations

from ronna_hw.errors import DataError, ErrorCode, RefusedError

BAD_SURFACE_INPUT = ErrorCode(
    "SRF-001",
    DataError,
    "A target, a start or a source of error of a surface registration is not finite or has the wrong shape.",
    "Give finite places in mm as an (n, 3) array, and sources with one row for each look or each point.",
)


LITTLE_COVERAGE = ErrorCode(
    "SRF-002",
    RefusedError,
    "The scan shows too little of the head for a registration.",
    "Turn the head, or tape hair and drapes back, so that face, temples and ears are seen; then scan again.",
)


POORLY_DETERMINED = ErrorCode(
    "SRF-003",
    RefusedError,
    "The scan does not determine a target as well as the case requires.",
    "Turn the head so that more of it is scanned, and run the step again; or begin a new run with more "
    "screws than now: up to three beside the skin (`mixed`), or spheres alone.",
)


TWO_POSES = ErrorCode(
    "SRF-004",
    RefusedError,
    "The scan fits the head in more than one pose.",
    "Touch nose and ears again, and scan again with nose, brows and ears in view; or begin a new run with "
    "more screws than now: up to three beside the skin (`mixed`), or spheres alone.",
)


OTHER_HEAD = ErrorCode(
    "SRF-005",
    RefusedError,
    "The scanned surface does not have the shape of the head in the CT.",
    "Check that this is the CT of the patient on the table, and the clamp: a head that slipped in it during "
    "the scan looks like another one. Clear the skin of hands and drapes, and scan again.",
)


MIRRORED_HEAD = ErrorCode(
    "SRF-006",
    RefusedError,
    "The scan, or a mark on the patient, fits the mirror image of the CT.",
    "Compare left and right of the patient with the CT and its export. Do not continue before that is clear.",
)


HEAD_MOVED = ErrorCode(
    "SRF-007",
    RefusedError,
    "The looks of a scan disagree: the head moved, or the cart did, while it was scanned.",
    "Check the clamp and the cart's brakes, and scan again.",
)


SKIN_CHANGED = ErrorCode(
    "SRF-008",
    RefusedError,
    "The skin is not where it was in the CT over a large part of the scan.",
    "Check the clamp: a head that slipped in it during the scan looks like that. Take off what presses on "
    "the skin, and scan again; or begin a new run with more screws than now: up to three beside the skin "
    "(`mixed`), or spheres alone.",
)


FAR_FROM_START = ErrorCode(
    "SRF-009",
    RefusedError,
    "The registration ended further from its start than the start's error explains.",
    "Check the tracker's frame, then touch or measure nose and ears again; if that does not help, scan "
    "again.",
)


MUCH_EXCLUDED = ErrorCode(
    "SRF-010",
    RefusedError,
    "Too much of the scan is not the head's surface.",
    "Take hands, drapes and tubes out of view, and scan again.",
)


SCANS_APART = ErrorCode(
    "SRF-011",
    DataError,
    "Two scans have too little of the surface in common to be compared.",
    "Scan the same parts of the head again.",
)


SPHERE_MOVED = ErrorCode(
    "SRF-012",
    RefusedError,
    "A sphere is not where the skin, and other spheres if there are any, have it.",
    "Check whether its screw has moved since the CT, or the head in its clamp; then localize again. If the "
    "screw has moved, plan with the other screws, or with the skin alone, and begin a new run.",
)


SPHERE_UNSEEN = ErrorCode(
    "SRF-013",
    RefusedError,
    "The spheres that the tracker sees do not match those of the CT, by nose and ears.",
    "Clear the tracker's view of the spheres, cover what else reflects near the head, and localize with the "
    "tracker again; if the pointer was at another place, touch nose and ears again.",
)


BAD_SCAN = ErrorCode(
    "SRF-020",
    DataError,
    "The arrays of a scan are not finite, differ in length, or have covariances that are none.",
    "Give one finite point, covariance, view, look and line per row, in mm; else scan again.",
)


EMPTY_SCAN = ErrorCode(
    "SRF-021",
    DataError,
    "A scan has no points.",
    "Scan at least one line; check the projector and the light if none was found.",
)

NO_PROJECTOR = ErrorCode(
    "SRF-030",
    RefusedError,
    "The plan has the surface of the head registered, and the stereo head has no line projector.",
    "Name the projector under [stereo.options.projector] of the theatre file, or register by markers.",
)

NO_PATIENT_FRAME = ErrorCode(
    "SRF-031",
    RefusedError,
    "Without markers on the head the tracker sees it move by the frame on its clamp alone; there is none.",
    "Mount the patient's frame on the clamp and name it as patient_frame in the theatre file.",
)

NOTHING_LIT = ErrorCode(
    "SRF-032",
    RefusedError,
    "No look shows the line of the projector on the skin.",
    "Check that the projector lights and its window is clean, take drapes off the face, and scan again.",
)

NO_STATIONS = ErrorCode(
    "SRF-033",
    RefusedError,
    "The arm cannot look at enough of the skin.",
    "Turn the head or move the cart so that the arm reaches face and temples, or register by markers.",
)

ARM_NOT_CALIBRATED = ErrorCode(
    "SRF-034",
    RefusedError,
    "The arm has no calibration record: seen from many sides, the skin would look like another head.",
    "Calibrate the arm and name its record in the theatre file, or register by markers.",
)

CARRIED_DIFFERS = ErrorCode(
    "SRF-035",
    RefusedError,
    "After a move of the clamp, the skin is not where its frame has carried the registration.",
    "Go on with the next step: the landmarks are touched again, and the whole skin is scanned.",
)

HALF_A_HEAD = ErrorCode(
    "SRF-037",
    RefusedError,
    "The CT ends above the nose and the ears: too little skin to scan is in it.",
    "Import a CT from the vertex to below the nose, or register by markers.",
)
