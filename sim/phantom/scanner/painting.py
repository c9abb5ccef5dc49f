"""Paints bodies over an image, only where they are."""

from __future__ import annotations

import numpy as np

from sim.phantom.head.shapes import Shape, Values


def paint(image: Values, axes: tuple[Values, Values, Values], shape: Shape, edge_mm: float) -> None:
    """Paint a body into `image` (z, y, x), with samples at `axes` = (x, y, z), each ascending.

    Within a width of `edge_mm` around its surface the body blends into the previous content.
    """
    low, high = shape.bounds()
    margin = np.float32(0.5 * edge_mm)
    parts = []
    # z first: of most slices a body is above or below
    for axis, lowest, highest in zip(reversed(axes), reversed(low), reversed(high), strict=True):
        first = int(np.searchsorted(axis, lowest - margin))
        last = int(np.searchsorted(axis, highest + margin))
        if first >= last:
            return
        parts.append(slice(first, last))
    z, y, x = (axis[part] for axis, part in zip(reversed(axes), parts, strict=True))
    depth = shape.depth(x[None, None, :], y[None, :, None], z[:, None, None])
    cover = np.clip(depth * np.float32(1.0 / edge_mm) + np.float32(0.5), np.float32(0.0), np.float32(1.0))
    region = image[tuple(parts)]
    region += (np.float32(shape.hu) - region) * cover
