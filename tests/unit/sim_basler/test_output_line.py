"""The output line switches the projector: its source, inverter and status, and which frames it lights."""

from __future__ import annotations

from typing import Any

import pytest

from ronna_hw.wire.gige_vision import GevStatus
from sim.basler.settings import Line, LineSource

OUT = {"LineSelector": int(Line.OUT_1)}
USER = {"LineSource": int(LineSource.USER_OUTPUT)}


def test_the_output_follows_its_user_output_and_the_inverter(bench: Any) -> None:
    bench.take_control()
    bench.put(**OUT, **USER, UserOutputValue=1)
    assert (bench.get("LineStatus"), bench.camera.lights_exposure) == (1, True)
    bench.put(LineInverter=1)
    assert (bench.get("LineStatus"), bench.camera.lights_exposure) == (0, False)


def test_an_input_has_no_source_and_a_level_of_its_own(bench: Any) -> None:
    bench.take_control()
    bench.put(**OUT, **USER, UserOutputValue=1)
    bench.put(LineSelector=int(Line.LINE_1))
    assert bench.set("LineSource", int(LineSource.EXPOSURE_ACTIVE)) == GevStatus.ACCESS_DENIED
    assert bench.get("LineStatus") == 0


def test_exposure_active_lights_exposures_and_is_low_between_them(bench: Any) -> None:
    bench.take_control()
    bench.put(**OUT, LineSource=int(LineSource.EXPOSURE_ACTIVE))
    assert bench.camera.lights_exposure
    assert bench.get("LineStatus") == 0


def test_sources_that_end_with_the_trigger_light_no_exposure(bench: Any) -> None:
    bench.take_control()
    for source in (LineSource.FRAME_TRIGGER_WAIT, LineSource.ACQUISITION_TRIGGER_WAIT):
        bench.put(**OUT, LineSource=int(source), UserOutputValue=1)
        assert not bench.camera.lights_exposure


def test_the_line_keeps_its_level_when_control_is_released_and_loses_it_on_a_restart(bench: Any) -> None:
    bench.take_control()
    bench.put(**OUT, **USER, UserOutputValue=1)
    bench.camera.privilege.drop()
    assert bench.camera.lights_exposure  # nothing but a hardware interlock ends this light
    bench.camera.restart()
    bench.take_control()
    assert bench.get("UserOutputValue") == 0


@pytest.mark.hazard(69)
def test_at_power_on_the_output_follows_the_exposure(bench: Any) -> None:
    assert bench.camera.settings.line_source == LineSource.EXPOSURE_ACTIVE
    assert bench.camera.lights_exposure  # a projector is lit by every picture until the driver prepares it
