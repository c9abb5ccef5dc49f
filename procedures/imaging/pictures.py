"""Marker pictures: three planes through the centre, with the fitted sphere."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from textwrap import fill

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from procedures.imaging.markers import Candidate, Localization, Marker
from procedures.imaging.volume import Volume, VoxelGeometry, cut_region
from ronna_hw.arrays import Array

HALF_WIDTH_MM = 14.0
STEP_MM = 0.25  # of the interpolated image
WINDOW_HU = (-1000.0, 600.0)
SIZE_PX = (960, 480)
PLANE_SIDE_PX = 240
CORNERS_PX = tuple((left, 148) for left in (77, 393, 709))  # upper left ones of the planes
# A page shows the image at a third to a half of its size; these letters stay legible.
HEADING_PX, PLANE_PX, TICK_PX = 24, 21, 17
HEADING_LETTERS = 64  # per line
TICKS_MM = (-10, 0, 10)
TICK_LENGTH_PX, CROSS_PX = 5, 6
RING_COLOUR, CROSS_COLOUR = "#ff7f0e", "#17becf"

UNSCANNED_COLOUR = "#1f2f5f"  # unlike the black of air
STRAIGHT_DEG = 10.0  # a plane tilted by more is called oblique

# planes of the voxel grid: axis across (left to right), axis down, axis through
_PLANES = ((2, 1, 0), (2, 0, 1), (1, 0, 2))
_NAMES = {"L": "sagittal", "R": "sagittal", "P": "coronal", "A": "coronal", "S": "axial", "I": "axial"}
_OPPOSITE = {"L": "R", "R": "L", "P": "A", "A": "P", "S": "I", "I": "S"}


def draw_markers(
    volume: Volume, localization: Localization, numbers: Sequence[int] | None = None
) -> tuple[bytes, ...]:
    """Draw a PNG of each marker, in the order of `localization.markers`, by default numbered from 1.

    Each shows three planes of the voxel grid through the centre with the fitted sphere. Letters mark the
    patient's sides; blue is outside the scan.
    """
    sheet = _Sheet(volume)
    return tuple(
        sheet.draw(np.array(marker.centre_mm), marker.radius_mm, _head_marker(marker, number))
        for number, marker in zip(
            numbers or range(1, len(localization.markers) + 1), localization.markers, strict=True
        )
    )


def _head_marker(marker: Marker, number: int) -> str:
    heading = (
        f"marker {number}   LPS {_as_text(marker.centre_mm)} mm\n"
        f"sigma {marker.sigma_mm:.3f} mm   radius {marker.radius_mm:.2f} mm   quality {marker.quality:.2f}"
    )
    if marker.flags:
        heading += f"\n{fill(', '.join(marker.flags).replace('_', ' '), HEADING_LETTERS)}"
    return heading


def draw_candidates(volume: Volume, candidates: Sequence[Candidate]) -> tuple[bytes, ...]:
    """Draw a PNG of each candidate with its verdict, and a ring where a surface was found."""
    sheet = _Sheet(volume)
    return tuple(
        sheet.draw(
            np.array(one.centre_mm),
            one.radius_mm,
            f"candidate {number}   LPS {_as_text(one.centre_mm)} mm\n{fill(one.reason, HEADING_LETTERS)}",
        )
        for number, one in enumerate(candidates, start=1)
    )


def _as_text(centre_mm: Iterable[float]) -> str:
    return f"({', '.join(f'{value:z.2f}' for value in centre_mm)})"


class _Sheet:
    """Reusable image showing three planes of a volume's grid.

    What all pictures share, such as scales and letters, is drawn once.
    """

    def __init__(self, volume: Volume) -> None:
        self._volume = volume
        self._heading_font = ImageFont.load_default(HEADING_PX)
        self._blank = Image.new("RGB", SIZE_PX, "white")
        draw = ImageDraw.Draw(self._blank)
        plane_font, tick_font = ImageFont.load_default(PLANE_PX), ImageFont.load_default(TICK_PX)
        geometry = volume.geometry
        sides = geometry.orientation[::-1]  # along slices, rows, columns
        for (left, top), (across, down, through) in zip(CORNERS_PX, _PLANES, strict=True):
            right, bottom = left + PLANE_SIDE_PX, top + PLANE_SIDE_PX
            middle = left + PLANE_SIDE_PX / 2, top + PLANE_SIDE_PX / 2
            for tick_mm in TICKS_MM:
                place_px = (tick_mm / HALF_WIDTH_MM + 1.0) * PLANE_SIDE_PX / 2
                height_px = bottom - place_px
                draw.line((left + place_px, bottom, left + place_px, bottom + TICK_LENGTH_PX), "black")
                draw.line((left - TICK_LENGTH_PX, height_px, left, height_px), "black")
                text = f"{tick_mm:d}"
                draw.text((left + place_px, bottom + 20), text, "black", tick_font, "mm")
                draw.text((left - 8, height_px), text, "black", tick_font, "rm")
            draw.text((middle[0], top - 18), _plane_name(geometry, through), "black", plane_font, "mm")
            for x, text in ((left, _OPPOSITE[sides[across]]), (middle[0], "mm"), (right, sides[across])):
                draw.text((x, bottom + 46), text, "black", plane_font, "mm")
            # the index increases downwards in every image; the slice axis is drawn upwards, head on top
            above = sides[down] if down == 0 else _OPPOSITE[sides[down]]
            for y, text in ((top, above), (middle[1], "mm"), (bottom, _OPPOSITE[above])):
                draw.text((left - 48, y), text, "black", plane_font, "mm")

    def draw(self, middle_mm: Array, radius_mm: float | None, heading: str) -> bytes:
        """Draw a PNG of the planes through a position (LPS), with a ring if a radius is known."""
        geometry = self._volume.geometry
        planes = _sample_planes(self._volume, geometry.to_index(middle_mm) * geometry.spacing_mm)
        sheet = self._blank.copy()
        draw = ImageDraw.Draw(sheet)
        for (left, top), (_across, down, _through), plane in zip(CORNERS_PX, _PLANES, planes, strict=True):
            sheet.paste(_colour_plane(plane[::-1] if down == 0 else plane), (left, top))
            x, y = left + PLANE_SIDE_PX / 2, top + PLANE_SIDE_PX / 2
            draw.rectangle((left, top, left + PLANE_SIDE_PX, top + PLANE_SIDE_PX), outline="black")
            if radius_mm is not None:
                ring_px = radius_mm * PLANE_SIDE_PX / (2 * HALF_WIDTH_MM)
                draw.circle((x, y), ring_px, outline=RING_COLOUR, width=2)
            draw.line((x - CROSS_PX, y, x + CROSS_PX, y), CROSS_COLOUR, 2)
            draw.line((x, y - CROSS_PX, x, y + CROSS_PX), CROSS_COLOUR, 2)
        draw.text((SIZE_PX[0] / 2, 10), heading, "black", self._heading_font, "ma", align="center")
        stream = io.BytesIO()
        sheet.save(stream, "png")
        return stream.getvalue()


def _colour_plane(plane: Array) -> Image.Image:
    """Return a plane in grey, enlarged to its side in the picture; what was not scanned is blue."""
    low, high = WINDOW_HU
    grey = np.clip((np.nan_to_num(plane, nan=low) - low) * (255.0 / (high - low)), 0.0, 255.0)
    size = PLANE_SIDE_PX, PLANE_SIDE_PX
    image = Image.fromarray(grey.astype(np.uint8)).resize(size, Image.Resampling.BILINEAR).convert("RGB")
    unscanned = Image.fromarray(np.isnan(plane).astype(np.uint8) * 255).resize(size, Image.Resampling.NEAREST)
    image.paste(UNSCANNED_COLOUR, mask=unscanned)
    return image


def _sample_planes(volume: Volume, centre_mm: Array) -> list[Array]:
    """Sample the three planes, (n, n) HU each; rows follow the down axis, columns the across axis.

    NaN outside the scan.
    """
    region = cut_region(volume, centre_mm, HALF_WIDTH_MM + float(volume.geometry.spacing_mm.max()))
    offsets_mm = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM + STEP_MM / 2, STEP_MM)
    planes = []
    for across, down, _through in _PLANES:
        points_mm = np.tile(centre_mm, (len(offsets_mm), len(offsets_mm), 1))
        points_mm[:, :, across] += offsets_mm[None, :]
        points_mm[:, :, down] += offsets_mm[:, None]
        planes.append(region.sample(points_mm))
    return planes


def _plane_name(geometry: VoxelGeometry, through: int) -> str:
    """Return the clinical name of the plane perpendicular to a grid axis."""
    name = _NAMES[geometry.orientation[2 - through]]
    along = float(np.abs(geometry.axes[:, through]).max())
    is_oblique = along < np.cos(np.radians(STRAIGHT_DEG))
    return f"oblique, nearly {name}" if is_oblique else name
