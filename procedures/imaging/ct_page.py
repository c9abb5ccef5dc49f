"""Self-contained HTML page of a CT: three scrollable planes, markers and candidates, coordinates on click.

The page holds the CT reduced to 8 bits and fewer voxels, with all slices in one JPEG.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.markers import EVEN, Candidate, Marker
from procedures.imaging.volume import Volume, VoxelGeometry

MOST_VOXELS = 256  # along each axis: a page of a few megabytes that a phone can still show
DARKEST_HU, BRIGHTEST_HU = -1024.0, 2048.0  # air to cortical bone; metal is white
LEVELS = 255
JPEG_QUALITY = 88

TEMPLATE = "ct.html.j2"


def ct_page(
    volume: Volume, name: str, markers: Sequence[Marker], candidates: Sequence[Candidate], outcome: str
) -> str:
    """Render the page, with `name` as its heading and `outcome` summarizing the search in one sentence.

    Neither may name a patient.

    Positions are LPS mm. Doubtful and rejected candidates are listed apart, with reasons and odds.
    """
    import jinja2

    view = view_volume(volume)
    geometry = view.geometry
    picture, across = tile_slices(view)
    not_accepted = [one for one in candidates if not one.accepted]
    content: dict[str, Any] = {
        "shape": geometry.shape,
        "spacing_mm": geometry.spacing_mm.tolist(),
        "origin_mm": geometry.origin_mm.tolist(),
        "axes": geometry.axes.tolist(),
        "orientation": geometry.orientation,
        "hu": [DARKEST_HU, BRIGHTEST_HU],
        "across": across,
        "mosaic": base64.b64encode(picture).decode(),
        "found": [*map(_marker_content, range(1, len(markers) + 1), markers)],
        "doubtful": _candidate_content("doubtful", [one for one in not_accepted if one.doubtful]),
        "rejected": _candidate_content("rejected", [one for one in not_accepted if not one.doubtful]),
    }
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("procedures.imaging", "template"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(TEMPLATE).render(
        name=name, outcome=outcome, warnings=volume.warnings, even=EVEN, content=content
    )


def _marker_content(number: int, marker: Marker) -> dict[str, Any]:
    remarks = [f"sigma {marker.sigma_mm:.3f} mm", f"quality {marker.quality:.2f}", *marker.flags]
    return {
        "name": f"marker {number}",
        "centre_mm": list(marker.centre_mm),
        "radius_mm": marker.radius_mm,
        "odds": marker.odds,
        "remarks": ", ".join(remarks),
    }


def _candidate_content(word: str, candidates: Sequence[Candidate]) -> list[dict[str, Any]]:
    return [
        {
            "name": f"{word} {number}",
            "centre_mm": list(one.centre_mm),
            "radius_mm": one.radius_mm,
            "odds": one.odds,
            "remarks": one.reason,
        }
        for number, one in enumerate(candidates, start=1)
    ]


@dataclass(frozen=True, eq=False)
class ViewVolume:
    """Volume reduced for viewing: grey levels (slices, rows, columns), 0 at -1024 HU and 255 at 2048 HU."""

    grey: NDArray[np.uint8]
    geometry: VoxelGeometry


def view_volume(volume: Volume) -> ViewVolume:
    """Average blocks of voxels down to at most 256 along each axis; incomplete blocks are dropped."""
    geometry = volume.geometry
    factor = [-(-count // MOST_VOXELS) for count in geometry.shape]
    shape = tuple(count // by for count, by in zip(geometry.shape, factor, strict=True))
    slices, rows, columns = shape
    kept = [slice(0, count * by) for count, by in zip(shape, factor, strict=True)]
    grey = np.empty(shape, np.uint8)
    for number in range(slices):  # slice by slice: a whole volume of floats would be large
        block = volume.voxels[number * factor[0] : (number + 1) * factor[0], kept[1], kept[2]]
        mean_hu = block.reshape(factor[0], rows, factor[1], columns, factor[2]).mean(axis=(0, 2, 4))
        share = (mean_hu - DARKEST_HU) / (BRIGHTEST_HU - DARKEST_HU)
        grey[number] = np.round(LEVELS * np.clip(share, 0.0, 1.0))
    by = np.array(factor)
    first_mm = geometry.to_patient_mm((by - 1) / 2)  # centre of the first block
    reduced = VoxelGeometry((slices, rows, columns), first_mm, geometry.axes, geometry.spacing_mm * by)
    return ViewVolume(grey, reduced)


def tile_slices(view: ViewVolume) -> tuple[bytes, int]:
    """Tile all slices row by row into a JPEG; return the JPEG and the number of slices per row."""
    import cv2

    slices, rows, columns = view.grey.shape
    across = math.isqrt(slices - 1) + 1
    down = -(-slices // across)
    tiles = np.zeros((across * down, rows, columns), np.uint8)
    tiles[:slices] = view.grey
    picture = tiles.reshape(down, across, rows, columns).swapaxes(1, 2).reshape(down * rows, across * columns)
    _, encoded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return bytes(encoded), across
