"""Images of a case for clients: the latest picture of a camera, and the CT."""

from __future__ import annotations

import asyncio
import base64
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procedures.live.openigtlink.names import CAMERA_IMAGES, CT_IMAGE
from procedures.live.openigtlink.outgoing import Outgoing
from procedures.live.openigtlink.values import LinkValues
from procedures.live.records import CameraPicture
from ronna_hw.host.child_process import command
from ronna_hw.wire.openigtlink_contents import CoordinateSystem, ScalarType, encode_image

MOST_PIXELS = 50_000_000  # of a picture; the cameras have 5 million
GREY, COLOUR = "L", "RGB"


@dataclass(frozen=True)
class EncodedImage:
    """IMAGE message, encoded for the version of the header that somebody has asked for."""

    name: str
    message: bytes
    needs_metadata: bool = False

    @property
    def key(self) -> tuple[str, str]:
        return "IMAGE", self.name

    def encoded(self, _version: int) -> bytes:
        """Return the message."""
        return self.message


class Images:
    """Images of a case, made when somebody asks, once for all clients, so that poses are not delayed.

    The CT has a process of its own: to read and to encode it takes seconds.
    """

    def __init__(self, values: LinkValues, ct: Path | None) -> None:
        """`ct` is the folder of the series."""
        self._values = values
        self._ct = ct
        self._kept: dict[tuple[str, int], tuple[object, EncodedImage]] = {}  # with what each was made from
        self._making = asyncio.Lock()

    async def find(self, name: str, version: int) -> EncodedImage | None:
        """Return an image with a header of this version; None if there is none of this name.

        Raises ValueError or OSError for one that cannot be read.
        """
        async with self._making:
            source: object = self._ct if name == CT_IMAGE else self._values.pictures.get(name)
            if source is None:
                return None
            kept = self._kept.get((name, version))
            if kept is None or kept[0] is not source:
                message = await self._make(name, version)
                kept = self._kept[name, version] = (source, EncodedImage(name, message))
            return kept[1]

    async def _make(self, name: str, version: int) -> bytes:
        if name == CT_IMAGE:
            return await _run(command("procedures.live.openigtlink.ct_image", str(self._ct), str(version)))
        picture, stamp_ns = self._values.pictures[name]
        return await asyncio.to_thread(lambda: camera_image(picture, stamp_ns).encoded(version))


async def _run(line: list[str]) -> bytes:
    """Return what a program writes. Raises ValueError with its words if it fails."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*line, stdout=pipe, stderr=pipe)
    try:
        output, words = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if process.returncode:
        raise ValueError(" ".join(words.decode(errors="replace").split()))
    return output


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
