"""The options of the stereo pair in the theatre file."""

from __future__ import annotations

import pytest

from drivers.basler_stereo.errors import BadOptions
from drivers.basler_stereo.options import read_options
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.gige_vision import PixelFormat

ENDPOINTS = {"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"}


def options(**values):
    return read_options(DeviceConfig(driver="basler_stereo", endpoints=ENDPOINTS, options=values))


def test_every_option_has_a_working_default():
    assert options().expected_model == "acA2000-50gmNIR"
    assert options(exposure_us=500).exposure_us == 500.0
    assert options(pixel_format="Mono12").pixel_format_code is PixelFormat.MONO12


def test_all_mistakes_are_reported_at_once():
    with pytest.raises(BadOptions, match=r"GEV-016.*3 mistake") as caught:
        options(exposure="long", gain_raw=1000, heartbeat_ms=10)
    for word in ("exposure", "gain_raw", "heartbeat_ms"):
        assert word in str(caught.value)


def test_one_camera_cannot_be_both_sides():
    with pytest.raises(BadOptions, match="serial are equal"):
        options(left_serial="1", right_serial="1")


def test_an_option_that_is_not_a_plain_value_is_refused():
    with pytest.raises(BadOptions, match="GEV-016"):
        options(left_serial=object())


def test_a_serial_number_without_quotes_is_refused_with_the_advice_to_put_it_in_quotes():
    with pytest.raises(BadOptions, match=r"left_serial: expected text: put it in quotes \(found 21904411\)"):
        options(left_serial=21904411)
