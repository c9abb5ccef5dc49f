"""IMAGE messages: the latest picture of a camera, and the CT of the case."""

from __future__ import annotations

import asyncio
import base64
import io
from functools import partial
from pathlib import Path

import numpy as np

from procedures.live.openigtlink.names import CAMERA_IMAGES, CT_IMAGE, RAS_FROM_LPS
from procedures.live.openigtlink.outgoing import Outgoing
from procedures.live.openigtlink.values import LinkValues
from procedures.live.records import CameraPicture
from ronna_hw.wire.openigtlink_contents import CoordinateSystem, ScalarType, encode_image

MOST_PIXELS = 50_000_000  # of a picture; the cameras have 5 million
GREY, COLOUR = "L", "RGB"


class Images:
    """Images of a case, made in a thread when somebody asks, once for all clients."""

    def __init__(self, values: LinkValues, ct: Path | None) -> None:
        """`ct` is the folder of the series."""
        self._values = values
        self._ct = ct
        self._kept: dict[str, tuple[object, Outgoing]] = {}  # by name, with what each was made from
        self._making = asyncio.Lock()

    async def find(self, name: str, version: int) -> Outgoing | None:
        """Return an image, encoded for a header of this version; None if there is none of this name.

        Raises the errors of `camera_image` and `ct_image`.
        """
        async with self._making:
            source: object
            if name == CT_IMAGE and self._ct is not None:
                source, make = self._ct, partial(ct_image, self._ct)
            elif (found := self._values.pictures.get(name)) is not None:
                source, make = found[0], partial(camera_image, *found)
            else:
                return None
            kept = self._kept.get(name)
            if kept is None or kept[0] is not source:
                kept = self._kept[name] = (source, await asyncio.to_thread(make))
            await asyncio.to_thread(kept[1].encoded, version)
            return kept[1]


def camera_image(record: CameraPicture, stamp_ns: int) -> Outgoing:
    """Decode a picture. It has no place in the patient: a pixel is 1 mm, from the centre of the picture.

    Raises ValueError or OSError for a picture that cannot be decoded.
    """
    from PIL import Image

    with Image.open(io.BytesIO(base64.b64decode(record.jpeg)), formats=("JPEG",)) as picture:
        if picture.width * picture.height > MOST_PIXELS:
            raise ValueError(f"a picture of {picture.width} x {picture.height} pixels")
        decoded = picture if picture.mode == GREY else picture.convert(COLOUR)
        size, components, pixels = decoded.size, len(decoded.getbands()), decoded.tobytes()
    placement = np.eye(4)
    placement[:2, 3] = (1 - np.array(size)) / 2
    content = encode_image(
        (*size, 1), pixels, ScalarType.UINT8, placement, CoordinateSystem.RAS, components=components
    )
    return Outgoing("IMAGE", CAMERA_IMAGES[record.side], content, stamp_ns)


def ct_image(series: Path) -> Outgoing:
    """Read a CT series in HU. Raises its CT errors, and OSError."""
    from procedures.imaging.series import read_series

    volume = read_series(series)
    geometry = volume.geometry
    placement = np.eye(4)
    placement[:3, :3] = (geometry.axes * geometry.spacing_mm)[:, ::-1]  # for column, row, slice
    placement[:3, 3] = geometry.origin_mm
    slices, rows, columns = geometry.shape
    content = encode_image(
        (columns, rows, slices),
        volume.voxels.astype("<i2", copy=False).tobytes(),
        ScalarType.INT16,
        RAS_FROM_LPS @ placement,
        CoordinateSystem.RAS,
    )
    return Outgoing("IMAGE", CT_IMAGE, content)
