"""Each camera belongs to its side, both are one device, and wrong options are refused."""

from __future__ import annotations

from dataclasses import replace

import pytest
from coded_errors import raises

from drivers.basler_stereo.errors import BAD_OPTIONS, CABLES_SWAPPED, WRONG_MODEL, WRONG_SERIAL
from drivers.basler_stereo.identity import CameraIdentity
from drivers.basler_stereo.options import BaslerOptions, read_options
from drivers.basler_stereo.pair_device import check_pair, pair_identity
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.gige_vision import PixelFormat

BOUND = BaslerOptions(left_serial="11", right_serial="22")
LEFT = CameraIdentity("10.0.0.1", "00:30:53:11:22:33", "Basler", "acA2000-50gmNIR", "11", "106755-17", "left")
RIGHT = replace(LEFT, address="10.0.0.2", serial="22", user_name="right")


def test_the_right_cameras_on_the_right_sides_pass():
    check_pair(LEFT, RIGHT, BOUND)
    check_pair(LEFT, RIGHT, BaslerOptions())
    check_pair(LEFT, RIGHT, BaslerOptions(right_serial="22"))


@pytest.mark.parametrize(
    ("left", "right", "options", "error"),
    [
        (RIGHT, LEFT, BOUND, CABLES_SWAPPED),
        (RIGHT, LEFT, BaslerOptions(left_serial="11"), CABLES_SWAPPED),
        (LEFT, replace(RIGHT, serial="33"), BOUND, WRONG_SERIAL),
        (replace(LEFT, serial="33"), RIGHT, BOUND, WRONG_SERIAL),
        (LEFT, LEFT, BaslerOptions(), WRONG_SERIAL),
        (LEFT, replace(RIGHT, model="Fake"), BOUND, WRONG_MODEL),
    ],
)
def test_wrong_cameras_are_refused_with_the_matching_error(left, right, options, error):
    with raises(error, match=error.code):
        check_pair(left, right, options)


def test_any_model_can_be_allowed():
    check_pair(LEFT, replace(RIGHT, model="Fake"), BaslerOptions(expected_model=""))


def test_the_identity_of_the_pair_names_both_cameras():
    identity = pair_identity(LEFT, RIGHT)
    assert identity.serial == "11+22"
    assert dict(identity.details)["right"].startswith("22 ")


ENDPOINTS = {"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"}


def options(**values):
    config = DeviceConfig(driver="basler_stereo", endpoints=ENDPOINTS, options=values)
    return read_options(config, BaslerOptions)


def test_every_option_has_a_working_default():
    assert options().expected_model == "acA2000-50gmNIR"
    assert options(exposure_us=500).exposure_us == 500.0
    assert options(pixel_format="Mono12").pixel_format_code is PixelFormat.MONO12


def test_all_mistakes_are_reported_at_once():
    with raises(BAD_OPTIONS, match=r"GEV-016.*3 mistake") as caught:
        options(exposure="long", gain_raw=1000, heartbeat_ms=10)
    for word in ("exposure", "gain_raw", "heartbeat_ms"):
        assert word in str(caught.value)


def test_one_camera_cannot_be_both_sides():
    with raises(BAD_OPTIONS, match="serial are equal"):
        options(left_serial="1", right_serial="1")


def test_an_option_that_is_not_a_plain_value_is_refused():
    with raises(BAD_OPTIONS, match="GEV-016"):
        options(left_serial=object())


def test_a_serial_number_without_quotes_is_refused_with_the_advice_to_put_it_in_quotes():
    with raises(BAD_OPTIONS, match=r"left_serial: expected text: put it in quotes \(found 21904411\)"):
        options(left_serial=21904411)
