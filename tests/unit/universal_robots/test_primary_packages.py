"""Parts of a robot state on the primary interface."""

from __future__ import annotations

import math
import struct

import pytest
from coded_errors import raises

from drivers.universal_robots.errors import BAD_BYTES
from drivers.universal_robots.primary.packages import Joints, iterate_parts
from ronna_hw.wire import universal_robots_services as wire
from ronna_hw.wire.universal_robots_services import PartKind

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
