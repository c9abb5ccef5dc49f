"""Recorded pixels come back bit for bit."""

from __future__ import annotations

import numpy as np
import pytest

from ronna_hw.recording.reading_coding import pack_pixels, unpack_pixels


@pytest.mark.parametrize(("kind", "largest"), [(np.uint8, 255), (np.uint16, 4095), (np.uint16, 65535)])
@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (64, 48)])
def test_any_picture_comes_back_bit_for_bit(kind: type, largest: int, shape: tuple[int, int]) -> None:
    pixels = np.random.default_rng(7).integers(0, largest, shape, endpoint=True).astype(kind)
    pixels.flags.writeable = False
    again = unpack_pixels(pack_pixels(pixels), shape, str(pixels.dtype))
    assert again.dtype == pixels.dtype
    assert not again.flags.writeable
    np.testing.assert_array_equal(again, pixels)


def test_a_slice_of_a_larger_picture_comes_back_unchanged() -> None:
    part = np.arange(400, dtype=np.uint16).reshape(20, 20)[2:8, 3:9]
    np.testing.assert_array_equal(unpack_pixels(pack_pixels(part), part.shape, "uint16"), part)


def test_noise_of_four_grey_values_packs_to_less_than_half_its_size() -> None:
    noise = (100 + np.random.default_rng(1).normal(0, 1.2, (200, 200))).astype(np.uint8)
    assert len(pack_pixels(noise)) < 0.5 * noise.nbytes


@pytest.mark.parametrize("damaged", [b"", b"no zlib at all", pack_pixels(np.zeros((2, 2), np.uint8))])
def test_damaged_bytes_are_refused(damaged: bytes) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        unpack_pixels(damaged, (3, 3), "uint8")
