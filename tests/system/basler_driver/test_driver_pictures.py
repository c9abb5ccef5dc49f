"""What the stereo driver gives for a trigger: the pixels that were sent, of the area that was set."""

from __future__ import annotations

import numpy as np
import pytest
from peer_cameras import FULL, HANG_LIMIT_S, SERIALS, pattern

from drivers.basler_stereo.errors import OutOfRange
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.readings import AreaOfInterest, Validity


def test_every_trigger_gives_one_complete_pair_with_the_pixels_that_were_sent(pair, peers):
    for block_id in (1, 2, 3):
        reading = pair.grab_pair(HANG_LIMIT_S)
        assert reading.validity is Validity.OK
        assert reading.stamp.sequence == block_id
        for image, serial in ((reading.left, SERIALS[0]), (reading.right, SERIALS[1])):
            assert image.serial == serial
            assert image.area == FULL
            assert np.array_equal(image.pixels, pattern(FULL, block_id) & 0xFF)
            assert not image.pixels.flags.writeable
    assert [peer.fault("count") for peer in peers] == ["3 DONE\n", "3 DONE\n"]


def test_device_clock_and_theatre_time_go_forward(pair):
    first, second = pair.grab_pair(HANG_LIMIT_S), pair.grab_pair(HANG_LIMIT_S)
    for before, after in ((first.left, second.left), (first.right, second.right), (first, second)):
        assert after.stamp.device_clock > before.stamp.device_clock
        assert after.stamp.theatre_time_s > before.stamp.theatre_time_s


@pytest.mark.parametrize("pixel_format", ["Mono12", "Mono12Packed"])
def test_twelve_bits_arrive_as_twelve_bits(make_pair, pixel_format):
    device = make_pair(pixel_format=pixel_format)
    device.connect(HANG_LIMIT_S)
    device.configure(HANG_LIMIT_S)
    device.activate(HANG_LIMIT_S)
    reading = device.grab_pair(HANG_LIMIT_S)
    assert reading.left.pixels.dtype == np.uint16
    assert np.array_equal(reading.left.pixels, 16 * pattern(FULL, 1) & 0xFFF)


def test_areas_are_read_where_they_were_set_and_the_stream_goes_on(pair):
    left, right = AreaOfInterest(32, 8, 64, 48), AreaOfInterest(160, 100, 96, 28)
    pair.set_areas(left, right)
    reading = pair.grab_pair(HANG_LIMIT_S)
    assert (reading.left.area, reading.right.area) == (left, right)
    assert np.array_equal(reading.left.pixels, pattern(left, 1) & 0xFF)
    assert np.array_equal(reading.right.pixels, pattern(right, 1) & 0xFF)


@pytest.mark.parametrize(
    "area",
    [
        AreaOfInterest(0, 0, 272, 128),
        AreaOfInterest(200, 0, 64, 64),
        AreaOfInterest(8, 0, 64, 64),
        AreaOfInterest(0, 0, 40, 64),
        AreaOfInterest(0, -1, 64, 64),
        AreaOfInterest(0, 0, 0, 64),
    ],
)
def test_an_impossible_area_is_refused_and_the_old_one_stays(pair, area):
    with pytest.raises(OutOfRange, match="GEV-011"):
        pair.set_areas(AreaOfInterest(0, 0, 64, 64), area)
    assert pair.areas == (FULL, FULL)
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK


@pytest.mark.parametrize(("exposure_us", "gain_raw"), [(10.0, 40), (2e6, 40), (500.0, 10), (500.0, 600)])
def test_exposure_and_gain_outside_the_cameras_limits_are_refused(pair, exposure_us, gain_raw):
    with pytest.raises(OutOfRange, match="GEV-011"):
        pair.set_exposure(exposure_us, gain_raw)
    assert pair.state is Lifecycle.ACTIVE


def test_exposure_is_set_while_streaming(pair):
    pair.set_exposure(750.0, 100)
    assert pair.grab_pair(HANG_LIMIT_S).validity is Validity.OK
