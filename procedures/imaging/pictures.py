"""Draw a marker: three planes through its centre with the fitted sphere."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from textwrap import fill

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.markers import Candidate, Localization, Marker
from procedures.imaging.volume import Volume, VoxelGeometry, cut_region

Array = NDArray[np.float64]

HALF_WIDTH_MM = 14.0
STEP_MM = 0.25  # of the interpolated image
WINDOW_HU = (-1000.0, 600.0)
DOTS_PER_INCH = 100
SIZE_IN = (9.6, 4.8)
MARGINS = {"left": 0.08, "right": 0.99, "bottom": 0.13, "top": 0.74, "wspace": 0.32}  # shares of the image
# A page shows the image at a third to a half of its size; these sizes stay legible.
HEADING_POINTS, PLANE_POINTS, TICK_POINTS = 17, 15, 12
HEADING_LETTERS = 64  # per line

UNSCANNED_COLOUR = "#1f2f5f"  # unlike the black of air
STRAIGHT_DEG = 10.0  # a plane tilted by more is called oblique

# planes of the voxel grid: axis across (left to right), axis down, axis through
_PLANES = ((2, 1, 0), (2, 0, 1), (1, 0, 2))
_NAMES = {"L": "sagittal", "R": "sagittal", "P": "coronal", "A": "coronal", "S": "axial", "I": "axial"}
_OPPOSITE = {"L": "R", "R": "L", "P": "A", "A": "P", "S": "I", "I": "S"}


def draw_markers(volume: Volume, localization: Localization) -> tuple[bytes, ...]:
    """Draw a PNG for every marker, in the order of `localization.markers`.

    Each shows three planes of the voxel grid through the centre with the fitted sphere. Letters mark the
    patient's sides; blue is outside the scan.
    """
    return tuple(
        draw_marker(volume, marker, f"marker {number}")
        for number, marker in enumerate(localization.markers, start=1)
    )


def draw_marker(volume: Volume, marker: Marker, title: str) -> bytes:
    """Draw one PNG with three planes through a marker, HU window -1000 to 600."""
    heading = (
        f"{title}   LPS {_as_text(marker.centre_mm)} mm\n"
        f"sigma {marker.sigma_mm:.3f} mm   radius {marker.radius_mm:.2f} mm   quality {marker.quality:.2f}"
    )
    if marker.flags:
        heading += f"\n{fill(', '.join(marker.flags).replace('_', ' '), HEADING_LETTERS)}"
    return _draw_picture(volume, np.array(marker.centre_mm), marker.radius_mm, heading)


def draw_candidates(volume: Volume, candidates: Sequence[Candidate]) -> tuple[bytes, ...]:
    """Draw a PNG for every candidate, in order, with the verdict; a ring where a surface was found."""
    return tuple(
        _draw_picture(
            volume,
            np.array(one.centre_mm),
            one.radius_mm,
            f"candidate {number}   LPS {_as_text(one.centre_mm)} mm\n{fill(one.reason, HEADING_LETTERS)}",
        )
        for number, one in enumerate(candidates, start=1)
    )


def _as_text(centre_mm: Iterable[float]) -> str:
    return f"({', '.join(f'{value:z.2f}' for value in centre_mm)})"


def _draw_picture(volume: Volume, middle_mm: Array, radius_mm: float | None, heading: str) -> bytes:
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    geometry = volume.geometry
    centre_mm = geometry.to_index(middle_mm) * geometry.spacing_mm
    planes = _sample_planes(volume, centre_mm)
    sides = geometry.orientation[::-1]  # along slices, rows, columns
    figure = Figure(figsize=SIZE_IN, dpi=DOTS_PER_INCH)
    figure.subplots_adjust(**MARGINS)  # computing them for each image would double its time
    canvas = FigureCanvasAgg(figure)
    colours = colormaps["gray"].with_extremes(bad=UNSCANNED_COLOUR)
    for place, ((across, down, through), picture) in enumerate(zip(_PLANES, planes, strict=True)):
        axes = figure.add_subplot(1, 3, place + 1)
        # the index increases downwards in every image; the slice axis is drawn upwards, head on top
        is_upwards = down == 0
        extent = (-HALF_WIDTH_MM, HALF_WIDTH_MM, -HALF_WIDTH_MM, HALF_WIDTH_MM)
        axes.imshow(
            picture,
            cmap=colours,
            vmin=WINDOW_HU[0],
            vmax=WINDOW_HU[1],
            extent=extent,
            origin="lower" if is_upwards else "upper",
        )
        if radius_mm is not None:
            axes.add_patch(Circle((0.0, 0.0), radius_mm, fill=False, color="tab:orange", linewidth=1.2))
        axes.plot([0.0], [0.0], "+", color="tab:cyan", markersize=9)
        right = sides[across]
        top = sides[down] if is_upwards else _OPPOSITE[sides[down]]
        axes.set_xlabel(f"{_OPPOSITE[right]}  ← mm →  {right}", fontsize=PLANE_POINTS)
        axes.set_ylabel(f"{_OPPOSITE[top]}  ← mm →  {top}", fontsize=PLANE_POINTS)
        axes.set_title(_plane_name(geometry, through), fontsize=PLANE_POINTS)
        axes.tick_params(labelsize=TICK_POINTS)
    figure.suptitle(heading, fontsize=HEADING_POINTS)
    stream = io.BytesIO()
    canvas.print_png(stream, metadata={"Software": None})
    return stream.getvalue()


def _sample_planes(volume: Volume, centre_mm: Array) -> list[Array]:
    """Sample the three planes, (n, n) HU each: rows along the down axis, columns along the across axis.

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
    """Clinical name of the plane across a grid axis."""
    name = _NAMES[geometry.orientation[2 - through]]
    along = float(np.abs(geometry.axes[:, through]).max())
    is_oblique = along < np.cos(np.radians(STRAIGHT_DEG))
    return f"oblique, nearly {name}" if is_oblique else name
