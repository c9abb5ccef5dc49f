"""The doctor's advice where a serial number of a camera was mistyped in the options."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.cli.doctor.mistyped_serial import mistyped_serials
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import Diagnostic

HEAD = cast("Any", SimpleNamespace(left=SimpleNamespace(serial="4411"), right=SimpleNamespace(serial="4412")))
USUAL = "After replacing a camera, recalibrate the head."


def _advised(found: str, typed: str) -> str:
    device = DeviceConfig(
        driver="basler_stereo",
        endpoints={"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"},
        options={"left_serial": typed, "right_serial": "4412"},
    )
    seen = Diagnostic("camera gev://127.0.0.1", False, f"camera {found}, expected {typed}", USUAL)
    other = Diagnostic("camera gev://127.0.0.2", True, "camera 4412")
    camera, same = mistyped_serials((seen, other), device, HEAD)
    assert same is other
    return camera.advice


def test_a_serial_number_that_only_the_options_have_is_called_mistyped() -> None:
    said = _advised(found="4411", typed="4417")
    assert said.startswith('left_serial = "4417" is probably mistyped')
    assert "names 4411" in said


@pytest.mark.parametrize(("found", "typed"), [("4499", "4411"), ("4499", "4417")])
def test_a_camera_that_the_records_do_not_know_is_still_taken_for_another(found: str, typed: str) -> None:
    assert _advised(found, typed) == USUAL
