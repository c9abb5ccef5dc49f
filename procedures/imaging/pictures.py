"""Marker pictures: three planes through the centre, with the fitted sphere."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from textwrap import fill
from typing import Any

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
    """Draw a PNG of each marker, in the order of `localization.markers`.

    Each shows three planes of the voxel grid through the centre with the fitted sphere. Letters mark the
    patient's sides; blue is outside the scan.
    """
    sheet = _Sheet(volume)
    return tuple(
        sheet.draw(np.array(marker.centre_mm), marker.radius_mm, _head_marker(marker, number))
        for number, marker in enumerate(localization.markers, start=1)
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
    """Reusable figure showing three planes of a volume's grid.

    What all pictures share, such as axes and letters, is drawn once and kept as pixels.
    """

    def __init__(self, volume: Volume) -> None:
        from matplotlib import colormaps
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
        from matplotlib.patches import Circle

        self._volume = volume
        geometry = volume.geometry
        sides = geometry.orientation[::-1]  # along slices, rows, columns
        self._figure = Figure(figsize=SIZE_IN, dpi=DOTS_PER_INCH)
        self._figure.subplots_adjust(**MARGINS)  # computing them for each image would double its time
        self._canvas = FigureCanvasAgg(self._figure)
        self._axes, self._images, self._circles, self._crosses = [], [], [], []
        colours = colormaps["gray"].with_extremes(bad=UNSCANNED_COLOUR)
        for place, (across, down, through) in enumerate(_PLANES):
            axes = self._figure.add_subplot(1, 3, place + 1)
            # the index increases downwards in every image; the slice axis is drawn upwards, head on top
            is_upwards = down == 0
            image = axes.imshow(
                np.full((2, 2), np.nan),
                cmap=colours,
                vmin=WINDOW_HU[0],
                vmax=WINDOW_HU[1],
                extent=(-HALF_WIDTH_MM, HALF_WIDTH_MM, -HALF_WIDTH_MM, HALF_WIDTH_MM),
                origin="lower" if is_upwards else "upper",
                animated=True,  # left out of what is drawn once
            )
            circle = Circle((0.0, 0.0), 1.0, fill=False, color="tab:orange", linewidth=1.2, animated=True)
            axes.add_patch(circle)
            (cross,) = axes.plot([0.0], [0.0], "+", color="tab:cyan", markersize=9, animated=True)
            right = sides[across]
            top = sides[down] if is_upwards else _OPPOSITE[sides[down]]
            axes.set_xlabel(f"{_OPPOSITE[right]}  ← mm →  {right}", fontsize=PLANE_POINTS)
            axes.set_ylabel(f"{_OPPOSITE[top]}  ← mm →  {top}", fontsize=PLANE_POINTS)
            axes.set_title(_plane_name(geometry, through), fontsize=PLANE_POINTS)
            axes.tick_params(labelsize=TICK_POINTS)
            for spine in axes.spines.values():  # the image would cover half of them
                spine.set_animated(True)
            self._axes.append(axes)
            self._images.append(image)
            self._circles.append(circle)
            self._crosses.append(cross)
        self._heading = self._figure.suptitle("", fontsize=HEADING_POINTS, animated=True)
        self._canvas.draw()
        self._shared = self._canvas.copy_from_bbox(self._figure.bbox)

    def draw(self, middle_mm: Array, radius_mm: float | None, heading: str) -> bytes:
        """Draw a PNG of the planes through a position (LPS), with a ring if a radius is known."""
        from matplotlib.image import imsave

        geometry = self._volume.geometry
        planes = _sample_planes(self._volume, geometry.to_index(middle_mm) * geometry.spacing_mm)
        self._canvas.restore_region(self._shared)
        for axes, image, circle, cross, plane in zip(
            self._axes, self._images, self._circles, self._crosses, planes, strict=True
        ):
            image.set_data(plane)
            axes.draw_artist(image)
            if radius_mm is not None:
                circle.set_radius(radius_mm)
                axes.draw_artist(circle)
            axes.draw_artist(cross)
            for spine in axes.spines.values():
                axes.draw_artist(spine)
        self._heading.set_text(heading)
        self._figure.draw_artist(self._heading)
        stream = io.BytesIO()
        nameless: dict[str, Any] = {"Software": None}
        imsave(stream, self._canvas.buffer_rgba(), format="png", dpi=DOTS_PER_INCH, metadata=nameless)
        return stream.getvalue()


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
