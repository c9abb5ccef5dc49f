"""What a console receives from the program that started it."""

from __future__ import annotations

import os
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell
from waiting import eventually

from procedures.cli.case.options import ConsoleOptions
from procedures.runs import console_link
from procedures.runs.operator_station import LEASE_S, OperatorStation
from procedures.runs.orders import Claim, SentOrder
from ronna_hw.command_line import messages
from ronna_hw.command_line.errors import UsageMistake


class Listening:
    """A console's process that only keeps its end of the socket."""

    def __init__(self, *_command: Any, inherited: tuple[int, ...], **_more: Any) -> None:
        self.socket = socket.socket(fileno=os.dup(inherited[0]))
        self.socket.settimeout(5.0)
        self.process = self

    def await_ready(self, _limit_s: float) -> dict[str, str]:
        return {"url": "http://127.0.0.1:1/?token=t"}

    def wait(self, timeout: float) -> None:
        pass

    def stop(self) -> None:
        self.socket.close()


def test_a_console_receives_a_heartbeat_before_the_theatre_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console_link, "ChildProcess", Listening)
    console: Any = console_link.ConsoleLink(
        tmp_path, OperatorStation(waits=True), console_link.ConsoleRequest(), lambda _words: None
    )
    try:
        heard = console._child.socket.recv(100)
    finally:
        console.close()
    assert heard.startswith(b'{"beat":1}\n')


def test_a_console_hears_that_the_seat_is_free_while_the_engine_is_busy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console_link, "ChildProcess", Listening)
    now_s = [0.0]
    station = OperatorStation(waits=True, now_s=lambda: now_s[0])
    engine = RecordingCell(tmp_path).engine(plain_order())  # neither asks nor waits
    station.attach(engine)
    console: Any = console_link.ConsoleLink(
        tmp_path, station, console_link.ConsoleRequest(), lambda _words: None
    )
    heard = bytearray()

    def is_heard(words: bytes) -> bool:
        heard.extend(console._child.socket.recv(1 << 16))
        return words in heard

    try:
        console.follow(engine.events)
        station.take(SentOrder(nonce="nonce-01", session="session-ana", order=Claim(name="Ana")))
        eventually(lambda: is_heard(b'"holder":"Ana"'))
        now_s[0] = LEASE_S + 1.0
        eventually(lambda: is_heard(b'"holder":"","reason":"the operator\'s page has not responded'))
    finally:
        engine.events.end()  # closing waits for the end of what it sends
        console.close()


@pytest.mark.parametrize("fails", [False, True])
def test_a_case_waits_until_its_console_serves_or_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    may_answer, said = threading.Event(), []

    class Slow(Listening):
        def await_ready(self, limit_s: float) -> dict[str, str]:
            may_answer.wait(limit_s)
            if fails:
                raise ValueError("it says nothing")
            return {}

    monkeypatch.setattr(console_link, "ChildProcess", Slow)
    console = console_link.ConsoleLink(
        tmp_path, OperatorStation(waits=True), console_link.ConsoleRequest(), said.append
    )
    try:
        with ThreadPoolExecutor(1) as beside:
            waiting = beside.submit(console.await_ready)
            assert said == []
            may_answer.set()
            waiting.result(10.0)
        assert said[0].startswith("no console" if fails else "CONSOLE")
        assert any("takes the operator's seat" in line for line in said) is not fails
    finally:
        console.close()


def test_a_free_port_is_found_free_without_listening_at_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket.socket, "listen", lambda *_: pytest.fail("somebody could connect"))
    ConsoleOptions(console=True, console_port=0).request()


def test_a_port_in_use_is_reported_before_a_theatre_is_opened() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageMistake, match=rf"CLI-001: --console-port {port} cannot be used: .*in use"):
            ConsoleOptions(console=True, console_port=port).request()


@pytest.mark.parametrize(("terminal", "lines"), [(False, ["CONSOLE"]), (True, ["CONSOLE", "open"])])
def test_the_address_of_a_page_is_one_line_for_scripts_and_on_a_terminal_another_to_click(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, lines: list[str]
) -> None:
    monkeypatch.setattr(messages, "on_terminal", lambda _stream: terminal)
    shown: list[str] = []
    messages.tell_address({"url": "http://127.0.0.1:1/?token=t"}, shown.append)
    assert [line.split()[0] for line in shown] == lines
    assert shown[-1].endswith(("http://127.0.0.1:1/?token=t", '"}'))
