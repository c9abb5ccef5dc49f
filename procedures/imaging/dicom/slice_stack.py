"""Slice order and geometry from slice positions; only straight, evenly spaced stacks are accepted.

Slice thickness and instance numbers never determine the geometry (DICOM PS3.3 C.7.6.2.1.1). Only numbers can
tell that slices are missing at an end: positions cannot.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from procedures.imaging.dicom.slice_headers import SliceHeader
from procedures.imaging.errors import (
    GANTRY_TILTED,
    ORIENTATION_UNUSABLE,
    SERIES_MIRRORED,
    SERIES_TOO_SHORT,
    SLICE_DUPLICATED,
    SLICES_DIFFER,
    SPACING_UNEVEN,
)
from procedures.imaging.volume import VoxelGeometry
from ronna_hw.arrays import Array
from ronna_hw.text import format_against_limit, format_count

GAPS_NAMED = 3  # in one message
MIN_SLICES = 3  # fewer cannot show that the spacing is even
UNIT_TOLERANCE = 1e-3  # direction cosines are often written with few decimals
SAME_DIRECTION_TOLERANCE = 1e-4
SAME_PLACE_MM = 0.01  # closer slices are duplicates
POSITION_TOLERANCE_MM = 0.05  # positions are often written with few decimals
SHEAR_LIMIT = 5e-4  # sideways drift per mm of stack: 0.1 mm over a head of 200 mm
TILT_LIMIT_DEG = 0.1  # what the scanner states about its gantry
COARSE_SLICE_MM = 2.0  # above this, localization accuracy suffers
COARSE_PIXEL_MM = 1.0
AXIAL_COSINE = 0.9  # of the slices' normal with the body's axis: a head is scanned within 25 degrees of it
HEAD_FIRST = "HF"  # a patient position begins so, DICOM PS3.3 C.7.3.1.1.2
_ROUNDING_MM = 1e-3


def stack_slices(slices: tuple[SliceHeader, ...]) -> tuple[tuple[SliceHeader, ...], VoxelGeometry]:
    """Sort slices along their normal and derive the volume's geometry.

    Raises CT-007 (tilt), CT-008 (orientation), CT-009 (duplicates), CT-010 (gaps), CT-011 (sizes), CT-015,
    CT-025 (mirrored).
    """
    if len(slices) < MIN_SLICES:
        raise SERIES_TOO_SHORT(
            f"the series has {format_count(len(slices), 'slice')}", limit=f"at least {MIN_SLICES} slices"
        )
    _refuse_different_sizes(slices)
    row_direction, column_direction = _average_directions(slices)
    normal = np.cross(row_direction, column_direction)
    _refuse_mirrored(slices[0], normal)
    positions = np.array([one.position_mm for one in slices])
    order = np.argsort(positions @ normal, kind="stable")
    ordered = tuple(slices[index] for index in order)
    positions = positions[order]
    spacing_mm = _fit_even_spacing(ordered, positions @ normal)
    _refuse_shear(ordered, positions, normal)
    first = ordered[0]
    geometry = VoxelGeometry(
        shape=(len(ordered), first.rows, first.columns),
        origin_mm=positions[0],
        # the row index increases along the image's columns, the column index along its rows
        axes=np.column_stack([normal, column_direction, row_direction]),
        spacing_mm=np.array([spacing_mm, first.row_spacing_mm, first.column_spacing_mm]),
    )
    return ordered, geometry


def accuracy_warnings(slices: tuple[SliceHeader, ...], geometry: VoxelGeometry) -> tuple[str, ...]:
    """List factors that may limit localization accuracy, one sentence each; empty for a good protocol."""
    sentences = []
    spacing_mm = float(geometry.spacing_mm[0])
    thickness_mm = max((one.thickness_mm or 0.0 for one in slices), default=0.0)
    coarsest_mm = max(spacing_mm, thickness_mm)
    if coarsest_mm > COARSE_SLICE_MM + _ROUNDING_MM:
        sentences.append(
            f"slices of {coarsest_mm:.2f} mm are thicker than {COARSE_SLICE_MM:g} mm: "
            "the centres will be less accurate"
        )
    if 0 < thickness_mm < spacing_mm - POSITION_TOLERANCE_MM:
        sentences.append(
            f"slices of {thickness_mm:.2f} mm every {spacing_mm:.2f} mm: the scan leaves gaps between slices"
        )
    if geometry.spacing_mm[1:].max() > COARSE_PIXEL_MM + _ROUNDING_MM:
        sentences.append(
            f"pixels of {geometry.spacing_mm[1:].max():.2f} mm are larger than {COARSE_PIXEL_MM:g} mm: "
            "the centres will be less accurate"
        )
    sentences += _warn_incomplete(slices)
    sentences += _warn_unusual_orientation(slices, geometry.axes[:, 0])
    sentences += sorted({oddity for one in slices for oddity in one.oddities})
    return tuple(sentences)


def _warn_incomplete(slices: tuple[SliceHeader, ...]) -> Iterator[str]:
    stated = max((one.stated_count or 0.0 for one in slices), default=0.0)
    if stated > len(slices):
        yield (
            f"the scanner states {stated:.0f} images in the acquisition, the folder has {len(slices)}: "
            "unless the others are of another reconstruction, slices are missing"
        )
    first = min((one.number for one in slices if one.number is not None), default=0.0)
    if first > 1.0:
        yield f"the slices are numbered from {first:.0f}: those before are missing"


def _refuse_mirrored(one: SliceHeader, normal: Array) -> None:
    """Raise CT-025 for slices viewed from the head; scanners store them as viewed from the feet.

    A patient who lies feet first is exempt.
    """
    if normal[2] < -AXIAL_COSINE and one.patient_position.startswith(HEAD_FIRST):
        raise SERIES_MIRRORED(
            f"{one.path.name} shows its slice as seen from the head, a mirror image of what a scanner stores "
            f"for {one.patient_position}",
            expected="1\\0\\0\\0\\1\\0, or the same turned within the slice",
            got="\\".join(f"{value:g}" for value in one.orientation),
        )


def _warn_unusual_orientation(slices: tuple[SliceHeader, ...], normal: Array) -> Iterator[str]:
    """Warn of orientations typical of mirrored or reordered series, although sound series may share them."""
    if abs(normal[2]) < AXIAL_COSINE:
        yield "the slices are not axial: check left and right by eye"
    elif normal[2] < 0.0:
        yield "the slices are stored as seen from the head: check left and right by eye"
    numbers = [one.number for one in slices if one.number is not None]
    if len(numbers) == len(slices) and all(np.diff(numbers) < 0):
        yield "the slices are numbered against their normal: check that the series was not reversed"


def _refuse_different_sizes(slices: tuple[SliceHeader, ...]) -> None:
    first = slices[0]
    for other in slices[1:]:
        if (other.rows, other.columns) != (first.rows, first.columns):
            raise SLICES_DIFFER(
                f"{first.path.name} has {first.rows} x {first.columns} pixels, "
                f"{other.path.name} has {other.rows} x {other.columns}"
            )
        spacings = (other.row_spacing_mm, other.column_spacing_mm)
        if not np.allclose(spacings, (first.row_spacing_mm, first.column_spacing_mm), rtol=1e-5, atol=0):
            raise SLICES_DIFFER(
                f"{first.path.name} has pixels of {first.row_spacing_mm:g} x {first.column_spacing_mm:g} mm, "
                f"{other.path.name} of {spacings[0]:g} x {spacings[1]:g} mm"
            )


def _average_directions(slices: tuple[SliceHeader, ...]) -> tuple[Array, Array]:
    orientations = np.array([one.orientation for one in slices]).reshape(-1, 2, 3)
    lengths = np.linalg.norm(orientations, axis=2)
    skew = np.abs(np.sum(orientations[:, 0] * orientations[:, 1], axis=1))
    bad = (np.abs(lengths - 1).max(axis=1) > UNIT_TOLERANCE) | (skew > UNIT_TOLERANCE)
    if bad.any():
        name = slices[int(np.argmax(bad))].path.name
        raise ORIENTATION_UNUSABLE(f"{name}: the image orientation is not two perpendicular unit vectors")
    spread = np.abs(orientations - np.median(orientations, axis=0)).max(axis=(1, 2))
    if spread.max() > SAME_DIRECTION_TOLERANCE:
        name = slices[int(np.argmax(spread))].path.name
        raise ORIENTATION_UNUSABLE(f"{name} is oriented differently from the other slices")
    row, column = orientations.mean(axis=0)
    row = row / np.linalg.norm(row)
    column = column - row * float(row @ column)
    return row, column / np.linalg.norm(column)


def _fit_even_spacing(slices: tuple[SliceHeader, ...], along_mm: Array) -> float:
    steps_mm = np.diff(along_mm)
    closest = int(np.argmin(steps_mm))
    if steps_mm[closest] < SAME_PLACE_MM:
        raise SLICE_DUPLICATED(
            f"{slices[closest].path.name} and {slices[closest + 1].path.name} have the same position",
            got=f"{steps_mm[closest]:.4f} mm apart",
        )
    usual_mm = float(np.median(steps_mm))
    missing = np.round(steps_mm / usual_mm).astype(int) - 1
    if gaps := np.flatnonzero(missing >= 1).tolist():
        names = [f"{slices[gap].path.name} and {slices[gap + 1].path.name}" for gap in gaps[:GAPS_NAMED]]
        more = f" and in {len(gaps) - GAPS_NAMED} more places" if len(gaps) > GAPS_NAMED else ""
        total = int(missing[gaps].sum())
        raise SPACING_UNEVEN(
            f"{format_count(total, 'slice')} missing between {', between '.join(names)}{more}",
            expected=f"a slice every {usual_mm:.3f} mm",
            got=f"{steps_mm.max():.3f} mm",
        )
    count = np.arange(len(along_mm))
    spacing_mm, start_mm = np.polyfit(count, along_mm, 1)
    deviation_mm = np.abs(along_mm - (start_mm + spacing_mm * count))
    worst = int(np.argmax(deviation_mm))
    if deviation_mm[worst] > POSITION_TOLERANCE_MM:
        raise SPACING_UNEVEN(
            f"{slices[worst].path.name} deviates from the even spacing of {spacing_mm:.3f} mm",
            limit=f"{POSITION_TOLERANCE_MM} mm",
            got=f"{format_against_limit(float(deviation_mm[worst]), POSITION_TOLERANCE_MM, 3)} mm",
        )
    return float(spacing_mm)


def _refuse_shear(slices: tuple[SliceHeader, ...], positions_mm: Array, normal: Array) -> None:
    stated_deg = max((one.tilt_deg for one in slices), key=abs)
    if abs(stated_deg) > TILT_LIMIT_DEG:
        raise GANTRY_TILTED(
            f"the scanner states a gantry tilt of {stated_deg:g} degrees", limit=f"{TILT_LIMIT_DEG} degrees"
        )
    offsets = positions_mm - positions_mm[0]
    along_mm = offsets @ normal
    sideways = offsets - np.outer(along_mm, normal)
    drift = sideways[-1] / along_mm[-1]
    size = float(np.linalg.norm(drift))
    if size > SHEAR_LIMIT and np.linalg.norm(sideways[-1]) > POSITION_TOLERANCE_MM:
        limit_deg = math.degrees(SHEAR_LIMIT)
        raise GANTRY_TILTED(
            "the slices are not stacked along their normal",
            limit=f"{limit_deg:.2f} degrees",
            got=f"{format_against_limit(math.degrees(np.arctan(size)), limit_deg, 2)} degrees",
        )
    deviation_mm = np.linalg.norm(sideways - np.outer(along_mm, drift), axis=1)
    worst = int(np.argmax(deviation_mm))
    if deviation_mm[worst] > POSITION_TOLERANCE_MM:
        raise SPACING_UNEVEN(
            f"{slices[worst].path.name} is shifted sideways relative to the other slices",
            limit=f"{POSITION_TOLERANCE_MM} mm",
            got=f"{format_against_limit(float(deviation_mm[worst]), POSITION_TOLERANCE_MM, 3)} mm",
        )
