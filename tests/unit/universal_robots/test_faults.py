"""Stops by the controller, and motions that do not end, in this controller's words."""

from __future__ import annotations

from dataclasses import replace

import pytest
from watched_stream import ur_faults

from drivers.universal_robots.options import UrOptions, script_settings
from drivers.universal_robots.realtime.packages import Cause, ControllerWord
from ronna_hw.arm_stream.records import NO_STATE, LinkFault

FAULTS = ur_faults()


@pytest.mark.parametrize(
    ("word", "code", "says"),
    [
        (ControllerWord(7, 7, 2, 2, Cause.SAFETY), "URD-035", "emergency stop"),
        (ControllerWord(7, 3, 2, 2, Cause.SAFETY), "URD-043", "only 5 s after it"),
        (ControllerWord(7, 2, 2, 2, Cause.SAFETY), "URD-035", "is reduced mode; expected the mode"),
        (ControllerWord(7, 99, 2, 2, Cause.SAFETY), "URD-035", "safety mode 99"),
        (ControllerWord(3, 1, 2, 2, Cause.ROBOT_MODE), "URD-035", "switched off"),
        (ControllerWord(3, 1, 1, 2, Cause.PROGRAM), "URD-035", "switched off"),
        (ControllerWord(7, 7, 1, 2, Cause.PROGRAM), "URD-035", "emergency stop"),
        (ControllerWord(7, 1, 4, 2, Cause.PROGRAM), "URD-036", "program PAUSED"),
        (ControllerWord(7, 1, 2, 3, Cause.SCRIPT), "URD-036", "script ENDED"),
        (ControllerWord(7, 1, 2, 2, Cause.OTHER_SCRIPT), "URD-036", "took the place of ours"),
        (ControllerWord(7, 1, 2, 4, Cause.SCRIPT), "URD-037", "20 ms"),
        (ControllerWord(7, 1, 2, 5, Cause.SCRIPT), "URD-037", "step"),
    ],
)
def test_a_stop_by_the_controller_says_why(word: ControllerWord, code: str, says: str) -> None:
    state = replace(NO_STATE, fault=LinkFault.CONTROLLER, controller_word=word.number)
    error = FAULTS.error(state, "automatic")
    assert error is not None
    assert error.code == code
    assert says in str(error)


def test_a_motion_that_does_not_end_names_the_speed_slider_or_else_losses() -> None:
    lossy = replace(NO_STATE, cycles=500, late=9)
    slowed = FAULTS.not_finished_error(NO_STATE, replace(lossy, speed_share=0.0), 3.0)
    assert slowed.code == "URD-033"
    assert "the speed slider is at 0%" in slowed.summary
    assert "lost" not in str(slowed)
    degraded = replace(lossy, speed_share=0.5, degraded=True)
    assert "9 were late or lost" in FAULTS.not_finished_error(NO_STATE, degraded, 3.0).summary


def test_the_script_allows_a_late_set_point_but_no_jump() -> None:
    for model, cycles in (("ur5", 3), ("ur5e", 10)):
        options = UrOptions(model=model)
        settings = script_settings(options)
        assert cycles == settings.STARVED_CYCLES
        working_step_rad = options.speed_fraction * 3.1416 * options.cycle_s
        assert 2.0 * working_step_rad < settings.LARGEST_STEP_RAD < 5.0 * working_step_rad
