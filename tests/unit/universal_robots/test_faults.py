"""Every fault of the real-time process becomes its error, in words."""

from __future__ import annotations

import pytest

from drivers.universal_robots import errors
from drivers.universal_robots.errors import STREAM_ERRORS
from drivers.universal_robots.faults import fault_error, stream_faults
from drivers.universal_robots.options import UrOptions, script_settings
from drivers.universal_robots.realtime.packages import Cause, ControllerWord
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm_stream.records import NO_STATE, Fault, Result
from ronna_hw.errors import RonnaError

OPTIONS = UrOptions()
FAULTS = stream_faults("arm", universal_robot("ur5e"), OPTIONS)


STREAMING = ControllerWord(7, 1, 2, 2)


def error_of(fault: Fault, word: ControllerWord = STREAMING) -> RonnaError | None:
    state = NO_STATE._replace(
        fault=fault, violation_kind=ViolationKind.SPEED, violation_axis=3, controller_word=word.number
    )
    return fault_error(FAULTS, OPTIONS, state, "automatic")


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (Fault.SILENCE, "URD-021"),
        (Fault.BROKEN, "URD-022"),
        (Fault.HEARTBEAT, "URD-023"),
        (Fault.MONITOR, "URD-026"),
        (Fault.PATH, "URD-027"),
        (Fault.LOSSES, "URD-028"),
        (Fault.PROTECTIVE, "URD-029"),
        (Fault.LINK_STOP, "URD-030"),
        (Fault.DRIVES_OFF, "URD-031"),
        (Fault.RESTARTED, "URD-038"),
        (Fault.BASE, "URD-039"),
    ],
)
def test_each_fault_has_its_code(fault: Fault, code: str) -> None:
    error = error_of(fault)
    assert error is not None
    assert error.code == code


def test_every_fault_has_an_error() -> None:
    assert [fault for fault in Fault if error_of(fault) is None] == [Fault.NONE]


@pytest.mark.parametrize(
    ("word", "code", "says"),
    [
        (ControllerWord(7, 7, 2, 2, Cause.SAFETY), "URD-035", "emergency stop"),
        (ControllerWord(7, 3, 2, 2, Cause.SAFETY), "URD-035", "protective stop"),
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
    error = error_of(Fault.CONTROLLER, word)
    assert error is not None
    assert error.code == code
    assert says in str(error)


def test_errors_of_the_process_and_of_motions_are_the_drivers() -> None:
    assert FAULTS.refusal_error(NO_STATE._replace(result=Result.REFUSED_BUSY)).code == "URD-034"
    assert FAULTS.refusal_error(NO_STATE._replace(result=Result.REFUSED_STOP)).code == "URD-032"
    assert STREAM_ERRORS.not_finished is errors.MotionNotFinished
    assert STREAM_ERRORS.died is errors.LinkProcessDied
    assert STREAM_ERRORS.stalled is errors.LinkProcessStalled


def test_a_motion_that_does_not_end_names_the_speed_slider_or_else_losses() -> None:
    lossy = NO_STATE._replace(cycles=500, late=9)
    slowed = FAULTS.not_finished_error(NO_STATE, lossy._replace(speed_share=0.0), 3.0)
    assert slowed.code == "URD-033"
    assert "the speed slider is at 0%" in slowed.summary
    assert "lost" not in str(slowed)
    degraded = lossy._replace(speed_share=0.5, degraded=True)
    assert "9 were late or lost" in FAULTS.not_finished_error(NO_STATE, degraded, 3.0).summary


def test_the_script_allows_a_late_set_point_but_no_jump() -> None:
    for model, cycles in (("ur5", 3), ("ur5e", 10)):
        options = UrOptions(model=model)
        settings = script_settings(options)
        assert cycles == settings.STARVED_CYCLES
        working_step_rad = options.speed_fraction * 3.1416 * options.cycle_s
        assert 2.0 * working_step_rad < settings.LARGEST_STEP_RAD < 5.0 * working_step_rad
