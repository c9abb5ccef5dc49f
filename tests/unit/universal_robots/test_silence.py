"""Silence of a controller: what was listened to in vain, not the time in which this program did not run."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest
from coded_errors import raises
from handmade_ur import robot_state

from drivers.universal_robots.dashboard import BANNER, DashboardClient
from drivers.universal_robots.errors import STREAM_ERRORS
from drivers.universal_robots.primary.client import ControllerState, PrimaryClient
from ronna_hw.arm_stream.control_channel import QUIET_S
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import RonnaError
from ronna_hw.wire.universal_robots_services import Query

LIMIT_S = 10.0
STOOD_STILL_S = 30.0
KEY_MESSAGE = bytes.fromhex("00000010 14 0000000000000000 00 07 00")


class SilenceListener:
    def __init__(self) -> None:
        self.heard_nothing = threading.Event()

    def on_state(self, state: ControllerState) -> None: ...

    def on_silence(self) -> None:
        self.heard_nothing.set()

    def on_loss(self, failure: RonnaError) -> None: ...


class Line:
    """A client whose reader can be kept from running, and whose clock the test advances."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        self.runs, self.received = threading.Event(), threading.Event()
        self.runs.set()
        monkeypatch.setattr("time.monotonic", lambda: self.now_s)
        with socket.create_server(("127.0.0.1", 0)) as server:
            host, port = server.getsockname()
            self.client = PrimaryClient(host, port, LIMIT_S, self._hold)
            self.controller = server.accept()[0]

    def _hold(self, _direction: Direction, _data: bytes) -> None:
        self.received.set()
        self.runs.wait(LIMIT_S)

    def close(self) -> None:
        self.runs.set()
        self.client.close()
        self.controller.close()


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> Iterator[Line]:
    line = Line(monkeypatch)
    yield line
    line.close()


def test_a_reader_that_did_not_run_is_no_silence_of_the_controller(line: Line) -> None:
    line.runs.clear()
    line.controller.sendall(KEY_MESSAGE)
    assert line.received.wait(LIMIT_S)
    line.now_s += STOOD_STILL_S
    assert line.client.silent_s == 0.0


def test_what_a_reader_has_listened_to_in_vain_is_silence(line: Line) -> None:
    listener = SilenceListener()
    line.now_s += STOOD_STILL_S
    line.client.listen(listener)
    for _ in range(2):  # the first may have begun before the clock was advanced
        listener.heard_nothing.clear()
        assert listener.heard_nothing.wait(LIMIT_S)
    assert line.client.silent_s == pytest.approx(STOOD_STILL_S + QUIET_S)


def test_a_state_that_came_in_time_is_taken_though_the_reader_runs_after_the_limit(line: Line) -> None:
    line.runs.clear()
    line.controller.sendall(robot_state())
    assert line.received.wait(LIMIT_S)
    line.now_s += STOOD_STILL_S
    threading.Timer(0.1, line.runs.set).start()
    assert line.client.await_state(0.0) is line.client.latest


def test_a_state_that_came_before_the_request_does_not_answer_it_though_it_is_read_later(line: Line) -> None:
    line.runs.clear()
    line.controller.sendall(robot_state())  # in the reader's hands
    assert line.received.wait(LIMIT_S)
    line.controller.sendall(robot_state())  # unread
    assert select.select((line.client._socket,), (), (), LIMIT_S)[0]
    line.now_s += STOOD_STILL_S
    threading.Timer(0.1, line.runs.set).start()
    with raises(STREAM_ERRORS.no_answer):
        line.client.await_new_state(0.0)


def test_an_answer_of_the_dashboard_that_came_in_time_is_taken_after_the_limit() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:
        accepting = pool.submit(lambda: _greet(server.accept()[0]))
        host, port = server.getsockname()

        def stand_still_until_answered(direction: Direction, _data: bytes) -> None:
            if direction is Direction.SENT:
                controller.sendall(b"Robotmode: RUNNING\n")
                assert select.select((dashboard._socket,), (), (), LIMIT_S)[0]

        dashboard = DashboardClient(host, port, LIMIT_S, stand_still_until_answered)
        with accepting.result() as controller, closing(dashboard):
            assert dashboard.ask(Query.ROBOT_MODE, 0.0) == "Robotmode: RUNNING"


def _greet(client: socket.socket) -> socket.socket:
    client.sendall(BANNER.encode() + b"\n")
    return client
