"""What a console receives from the program that started it."""

from __future__ import annotations

import os
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from procedures.cli.console import link
from procedures.cli.console.desk import Desk
from procedures.cli.console.options import ConsoleOptions
from ronna_hw.command_line.errors import UsageMistake


class Listening:
    """A console's process that only keeps its end of the socket."""

    def __init__(self, *_command: Any, inherited: tuple[int, ...], **_more: Any) -> None:
        self.socket = socket.socket(fileno=os.dup(inherited[0]))
        self.socket.settimeout(5.0)
        self.process = self

    def await_ready(self, _limit_s: float) -> dict[str, str]:
        return {}

    def wait(self, timeout: float) -> None:
        pass

    def stop(self) -> None:
        self.socket.close()


def test_a_console_receives_a_heartbeat_before_the_theatre_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "ChildProcess", Listening)
    console: Any = link.ConsoleLink(tmp_path, Desk(waits=True), 0, lambda _words: None)
    try:
        heard = console._child.socket.recv(100)
    finally:
        console.close()
    assert heard.startswith(b'{"beat":1}\n')


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

    monkeypatch.setattr(link, "ChildProcess", Slow)
    console = link.ConsoleLink(tmp_path, Desk(waits=False), 0, said.append)
    try:
        with ThreadPoolExecutor(1) as beside:
            waiting = beside.submit(console.await_ready)
            assert said == []
            may_answer.set()
            waiting.result(10.0)
        assert said[0].startswith("no console" if fails else "CONSOLE")
    finally:
        console.close()


def test_a_port_in_use_is_reported_before_a_theatre_is_opened() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UsageMistake, match=rf"CLI-001: --console-port {port} cannot be used: .*in use"):
            ConsoleOptions(console=True, console_port=port).request()
