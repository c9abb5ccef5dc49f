"""Picture of a fusion: three planes of the CT as a chequerboard with the other series.

Edges that run on from one square into the next show that both lie as they should.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from procedures.fusion.record import Fusion
from procedures.imaging.volume import AIR_HU, Volume
from ronna_hw.arrays import Array

WINDOW_HU = (-200.0, 800.0)  # skin, brain and skull can be told apart
BRIGHT_SHARE = 99.5  # percentile of the other series shown as white
SQUARE_MM = 20.0
HALF_WIDTH_MM = 120.0  # of each plane: a head with some air
STEP_MM = 0.5
GAP_PX = 8
# Across and down of each plane, LPS unit vectors, and the patient's sides at its left and upper edge.
PLANES = (
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "A")),  # axial, from the feet
    ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), ("R", "S")),  # coronal, from the front
    ((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), ("A", "S")),  # sagittal, from the left
)
LETTER_PX, EDGE_PX = 24, 6


def draw_chequerboard(ct: Volume, other: Volume, fusion: Fusion, centre_mm: Sequence[float]) -> bytes:
    """Draw axial, coronal and sagittal planes through a point (3,) mm of the CT, side by side, as a PNG.

    The upper left square of each shows the CT; letters mark the patient's sides.
    """
    from PIL import Image, ImageDraw, ImageFont

    planes = []
    for across, down, _ in PLANES:
        places_mm = _grid_mm(centre_mm, across, down)
        of_ct = _to_grey(ct.sample(places_mm, AIR_HU), *WINDOW_HU)
        there_mm = fusion.ct_from_other.rigid.inv().apply(places_mm.reshape(-1, 3)).reshape(places_mm.shape)
        of_other = _to_grey(other.sample(there_mm, 0.0), *find_grey_limits(other))
        square = np.arange(len(of_ct)) * STEP_MM // SQUARE_MM
        is_other = (square[:, None] + square) % 2 == 1
        planes.append(np.where(is_other, of_other, of_ct))
    gap = np.full((len(planes[0]), GAP_PX), 255, np.uint8)
    sheet = np.hstack([planes[0], gap, planes[1], gap, planes[2]])
    picture, stream = Image.fromarray(sheet), io.BytesIO()
    draw, font, size = ImageDraw.Draw(picture), ImageFont.load_default(LETTER_PX), len(planes[0])
    for number, (_, _, (left, upper)) in enumerate(PLANES):
        start = number * (size + GAP_PX)
        draw.text((start + EDGE_PX, size // 2), left, fill=255, font=font, anchor="lm")
        draw.text((start + size // 2, EDGE_PX), upper, fill=255, font=font, anchor="mt")
    picture.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def find_grey_limits(other: Volume) -> tuple[float, float]:
    """Return the values of another series than the CT that are shown black and white."""
    darkest = float(min(0, other.voxels.min()))
    return darkest, max(darkest + 1.0, float(np.percentile(other.voxels[::2, ::4, ::4], BRIGHT_SHARE)))


def _grid_mm(centre_mm: Sequence[float], across: Sequence[float], down: Sequence[float]) -> Array:
    """Return the places (n, n, 3) mm of a plane's pixels."""
    steps = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM, STEP_MM)
    return np.asarray(
        np.array(centre_mm) + steps[:, None, None] * np.array(down) + steps[None, :, None] * np.array(across)
    )


def _to_grey(values: NDArray[np.float32], darkest: float, brightest: float) -> NDArray[np.uint8]:
    share = np.clip((values - darkest) / (brightest - darkest), 0.0, 1.0)
    return np.asarray(np.rint(255.0 * share), dtype=np.uint8)
