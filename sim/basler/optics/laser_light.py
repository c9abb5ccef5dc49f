"""Light of a projected line on the sensor: its core with speckle, and the glow of light scattered in skin.

Across the line the light is a sum of Gaussians and of an exponential, known at each row (or column) that the
line crosses: widths of beam, scattering and lens blur add up in squares. The far glow is smooth over many
pixels and drawn on a coarse grid.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.basler.optics.canvas import Area, Image, Lens, PixelCanvas, blur
from sim.basler.optics.laser_line import LineRun
from sim.basler.optics.speckle import Speckle
from sim.world.rigid import Array

WINDOW_SIGMAS = 3.5
NEAR_SPECKLE = 0.3  # of the contrast: light from below the surface has lost most of its coherence (U)
COARSE_PX = 8  # of the far glow
FAR_REACH = 4.5  # decay lengths of the far glow that are drawn
ROUND_SHARE = 0.15  # of the decay length, over which the glow's middle is rounded
SHORTEST_PX = 1  # of a part in the image
SLANT_BEGINS = 0.3  # squared sine of the angle between rows and line from which both axes share its light
END_COARSE_PX = 2.0  # standard deviation of the glow's ends


@dataclass(frozen=True)
class ImageRun:
    """Part of a run that crosses each row (or, if `across_rows` is false, column) at most once.

    `at` (n,) are the rows, `centre_px` (n,) the columns there. Widths are measured along the row: `core_px`
    of the line with its blur, `near_px` of the near glow, `far_px` the decay length. Light is in electrons
    per microsecond at the middle.
    """

    across_rows: bool
    at: NDArray[np.intp]
    centre_px: Array
    core_px: Array
    near_px: Array
    far_px: Array
    core: Array
    near: Array
    far: Array


def project_runs(runs: Sequence[LineRun], lens: Lens, area: Area) -> tuple[ImageRun, ...]:
    """Return the runs in the image, within an area of the sensor."""
    if not runs:
        return ()
    ends = np.cumsum([len(run.points_mm) for run in runs])[:-1]
    points = np.concatenate([run.points_mm for run in runs])  # at once: hair makes dozens of short runs
    pixels = lens.project(points)
    shifts = lens.project(points + np.concatenate([run.across_mm for run in runs])) - pixels
    blurs = lens.blur_sigmas_px(points[:, 2])
    in_image = (np.split(values, ends) for values in (pixels, shifts, blurs))
    return tuple(
        part
        for run, at_px, shift, blur_px in zip(runs, *in_image, strict=True)
        for part in _cross_pixels(run, at_px, shift, blur_px, area)
    )


def add_core(canvas: PixelCanvas, runs: Sequence[ImageRun], speckle: Speckle) -> None:
    """Add the light that leaves at or just below the surface."""
    for run in runs:
        reach = ceil(WINDOW_SIGMAS * max(run.core_px.max(), run.near_px.max() if run.near.any() else 0.0))
        middle = np.rint(run.centre_px).astype(np.intp)
        places = middle[:, None] + np.arange(-reach, reach + 1)
        off = (places - run.centre_px[:, None]).astype(np.float32)
        lines = np.broadcast_to(run.at[:, None], places.shape)
        columns, rows = (places, lines) if run.across_rows else (lines, places)
        grain = speckle.at(columns, rows)
        light = _gaussian(off, run.core_px, run.core) * grain
        if run.near.any():
            light += _gaussian(off, run.near_px, run.near) * (1.0 + NEAR_SPECKLE * (grain - 1.0))
        area = canvas.area
        x, y = columns - area.x, rows - area.y
        place, flat = y * area.width + x, canvas.light.reshape(-1)
        inside = (x >= 0) & (x < area.width) & (y >= 0) & (y < area.height)
        if not inside.all():
            place, light = place[inside], light[inside]
        flat[place] += light


def add_glow(canvas: PixelCanvas, runs: Sequence[ImageRun]) -> None:
    """Add the light that comes back from the depth of the skin."""
    glowing = [run for run in runs if run.far.any()]
    if not glowing:
        return
    area = canvas.area
    coarse: Image = np.zeros((area.height // COARSE_PX + 2, area.width // COARSE_PX + 2), np.float32)
    for run in glowing:
        grid, left, top = (coarse, area.x, area.y) if run.across_rows else (coarse.T, area.y, area.x)
        row = (np.arange(len(grid))) * COARSE_PX + top
        on = np.flatnonzero((row >= run.at[0]) & (row <= run.at[-1]))
        if not len(on):
            continue
        where = np.clip(row[on] - run.at[0], 0, len(run.at) - 1)
        column = np.arange(grid.shape[1]) * COARSE_PX + left
        off = column - run.centre_px[where, None]
        length = run.far_px[where, None]
        distance = np.sqrt(off * off + (ROUND_SHARE * length) ** 2) / length
        grid[on] += np.where(distance < FAR_REACH, run.far[where, None] * np.exp(-distance), 0.0)
    _add_enlarged(canvas.light, blur(coarse, END_COARSE_PX))


def _add_enlarged(light: Image, coarse: Image) -> None:
    """Add a grid of every `COARSE_PX`th pixel, interpolated bilinearly."""
    lit = np.flatnonzero(coarse.any(axis=0))
    if not len(lit):
        return
    left, right = max(int(lit[0]) - 1, 0), min(int(lit[-1]) + 2, coarse.shape[1])
    coarse, light = coarse[:, left:right], light[:, left * COARSE_PX : (right - 1) * COARSE_PX]
    share = (np.arange(COARSE_PX, dtype=np.float32) / COARSE_PX)[None, None, :]
    wide = coarse[:, :-1, None] * (1.0 - share) + coarse[:, 1:, None] * share
    wide = wide.reshape(len(coarse), -1)[:, : light.shape[1]]
    bright = wide.max(axis=1) > 0.0
    for step in range(COARSE_PX):
        below = np.float32(step / COARSE_PX)
        rows = light[step::COARSE_PX]
        count = len(rows)
        use = np.flatnonzero(bright[:count] | bright[1 : count + 1])
        rows[use] += wide[use] * (1 - below) + wide[use + 1] * below


def _cross_pixels(
    run: LineRun, pixels: Array, shift: Array, blur_px: Array, area: Area
) -> Iterator[ImageRun]:
    """Yield parts along the rows and along the columns; on a slant both share the light."""
    along = np.gradient(pixels, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), np.finfo(float).tiny)
    upright = np.clip((np.square(along[:, 1]) - SLANT_BEGINS) / (1.0 - 2.0 * SLANT_BEGINS), 0.0, 1.0)
    widths = _Widths(
        np.abs(shift[:, 0] * along[:, 1] - shift[:, 1] * along[:, 0]),
        blur_px,
        np.linalg.norm(shift, axis=1) / np.linalg.norm(run.across_mm, axis=1),
    )
    for across_rows, weight in ((True, upright), (False, 1.0 - upright)):
        main = 1 if across_rows else 0
        low, size = (area.y, area.height) if across_rows else (area.x, area.width)
        for part in _monotonic_parts(pixels[:, main], weight > 0.0):
            first = max(ceil(pixels[part[0], main]), low)
            last = min(floor(pixels[part[-1], main]), low + size - 1)
            if last - first >= SHORTEST_PX:
                stretch = 1.0 / np.maximum(np.abs(along[:, main]), SLANT_BEGINS)
                yield _at_pixels(
                    run, widths, weight, stretch, pixels, part, np.arange(first, last + 1), across_rows
                )


class _Widths(NamedTuple):
    """Widths (n,) across the line in the image: of the sheet, of the blur; and the scale on the surface."""

    sheet_px: Array
    blur_px: Array
    px_per_mm: Array


def _at_pixels(
    run: LineRun,
    widths: _Widths,
    weight: Array,
    stretch: Array,
    pixels: Array,
    part: NDArray[np.intp],
    at: NDArray[np.intp],
    across_rows: bool,
) -> ImageRun:
    """Return part of a run, its widths and light at whole rows or columns; `stretch` is along these."""
    finish = run.finish
    core_px = np.hypot(widths.sheet_px, widths.blur_px)
    near_px = np.hypot(core_px, finish.near_mm * widths.px_per_mm)
    far_px = finish.far_mm * widths.px_per_mm
    flux = run.light * widths.sheet_px * weight  # of the whole width, up to the root of 2 pi
    mirrored = run.gloss * widths.sheet_px * weight
    values = {
        "core": (finish.surface_share * flux + mirrored) / core_px,
        "near": finish.near_share * flux / near_px,
        "far": finish.far_share * flux * np.sqrt(np.pi / 2.0) / far_px,
        "centre_px": pixels[:, 0 if across_rows else 1],
        "core_px": core_px * stretch,
        "near_px": near_px * stretch,
        "far_px": far_px * stretch,
    }
    main = pixels[part, 1 if across_rows else 0]
    found = {name: np.interp(at, main, value[part]) for name, value in values.items()}
    end_px = np.minimum(at - main[0], main[-1] - at)  # an end is as blurred as the line
    found["core"] *= np.clip(end_px / (2.0 * widths.blur_px[part].mean()), 0.0, 1.0)
    found["near"] *= np.clip(0.5 + 0.5 * end_px / near_px[part].mean(), 0.0, 1.0)  # half of it at an end
    return ImageRun(across_rows, at, **found)


def _monotonic_parts(main: Array, used: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
    """Yield indices of neighbouring used points along which a coordinate rises."""
    kind = np.where(used[:-1] & used[1:], np.where(np.diff(main) > 0.0, 1, -1), 0)
    cuts = np.flatnonzero(np.diff(kind)) + 1
    for begin, end in zip([0, *cuts], [*cuts, len(kind)], strict=True):
        if kind[begin]:
            yield np.arange(begin, end + 1)[:: kind[begin]]


def _gaussian(off: Image, sigma_px: Array, peak: Array) -> Image:
    scaled: Image = np.divide(off, sigma_px[:, None], dtype=np.float32)
    scaled *= scaled
    scaled *= np.float32(-0.5)
    np.exp(scaled, out=scaled)
    scaled *= peak[:, None].astype(np.float32)
    return scaled
