"""Silence of a controller: what was listened to in vain, not the time in which this program did not run."""

from __future__ import annotations

import threading
from contextlib import closing
from typing import Any

import pytest
from waiting import HANG_LIMIT_S, eventually

from drivers.kuka_rsi.eki.client import EkiClient
from ronna_hw.devices.capabilities import Direction

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
