"""Pixel values as bytes on the wire, and the camera's own test images."""

from __future__ import annotations

import numpy as np

from ronna_hw.wire.gige_vision import PixelFormat
from sim.basler.camera.settings import FrameSettings, RampImage, bits_per_pixel
from sim.basler.optics.sensor import Pixels


def to_wire(pixels: Pixels, pixel_format: PixelFormat) -> bytes:
    """Bytes of an image (rows, columns); its width is even."""
    if pixel_format is PixelFormat.MONO12:
        return pixels.astype("<u2").tobytes()
    if pixel_format is PixelFormat.MONO12_PACKED:
        first, second = pixels[:, 0::2].astype(np.uint16), pixels[:, 1::2].astype(np.uint16)
        packed = np.empty((*first.shape, 3), np.uint8)
        packed[..., 0] = first >> 4
        packed[..., 1] = (second & 0xF) << 4 | first & 0xF
        packed[..., 2] = second >> 4
        return packed.tobytes()
    return pixels.tobytes()


def depth_bits(pixel_format: PixelFormat) -> int:
    """Bits per pixel value."""
    return 8 if bits_per_pixel(pixel_format) == 8 else 12


def ramp_image(frame: FrameSettings, number: int) -> Pixels:
    """A diagonal ramp that repeats every 256 (or 4096) pixels; the moving one shifts by one each frame."""
    shift = number if frame.test_image is RampImage.MOVING else 0
    rows = np.arange(frame.area.y, frame.area.y + frame.area.height)[:, None]
    columns = np.arange(frame.area.x, frame.area.x + frame.area.width)[None, :]
    if depth_bits(frame.pixel_format) == 8:
        return (rows + columns + shift).astype(np.uint8)
    return ((rows + columns + shift) & 0xFFF).astype(np.uint16)
