import json
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ronna_hw.endpoints import parse_endpoint
from sim.theatre.control import ControlPort, Room
from sim.theatre.scene.named_scenes import named_scene
from sim.theatre.world import World

RESET = struct.pack("ii", 1, 0)  # linger for 0 s: closing sends a reset


@pytest.fixture
def room(tmp_path: Path) -> Room:
    return Room(World.create(named_scene("mini"), paced=False), tmp_path)


@pytest.fixture
def address(room: Room) -> Iterator[tuple[str, int]]:
    port = ControlPort(room)
    endpoint = parse_endpoint(port.endpoint)
    yield endpoint.host, endpoint.port
    port.close()


def _ask(address: tuple[str, int], **request: Any) -> dict[str, Any]:
    with socket.create_connection(address, timeout=5) as line, line.makefile("rw") as file:
        file.write(json.dumps(request) + "\n")
        file.flush()
        answer: dict[str, Any] = json.loads(file.readline())
        return answer


def test_a_reset_connection_leaves_no_trace_and_the_next_is_served(
    address: tuple[str, int], capfd: pytest.CaptureFixture[str]
) -> None:
    for _ in range(5):
        line = socket.create_connection(address, timeout=5)
        line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        line.sendall(b'{"do": "step", "name": "set_up"}\n' * 50)
        line.close()
    assert _ask(address, do="step", name="set_up")["ok"]
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(
    "line",
    ["at 0 s: tracker occlude marker 99 for 1 s", "tea"],
)
def test_a_live_fault_that_cannot_happen_is_refused_with_its_code(room: Room, line: str) -> None:
    answer = room.answer({"do": "fault", "line": line})
    assert not answer["ok"]
    assert "SIM-003" in answer["reason"]
    assert room.answer({"do": "fault", "line": "at 0 s: tracker occlude marker 1 for 1 s"})["ok"]
