"""Causes of a stop that only the controller's other interfaces tell, and programs that must not go on."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any, cast

import pytest
from watched_stream import MOVING, Watched, watched_ur

from drivers.universal_robots.errors import STREAM_ERRORS
from drivers.universal_robots.realtime.packages import Cause, ControllerWord
from drivers.universal_robots.watch import POWER_DOWN_S
from ronna_hw.arm_stream.records import LinkFault, LinkState, StopOrder, StreamPhase
from ronna_hw.errors import RonnaError
from ronna_hw.wire.universal_robots import RobotMode, RuntimeState

pytestmark = pytest.mark.hazard(4)


class Dashboard:
    """Dashboard as the driver sees it."""

    def __init__(self) -> None:
        self.remote: bool | RonnaError = True
        self.asked: list[str] = []

    def ask(self, command: str, _timeout_s: float) -> str:
        self.asked.append(command)
        return "Stopped"

    def is_remote(self, _timeout_s: float) -> bool:
        if isinstance(self.remote, RonnaError):
            raise self.remote
        return self.remote


def watched() -> tuple[Watched, Dashboard]:
    made, dashboard = watched_ur(), Dashboard()
    cast(Any, made.connections).open_dashboard = dashboard
    return made, dashboard


def _stopped(robot_mode: RobotMode) -> LinkState:
    word = ControllerWord(robot_mode, 1, RuntimeState.STOPPED, 2, Cause.PROGRAM)
    return replace(MOVING, phase=StreamPhase.SILENT, fault=LinkFault.CONTROLLER, controller_word=word.number)


def test_a_program_that_stopped_because_power_goes_off_is_attributed_to_it() -> None:
    arm, _ = watched()
    arm.link.state = _stopped(RobotMode.RUNNING)
    arm.watch.check()
    assert arm.outcome == ("", [])
    arm.link.state = _stopped(RobotMode.POWER_OFF)
    arm.watch.check()
    assert arm.outcome == ("URD-035", [])


def test_the_wait_for_power_that_goes_off_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    (arm, _), now_s = watched(), [100.0]
    monkeypatch.setattr("drivers.universal_robots.watch.time.monotonic", lambda: now_s[0])
    arm.link.state = _stopped(RobotMode.RUNNING)
    arm.watch.check()
    now_s[0] += 0.99 * POWER_DOWN_S
    arm.watch.check()
    assert arm.outcome == ("", [])
    now_s[0] += 0.02 * POWER_DOWN_S
    arm.watch.check()
    assert arm.outcome == ("URD-036", [])


@pytest.mark.parametrize(("coming", "code"), [([_stopped(RobotMode.POWER_OFF)], "URD-035"), ([], "URD-036")])
def test_a_call_waits_for_the_cause_why_the_program_stopped(coming: list[LinkState], code: str) -> None:
    arm, _ = watched()
    arm.link.state, arm.link.coming = _stopped(RobotMode.RUNNING), coming
    with pytest.raises(RonnaError, match=code):
        arm.watch.raise_any()


@pytest.mark.parametrize(
    ("remote", "code"), [(False, "URD-044"), (True, "URD-014"), (STREAM_ERRORS.lost("gone"), "URD-014")]
)
def test_losing_the_primary_interface_is_told_apart_from_a_switch_to_local_control(
    remote: bool | RonnaError, code: str
) -> None:
    arm, dashboard = watched()
    dashboard.remote = remote
    arm.watch.on_loss(STREAM_ERRORS.lost("tcp://127.0.0.1:1 closed the connection"))
    assert arm.outcome == (code, [StopOrder.PROTECTIVE])


def test_a_thread_that_sees_the_loss_first_leaves_the_fault_to_the_question_for_the_control_mode() -> None:
    arm, dashboard = watched()
    dashboard.remote = False
    arm.control.failure = STREAM_ERRORS.lost("tcp://127.0.0.1:1 closed the connection")
    arm.watch.check()
    assert arm.outcome == ("", [])
    reader = threading.Thread(target=arm.watch.on_loss, args=(arm.control.failure,))
    reader.start()
    with pytest.raises(RonnaError, match="local control"):
        arm.watch.raise_any()
    reader.join()
    assert arm.outcome == ("URD-044", [StopOrder.PROTECTIVE])


@pytest.mark.parametrize("fault", [LinkFault.SILENCE, LinkFault.BROKEN, LinkFault.RESTARTED])
def test_a_program_is_ended_once_after_each_fault_that_leaves_it_without_set_points(fault: LinkFault) -> None:
    arm, dashboard = watched()
    arm.watch.on_silence()
    assert dashboard.asked == []
    for _ in range(2):
        arm.link.state = replace(MOVING, phase=StreamPhase.FAULT, fault=fault)
        arm.watch.on_silence()
        arm.watch.on_silence()
        arm.link.state = MOVING
        arm.watch.on_silence()
    assert dashboard.asked == ["stop", "stop"]
