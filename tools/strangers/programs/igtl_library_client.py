"""libOpenIGTLink, the reference library, by a compiled client: tests/support/devices."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from igtl_reference import ReadMessage, compile_reference_client, read_by_reference_client
from igtl_wire import IN_TWO, OTHER, POSE, VOXELS, WRONG_SUM, sending, served
from linked_case import TOOL_IN_RAS

ENDED_BEFORE = 3  # its code when the server goes


@cache
def program() -> Path:
    return compile_reference_client(Path(mkdtemp()))


def told(kind: str, name: str, *others: str) -> ReadMessage:
    """Read from our server to a message of each type; return the one of that name."""
    with served() as case:
        code, rows = read_by_reference_client(program(), case.port, kind, *others)
    assert code == 0
    return [row for row in rows if (row.kind, row.name) == (kind, name) and row.is_read][-1]


def received(kind: str, *parts: bytes) -> list[ReadMessage]:
    with sending(*parts) as port:
        return read_by_reference_client(program(), port, kind)[1]


def numbers(words: list[str]) -> list[float]:
    return [float(word) for word in words]


def reads_a_transform() -> None:
    assert np.allclose(numbers(told("TRANSFORM", "ToolToRas", "TDATA").words), np.ravel(TOOL_IN_RAS))


def reads_a_text() -> None:
    assert told("STRING", "RunState").words == ["idle"]


def reads_points() -> None:
    assert numbers(told("POINT", "Spheres", "TRAJ").words[-4:]) == [-1, -2, 3, 10]


def reads_a_status() -> None:
    assert told("STATUS", "tracker", "TRAJ").words[:2] == ["18", "NDI-004"]


def reads_a_trajectory() -> None:
    assert told("TRAJ", "Plan").words[0] == "T1"


def reads_tracking_data() -> None:
    assert "Tool" in told("TDATA", "ronna-hw").words


def reads_an_image() -> None:
    assert int(told("IMAGE", "CT").words[-1]) == VOXELS.sum()


def skips_a_message_that_it_does_not_know() -> None:
    assert received("TRANSFORM", OTHER, POSE)[-1].is_read


def refuses_a_wrong_check_sum() -> None:
    assert not received("OWNKIND", WRONG_SUM, OTHER)[0].is_read, "a wrong check sum is accepted"


def reads_a_message_that_comes_in_two_packets() -> None:
    assert received("TRANSFORM", *IN_TWO)[-1].is_read


def notices_that_the_server_has_gone() -> None:
    with sending(POSE, keep=False) as port:
        code, (pose,) = read_by_reference_client(program(), port, "NONE")
    assert (pose.is_read, code) == (True, ENDED_BEFORE)
