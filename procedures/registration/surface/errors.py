"""Errors in scans of a surface and their registration, SRF-020 to SRF-021."""

from __future__ import annotations

from ronna_hw.errors import DataError, ErrorCode

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
