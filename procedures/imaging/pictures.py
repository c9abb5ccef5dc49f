"""What a marker looks like: three planes through its centre with the fitted sphere drawn on them."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.markers import Localization, Marker
from procedures.imaging.region import cut_region
from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

HALF_WIDTH_MM = 14.0
STEP_MM = 0.25  # of the interpolated picture
WINDOW_HU = (-1000.0, 600.0)
DOTS_PER_INCH = 100

# planes of the voxel grid: name, axis across (picture left to right), axis down, axis through
_PLANES = (("slice", 2, 1, 0), ("section along rows", 2, 0, 1), ("section along columns", 1, 0, 2))
_OPPOSITE = {"L": "R", "R": "L", "P": "A", "A": "P", "S": "I", "I": "S"}


def marker_pictures(volume: Volume, localization: Localization) -> tuple[bytes, ...]:
    """A PNG for every marker, in the order of `localization.markers`.

    Each shows the three planes of the voxel grid through the centre with the fitted sphere. Letters name
    the patient's sides.
    """
    return tuple(
        marker_picture(volume, marker, f"marker {number}")
        for number, marker in enumerate(localization.markers, start=1)
    )


def marker_picture(volume: Volume, marker: Marker, title: str) -> bytes:
    """One PNG with three planes through a marker, HU window -1000 to 600."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Circle

    geometry = volume.geometry
    centre_mm = geometry.to_index(marker.centre_mm) * geometry.spacing_mm
    planes = _planes_through(volume, centre_mm)
    sides = geometry.orientation[::-1]  # along slices, rows, columns
    figure = Figure(figsize=(9.6, 3.6), dpi=DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    for place, ((name, across, down, _), picture) in enumerate(zip(_PLANES, planes, strict=True)):
        axes = figure.add_subplot(1, 3, place + 1)
        # index grows downwards in every picture; the slice axis is drawn upwards, head on top
        upwards = down == 0
        extent = (-HALF_WIDTH_MM, HALF_WIDTH_MM, -HALF_WIDTH_MM, HALF_WIDTH_MM)
        axes.imshow(
            picture,
            cmap="gray",
            vmin=WINDOW_HU[0],
            vmax=WINDOW_HU[1],
            extent=extent,
            origin="lower" if upwards else "upper",
        )
        axes.add_patch(Circle((0.0, 0.0), marker.radius_mm, fill=False, color="tab:orange", linewidth=1.2))
        axes.plot([0.0], [0.0], "+", color="tab:cyan", markersize=9)
        right = sides[across]
        top = sides[down] if upwards else _OPPOSITE[sides[down]]
        axes.set_xlabel(f"{_OPPOSITE[right]}  ← mm →  {right}")
        axes.set_ylabel(f"{_OPPOSITE[top]}  ← mm →  {top}")
        axes.set_title(name, fontsize="small")
    x, y, z = marker.centre_mm
    flags = f"   {', '.join(marker.flags)}" if marker.flags else ""
    figure.suptitle(
        f"{title}   LPS ({x:.2f}, {y:.2f}, {z:.2f}) mm   radius {marker.radius_mm:.2f} mm   "
        f"quality {marker.quality:.2f}{flags}",
        fontsize="medium",
    )
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _planes_through(volume: Volume, centre_mm: Array) -> list[Array]:
    """HU of the three planes, (n, n) each: rows along the down axis, columns along the across axis."""
    region = cut_region(volume, centre_mm, HALF_WIDTH_MM + float(volume.geometry.spacing_mm.max()))
    offsets_mm = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM + STEP_MM / 2, STEP_MM)
    planes = []
    for _, across, down, _through in _PLANES:
        points_mm = np.tile(centre_mm, (len(offsets_mm), len(offsets_mm), 1))
        points_mm[:, :, across] += offsets_mm[None, :]
        points_mm[:, :, down] += offsets_mm[:, None]
        planes.append(np.nan_to_num(region.sample(points_mm), nan=WINDOW_HU[0]))
    return planes
