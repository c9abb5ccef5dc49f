"""Facts that only EKI reports during motion: the next telegram gets the first set-point of a stop.

Between two telegrams the controller stands still until the driver has heard it. So the promise is counted in
cycles and not in the time of a busy machine.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from math import degrees
from typing import Any

import pytest
from driven_arm import FAR, THERE, activated, largest_step, moving
from waiting import HANG_LIMIT_S, eventually

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.errors import STREAM_ERRORS
from ronna_hw.arm_stream.records import Choice
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.capabilities import Direction
from ronna_hw.devices.robot import JointMove
from ronna_hw.errors import RonnaError, is_error

HANG_S = 60.0
LONGEST_STOP_CYCLES = 125  # half a second: what the table of disturbances promises for a path stop
WORKING_SHARE = 1 / 8  # of a full-speed step

Happen = Callable[[Any], None]


@pytest.fixture
def patient_arm(make_arm: Any) -> Any:
    """Return an active arm, as patient as a controller that stands still needs."""
    return activated(make_arm(silence_limit_s=HANG_S, heartbeat_limit_s=HANG_S))


def _stopped(arm: Any, controller: Any, happen: Happen) -> RonnaError:
    """Return the error of a long motion in which something happens between two telegrams."""
    mover, caught = moving(arm, controller)
    controller.silent.set()
    assert controller.standing.wait(HANG_S)
    before = len(controller.replies)
    happen(controller)
    eventually(lambda: arm.connections.link.stop_number > 0)
    controller.silent.clear()
    mover.join(HANG_S)
    _stopped_at_once(controller.replies, before, {c.device_clock: c.choice for c in arm.recorded_cycles})
    assert arm.state is Lifecycle.FAULT
    (error,) = caught
    assert isinstance(error, RonnaError)
    assert "flight-record-robot.master.txt" in error.attachments
    return error


def _stopped_at_once(replies: list[tuple[int, Any, int]], before: int, choices: dict[int, Choice]) -> None:
    assert choices[replies[before - 1][0]] is Choice.GO
    assert choices[replies[before][0]] is Choice.STOP
    axes = [correction for _, correction, _ in replies[before - 1 :]]
    cycles_to_rest = axes.index(axes[-1])
    assert 1 < cycles_to_rest <= LONGEST_STOP_CYCLES  # smoothly, and soon
    assert largest_step(replies) < WORKING_SHARE
    assert {later - ipoc for (ipoc, _, _), (later, _, _) in pairwise(replies)} == {4}  # none left out
    assert axes[-1][0] < degrees(FAR[0]) - 1.0  # on its way


@pytest.mark.hazard(4)
def test_a_cut_eki_channel_stops_the_arm_and_recovery_retries_until_it_reopens(
    controller: Any, patient_arm: Any
) -> None:
    error = _stopped(patient_arm, controller, lambda c: c.drop_eki())
    assert is_error(error, STREAM_ERRORS.lost)
    controller.turned_away = 2
    patient_arm.recover("Ana")
    assert controller.turned_away == 0
    assert patient_arm.state is Lifecycle.CONFIGURED
    # The program that still ran was ended, not assumed to have ended with the channel.
    assert controller.facts["RSI"] == "0"
    patient_arm.activate()
    patient_arm.move(JointMove(THERE))


def test_padding_and_text_between_eki_telegrams_are_skipped(controller: Any, patient_arm: Any) -> None:
    controller.send_raw(bytes(500) + b" ready\r\n")
    controller.tell(Tool="7")
    eventually(lambda: patient_arm.connections.control.latest.tool == 7)
    patient_arm.move(JointMove(THERE))
    assert patient_arm.state is Lifecycle.ACTIVE


STOOD_STILL_S = 30.0


@pytest.mark.hazard(4)
def test_what_came_while_the_reader_did_not_run_is_taken_late_and_no_silence(
    controller: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, runs, held = [100.0], threading.Event(), threading.Event()
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    runs.set()

    def hold(direction: Direction, _data: bytes) -> None:
        if direction is Direction.RECEIVED and not runs.is_set():
            held.set()
            runs.wait(HANG_LIMIT_S)

    with closing(EkiClient("127.0.0.1", controller.eki_port, HANG_LIMIT_S, hold)) as client:
        client.request_state()
        eventually(lambda: client.latest is not None)
        runs.clear()
        number = client.request_state()
        assert held.wait(HANG_LIMIT_S)
        now_s[0] += STOOD_STILL_S
        assert client.silent_s == 0.0
        threading.Timer(0.1, runs.set).start()
        assert client.await_reply(number, 0.0) is not None
