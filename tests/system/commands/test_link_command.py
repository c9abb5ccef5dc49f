"""`ronna-link` beside a running case, as a process of its own, and started by the case."""

from __future__ import annotations

import json
import os
import queue
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
from coded_errors import raises
from linked_case import BEGAN, PlainClient, pose

from procedures.journal.journal import JOURNAL_FILE
from procedures.live.errors import ADDRESS_UNUSABLE
from procedures.live.feed_socket import FeedSocket
from procedures.runs.observers import RunObservers
from procedures.runs.openigtlink import LinkAddress, with_openigtlink
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request
from ronna_hw.host.child_process import ChildProcess, command, descendants_of
from ronna_hw.wire.openigtlink_contents import decode_status

HANG_LIMIT_S = 60.0


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run's folder without a case in it."""
    write_request(RunRequest(procedure=CaseProcedure()), tmp_path)
    (tmp_path / JOURNAL_FILE).touch()
    return tmp_path


@pytest.fixture
def feed(run: Path) -> Iterator[FeedSocket]:
    opened = FeedSocket(run, BEGAN)
    yield opened
    opened.close()


def link(run: Path, *options: str) -> list[str]:
    return command("procedures.cli.link", "openigtlink", str(run), *options)


def refused(run: Path, *options: str) -> tuple[int, str]:
    done = subprocess.run(link(run, *options), capture_output=True, text=True, timeout=HANG_LIMIT_S)
    return done.returncode, done.stderr


def connect(ready: dict[str, Any]) -> PlainClient:
    return PlainClient(int(ready["openigtlink"].rpartition(":")[2]))


def test_a_case_is_served_until_it_ends(run: Path) -> None:
    feed = FeedSocket(run, BEGAN)
    feed.offer([pose("robot", "ct").model_copy(update={"is_fixed": True})])
    with ChildProcess("ronna-link", link(run, "--port", "0")) as server, connect(server.ready) as client:
        assert server.ready["run"] == run.name
        client.first("TRANSFORM", "RobotToRas")
        feed.close()
        assert decode_status(list(client.messages())[-1].content).code == 19
        assert server.process.wait(HANG_LIMIT_S) == 0


def test_a_folder_without_a_running_case_is_refused(run: Path) -> None:
    code, words = refused(run, "--port", "0")
    assert code == 4
    assert "LIV-001" in words


def test_a_port_in_use_is_refused_by_the_command(run: Path, feed: FeedSocket) -> None:
    with ChildProcess("ronna-link", link(run, "--port", "0")) as server:
        port = server.ready["openigtlink"].rpartition(":")[2]
        code, words = refused(run, "--port", port)
    assert code == 2
    assert "LIV-011" in words
    assert "already in use" in words


def test_a_case_goes_on_and_says_so_when_its_server_dies(run: Path, feed: FeedSocket) -> None:
    said: queue.SimpleQueue[str] = queue.SimpleQueue()
    with with_openigtlink(RunObservers(announce=said.put), run, LinkAddress("127.0.0.1", 0)) as observers:
        observers.opened(cast(Any, None))
        ready = json.loads(said.get(timeout=HANG_LIMIT_S).removeprefix("READY "))
        with connect(ready) as client:
            feed.offer([pose("robot", "ct").model_copy(update={"is_fixed": True})])
            client.first("TRANSFORM", "RobotToRas")
            (server,) = [one for one in descendants_of(os.getpid()) if "procedures.cli.link" in one.cmdline()]
            server.kill()
            assert "the case goes on" in said.get(timeout=HANG_LIMIT_S)


@pytest.mark.parametrize("address", ["18944", "127.0.0.1:", "127.0.0.1:65536", ":18944"])
def test_an_address_that_is_none_is_refused(address: str) -> None:
    with raises(ADDRESS_UNUSABLE, match="no address"):
        LinkAddress.parse(address)


def test_the_address_of_another_computer_is_refused_before_anything_is_opened() -> None:
    with raises(ADDRESS_UNUSABLE, match="cannot be used"):
        LinkAddress.parse("192.0.2.1:18944").check()


@pytest.mark.slow
def test_a_mini_case_is_served_from_its_start_and_ends_as_without(tmp_path: Path) -> None:
    line = command("procedures.cli.procedure", "run", "--sim", "--scene", "mini", "--seed", "7", "--json")
    line += ["--out", str(tmp_path), "--openigtlink", "127.0.0.1:0"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        ready = next(words for words in process.stderr if words.startswith("READY "))
        with connect(json.loads(ready.removeprefix("READY "))) as client:
            _, before = client.until(lambda one: (one.kind, one.name) == ("TRANSFORM", "ToolToRas"))
            messages = [*before, *client.messages()]
        output, _ = process.communicate(timeout=HANG_LIMIT_S)
    assert process.returncode == 0
    outcome = json.loads(output)
    assert outcome["max_application_error_mm"] < 1.0
    names = {(one.kind, one.name) for one in messages}
    assert {
        ("TRANSFORM", "ToolToRobot"),
        ("TRANSFORM", "RobotToRas"),
        ("TRANSFORM", "TrackerToRobot"),
        ("STATUS", "tracker"),
        ("STATUS", "arm"),
        ("STRING", "RunState"),
        ("POINT", "Spheres"),
        ("TRAJ", "Plan"),
    } <= names
    assert decode_status(messages[-1].content).code == 19
