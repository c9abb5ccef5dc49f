"""Pictures of a page's slices, of the CT and of a series fused with it, and the routes that serve them."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from console.planning.fused_series import FusedSeries, ShownSeries
from console.planning.plan_editor import PlanEditor
from console.planning.slices import SIZE_PX, WINDOWS_HU, Cut
from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array

UNSCANNED_HU = -32768  # no CT has this value
UNSCANNED_GREY = 40  # unlike the black of air
ALIGNED = 1e-6  # of a voxel per pixel: below this an image stays in one slice
PNG_LEVEL = 0  # the network is this computer, and compression takes longer than everything else
SQUARE_PX = 64  # of a chequerboard: it stays while slices and zoom change below it
FARTHEST_MM = 10_000.0
LEAST_STEP_MM, MOST_STEP_MM = 0.001, 100.0
UNIT = 1e-3  # tolerance on the length of a direction, and on the right angle between two


def render_png(
    volume: Volume,
    cut: Cut,
    window_hu: tuple[float, float],
    fused: FusedSeries | None = None,
    series: ShownSeries = ShownSeries.CT,
) -> bytes:
    """Render a PNG image of the CT, with the window mapped from black to white, or of a series fused with it.

    In a chequerboard of both the upper left square shows the CT.
    """
    if fused is None or series is ShownSeries.CT:
        grey = _draw_grey(volume, cut, window_hu)
    else:
        grey = _draw_grey(fused.volume, cut, fused.grey_limits)
        if series is ShownSeries.BOTH:
            square = np.arange(SIZE_PX) // SQUARE_PX
            is_ct = (square[:, None] + square) % 2 == 0
            grey[is_ct] = _draw_grey(volume, cut, window_hu)[is_ct]
    _, encoded = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    return bytes(encoded)


def _draw_grey(volume: Volume, cut: Cut, window: tuple[float, float]) -> NDArray[np.uint8]:
    low, high = window
    values = sample_cut_hu(volume, cut)
    grey = cv2.convertScaleAbs(np.clip(values, low, high) - np.float32(low), alpha=255.0 / (high - low))
    grey[values == UNSCANNED_HU] = UNSCANNED_GREY
    return np.asarray(grey, dtype=np.uint8)


def sample_cut_hu(volume: Volume, cut: Cut) -> NDArray[np.int16]:
    """Return the HU or values of every pixel (rows, columns), interpolated between oblique slices."""
    geometry = volume.geometry
    first = geometry.to_index(np.array(cut.to_patient_mm(0.5, 0.5)))
    per_px = (
        cut.step_mm * np.stack([cut.right @ geometry.axes, cut.down @ geometry.axes]) / geometry.spacing_mm
    )
    across = np.flatnonzero(np.abs(per_px).max(axis=0) * SIZE_PX < ALIGNED)
    if len(across) != 1:
        return _interpolate_between_slices(volume, first, per_px)
    (axis,) = across
    number = round(float(first[axis]))
    if not 0 <= number < volume.voxels.shape[axis]:
        return np.full((SIZE_PX, SIZE_PX), UNSCANNED_HU, np.int16)
    row, column = (item for item in range(3) if item != axis)
    mapping = np.array(
        [[per_px[0, column], per_px[1, column], first[column]], [per_px[0, row], per_px[1, row], first[row]]]
    )
    return np.asarray(
        cv2.warpAffine(
            np.ascontiguousarray(np.take(volume.voxels, number, axis=axis)),
            mapping,
            (SIZE_PX, SIZE_PX),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=UNSCANNED_HU,
        ),
        dtype=np.int16,
    )


def _interpolate_between_slices(volume: Volume, first: Array, per_px: Array) -> NDArray[np.int16]:
    from scipy import ndimage

    matrix = np.stack([per_px[1], per_px[0], np.zeros(3)], axis=1)
    hu = ndimage.affine_transform(
        volume.voxels,
        matrix,
        offset=first,
        output_shape=(SIZE_PX, SIZE_PX, 1),
        order=1,
        mode="constant",
        cval=UNSCANNED_HU,
        prefilter=False,
    )
    return np.asarray(hu[..., 0])


def add_pictures(app: Any, editor: PlanEditor) -> None:
    """Serve the images of a plan's series at URLs that do not reveal the patient."""

    async def cut(request: Request) -> Response:
        try:
            wanted, window, series = _parse_request(dict(request.query_params))
        except (KeyError, ValueError):
            return PlainTextResponse("No such picture.", 404)
        if editor.fused is None and series is not ShownSeries.CT:
            return PlainTextResponse("No series is fused.", 404)
        picture = await asyncio.to_thread(render_png, editor.volume, wanted, window, editor.fused, series)
        return Response(picture, media_type="image/png")

    async def head(_request: Request) -> Response:
        return Response(editor.head, media_type="model/stl") if editor.head else PlainTextResponse("", 404)

    app.add_route("/cut.png", cut, methods=["GET"])
    app.add_route("/picture/head.stl", head, methods=["GET"])


def _parse_request(given: dict[str, str]) -> tuple[Cut, tuple[float, float], ShownSeries]:
    """Parse an image request. Raises KeyError or ValueError if it is invalid."""
    middle, right, down = (_parse_vector(given[name]) for name in "mrd")
    step_mm = float(given["s"])
    is_orthonormal = abs(right @ down) < UNIT and all(
        abs(np.linalg.norm(item) - 1.0) < UNIT for item in (right, down)
    )
    if not (
        is_orthonormal and LEAST_STEP_MM <= step_mm <= MOST_STEP_MM and np.abs(middle).max() <= FARTHEST_MM
    ):
        raise ValueError("no picture")
    return Cut(middle, right, down, step_mm), WINDOWS_HU[given["w"]], ShownSeries(given["o"])


def _parse_vector(words: str) -> Any:
    values = [float(item) for item in words.split(",")]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError("expected three numbers")
    return np.array(values)
