"""Primary client: each part of a state is as old as the package that carried it."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import pytest
from coded_errors import raises
from handmade_ur import robot_state
from waiting import eventually

from drivers.universal_robots.errors import BAD_BYTES
from drivers.universal_robots.primary.client import PrimaryClient
from drivers.universal_robots.primary.packages import Joints, iterate_parts
from ronna_hw.wire import universal_robots_services as wire
from ronna_hw.wire.universal_robots_services import PartKind

LIMIT_S = 10.0
MODE, JOINTS, BOARD = 0, 1, 3
FIRST_US, LATER_US = 1_000_000, 3_000_000


def only(package: bytes, *kinds: int) -> bytes:
    """Return a robot state with these of its parts alone."""
    body, offset = b"", 5
    while offset < len(package):
        size, kind = struct.unpack_from(">IB", package, offset)
        body += package[offset : offset + size] if kind in kinds else b""
        offset += size
    return struct.pack(">iB", 5 + len(body), 16) + body


class Line:
    """A client that has read one whole state, and its controller."""

    def __init__(self, client: PrimaryClient, controller: socket.socket) -> None:
        self.client, self._controller = client, controller
        self.send(robot_state())

    def send(self, package: bytes) -> None:
        """Send a package, and return once it has been taken over."""
        before = self.client.latest
        self._controller.sendall(package)
        eventually(lambda: self.client.latest is not before)


@pytest.fixture
def line() -> Iterator[Line]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = PrimaryClient(*server.getsockname(), LIMIT_S)
        with closing(client), server.accept()[0] as controller:
            yield Line(client, controller)


@pytest.mark.parametrize("carried", [(MODE,), (BOARD,), (MODE, BOARD), (JOINTS,), (MODE, JOINTS)])
def test_a_package_with_some_of_the_parts_makes_no_others_new(line: Line, carried: tuple[int, ...]) -> None:
    first = line.client.await_state(LIMIT_S)
    line.send(only(robot_state(speed_fraction=0.5, digital_inputs=8, timestamp_us=LATER_US), *carried))
    latest = line.client.await_state(LIMIT_S)
    assert latest.mode.speed_fraction == (0.5 if MODE in carried else 1.0)
    assert latest.digital_inputs == (8 if BOARD in carried else 0)
    assert latest.received_s == first.received_s
    assert latest.came_after_s == first.came_after_s


@pytest.mark.parametrize(
    ("carried", "clock_us"), [((MODE, BOARD), FIRST_US), ((MODE, JOINTS), LATER_US), ((JOINTS,), 0)]
)
def test_the_time_stamp_is_that_of_the_package_with_the_joints(
    line: Line, carried: tuple[int, ...], clock_us: int
) -> None:
    line.send(only(robot_state(timestamp_us=LATER_US), *carried))
    assert line.client.await_state(LIMIT_S).device_clock == clock_us


def test_parts_that_come_one_by_one_make_a_state_as_new_as_the_first_of_them(line: Line) -> None:
    first = line.client.await_state(LIMIT_S)
    for kind in (MODE, JOINTS, BOARD):
        line.send(only(robot_state(), kind))
    latest = line.client.await_state(LIMIT_S)
    assert latest.received_s > first.received_s
    assert latest.came_after_s > first.came_after_s


def test_a_request_is_answered_by_a_whole_state_that_comes_after_it(line: Line) -> None:
    with ThreadPoolExecutor(1) as pool:
        requested = pool.submit(line.client.await_new_state, LIMIT_S)
        while not requested.done():
            line.send(only(robot_state(), MODE))
            line.send(robot_state(digital_inputs=8))
        assert requested.result().digital_inputs == 8


JOINT = struct.Struct(wire.JOINT_PART)


def joints_part(*angles_rad: float) -> bytes:
    rest = (0,) * (len(JOINT.unpack(bytes(JOINT.size))) - 1)
    body = b"".join(JOINT.pack(angle_rad, *rest) for angle_rad in angles_rad)
    header = struct.Struct(wire.PART_HEADER)
    return header.pack(header.size + len(body), PartKind.JOINTS) + body


def test_joint_angles_are_read_as_sent() -> None:
    angles_rad = (0.1, -1.5, 2.5, -6.2, 6.2, 0.0)
    (part,) = iterate_parts(joints_part(*angles_rad))
    assert isinstance(part, Joints)
    assert part.angles_rad == angles_rad


@pytest.mark.parametrize("angle_rad", [math.nan, math.inf, 1e300, -8.5])
def test_angles_that_no_joint_has_are_no_reading(angle_rad: float) -> None:
    with raises(BAD_BYTES, match="URD-016"):
        list(iterate_parts(joints_part(0.0, 0.0, 0.0, 0.0, 0.0, angle_rad)))
