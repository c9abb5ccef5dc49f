"""Frames become readings: pixels, areas, validity, and pairs judged by the cameras' clocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.basler_stereo.readings import PairClock, Tie, camera_image, stereo_reading, unpack_12_bits
from drivers.basler_stereo.stream.frame_assembler import Leader, ReceivedImage
from ronna_hw.devices.readings import AreaOfInterest, Validity
from ronna_hw.wire.gige_vision import PixelFormat

AREA = AreaOfInterest(16, 4, 6, 2)


def image(
    area=AREA, pixel_format=PixelFormat.MONO8, padding=0, missing=0, leader=True, data=bytes(range(12))
):
    said = (
        Leader(77, pixel_format, area.offset_x, area.offset_y, area.width, area.height, padding)
        if leader
        else None
    )
    return camera_image(
        ReceivedImage(1, said, bytearray(data), missing), "S", AREA, PixelFormat.MONO8, 5, 1.25
    )


def test_a_complete_frame_is_a_valid_image():
    found = image()
    assert found.validity is Validity.OK
    assert found.pixels.tolist() == [[0, 1, 2, 3, 4, 5], [6, 7, 8, 9, 10, 11]]
    assert (found.stamp.sequence, found.stamp.device_clock, found.stamp.theatre_time_s) == (5, 77, 1.25)
    with pytest.raises(ValueError, match="read-only"):
        found.pixels[0, 0] = 1


def test_missing_packets_make_an_image_partial_and_another_shape_makes_it_corrupt():
    assert image(missing=2).validity is Validity.PARTIAL
    assert image(area=AreaOfInterest(17, 4, 6, 2)).validity is Validity.CORRUPT
    assert image(pixel_format=PixelFormat.MONO12).validity is Validity.CORRUPT
    assert image(padding=2, missing=1).validity is Validity.CORRUPT
    assert image(leader=False) is None


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        (image(), image(), Validity.OK),
        (image(), image(missing=1), Validity.PARTIAL),
        (image(padding=1), image(missing=1), Validity.CORRUPT),
        (None, image(padding=1), Validity.MISSING),
        (None, None, Validity.MISSING),
    ],
)
def test_a_pair_is_as_valid_as_its_worse_side(left, right, expected):
    reading = stereo_reading(left, right, 3, 2.0)
    assert reading.validity is expected
    assert reading.stamp.device_clock == (77 if left or right else 0)


@given(st.lists(st.integers(0, 4095), min_size=1, max_size=50))
def test_packed_values_are_unpacked_as_the_camera_family_packs_them(values):
    padded = values + [0] * (len(values) % 2)
    packed = bytearray()
    for a, b in zip(padded[::2], padded[1::2], strict=True):
        packed += bytes((a >> 4, (b & 0xF) << 4 | a & 0xF, b >> 4))
    data = np.frombuffer(bytes(packed), dtype=np.uint8)
    assert unpack_12_bits(data, len(values)).tolist() == values


HZ = 125_000_000
BOTH_HZ = (HZ, HZ)
SKEW_S = 0.01


def tied(left_zero: int = 1_000, right_zero: int = 9_000_000_000) -> PairClock:
    return PairClock((Tie(left_zero, HZ, 100.0, 1e-4), Tie(right_zero, HZ, 100.0, 1e-4)), SKEW_S)


def ticks(left_s: float, right_s: float) -> tuple[int, int]:
    return 1_000 + round((left_s - 100.0) * HZ), 9_000_000_000 + round((right_s - 100.0) * HZ)


@pytest.mark.parametrize(
    ("left_s", "right_s", "validity"),
    [
        (101.0, 101.0, Validity.OK),
        (101.0, 101.009, Validity.OK),
        (101.03, 101.0, Validity.UNPAIRED),
        (101.0, 101.03, Validity.UNPAIRED),
        (100.9, 100.9, Validity.STALE),
        (100.9, 101.0, Validity.UNPAIRED),
    ],
)
def test_exposure_moments_decide_the_validity_of_a_pair(left_s, right_s, validity):
    assert tied().judge_pair(ticks(left_s, right_s), BOTH_HZ, 101.0, 101.1) is validity


def test_slow_drift_does_not_accumulate():
    clock = tied()
    for second in range(1, 2000):
        now_s = 100.0 + second
        pair = ticks(now_s, now_s + 1e-4 * second)  # 100 ppm: 0.2 s in the end
        assert clock.judge_pair(pair, BOTH_HZ, now_s, now_s + 0.1) is Validity.OK


def test_a_restarted_counter_is_detected():
    clock = tied()
    assert clock.judge_pair(ticks(101.0, 101.0), BOTH_HZ, 101.0, 101.1) is Validity.OK
    assert clock.judge_pair((ticks(102.0, 102.0)[0], 500), BOTH_HZ, 102.0, 102.1) is Validity.UNPAIRED


def test_without_a_latch_the_first_pair_is_accepted_and_the_second_judged():
    clock = PairClock((None, None), SKEW_S)
    assert clock.judge_pair((5, 7_000_000), BOTH_HZ, 100.0, 100.1) is Validity.OK
    assert clock.judge_pair((5 + HZ, 7_000_000 + HZ), BOTH_HZ, 101.0, 101.1) is Validity.OK
    assert clock.judge_pair((5 + HZ, 7_000_000 + HZ // 2), BOTH_HZ, 101.0, 101.1) is Validity.UNPAIRED


def test_cameras_without_a_clock_are_accepted():
    clock = PairClock((None, None), SKEW_S)
    for now_s in (100.0, 200.0):
        assert clock.judge_pair((1, 2), (0, 0), now_s, now_s + 0.1) is Validity.OK
