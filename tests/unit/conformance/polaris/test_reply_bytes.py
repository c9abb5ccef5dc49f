"""The suite's own knowledge of the protocol agrees with the published examples."""

from __future__ import annotations

from collections.abc import Callable
from typing import IO

import pytest

from conformance.case import Nonconformity
from conformance.polaris.client import PolarisLink, place_markers, read_body, with_crc
from conformance.polaris.fixtures import (
    SPECTRA_VOLUMES,
    StatedVolume,
    build_published_definition,
    read_markers,
    reverse_normals,
    shift_origin,
)
from conformance.polaris.tap import body_of, with_body, with_system_status
from ronna_hw.wire.polaris import HandleStatus
from sim.polaris.unit.tool_definition import parse_definition

SEEN = bytes.fromhex(
    "C4A5 2D00 3043 01 0101 0000803F 00000000 00000000 00000000 00002841 0000A2C1 0080BBC4 0000003E"
    "31000000 2C010000 0000 1D2D"
)
MISSING = bytes.fromhex("C4A5 0D00 2983 01 0102 31000000 2D010000 0000 9E7D")


def test_the_published_replies_are_read() -> None:
    frame = read_body(body_of(SEEN), 0x0001)
    assert frame.handles[0].pose == (1.0, 0.0, 0.0, 0.0, 10.5, -20.25, -1500.0, 0.125)
    assert (frame.handles[0].handle, frame.handles[0].port_status, frame.frame) == ("01", 0x31, 300)
    missing = read_body(body_of(MISSING), 0x0001).handles[0]
    assert (missing.status, missing.pose, missing.frame) == (HandleStatus.MISSING, None, 301)


def test_a_body_of_the_wrong_length_is_rejected() -> None:
    with pytest.raises(Nonconformity, match="bytes in the body"):
        read_body(body_of(SEEN) + b"\0", 0x0001)


def test_a_reply_is_rebuilt_byte_for_byte() -> None:
    assert with_body(body_of(SEEN)) == SEEN
    assert with_crc("OKAY") == b"OKAYA896\r"


def test_replacing_the_system_status_keeps_the_rest_of_the_reply() -> None:
    changed = with_system_status(SEEN, 0x0200)
    assert read_body(body_of(changed), 0x0001).system_status == 0x0200
    assert body_of(changed)[:-2] == body_of(SEEN)[:-2]
    text = with_crc("0101MISSING000000310000012D\n0000")
    assert with_system_status(text, 0x0100) == with_crc("0101MISSING000000310000012D\n0100")


def test_markers_are_placed_by_rotation_and_translation() -> None:
    half = 0.5**0.5
    (moved,) = place_markers(
        ((1.0, 2.0, 3.0),), (half, 0.0, 0.0, half, 10.0, 20.0, 30.0, 0.0)
    )  # 90 deg about z
    assert moved == pytest.approx((8.0, 21.0, 33.0))


@pytest.mark.parametrize(
    ("volume", "z_mm", "half_mm"),
    [
        (0, -950.0, (224.72, 240.57)),
        (0, -1532.0, (398.00, 572.00)),
        (0, -2000.0, (537.34, 685.74)),
        (0, -2400.0, (656.43, 782.95)),
        (1, -2664.0, (735.0, 847.11)),
        (1, -3000.0, (735.0, 928.77)),
    ],
)
def test_the_volume_has_the_published_sections(
    volume: int, z_mm: float, half_mm: tuple[float, float]
) -> None:
    assert StatedVolume("5", SPECTRA_VOLUMES[volume]).half_extents_mm(z_mm) == pytest.approx(
        half_mm, abs=0.02
    )


def test_the_clearance_of_a_point_is_negative_outside() -> None:
    pyramid = StatedVolume("5", SPECTRA_VOLUMES[0])
    assert pyramid.clearance_mm((0.0, 0.0, -1000.0)) == pytest.approx(50.0)
    assert pyramid.clearance_mm((400.0, 0.0, -1532.0)) == pytest.approx(-2.0)
    assert pyramid.clearance_mm((0.0, 0.0, -2401.0)) < 0


def test_the_simulators_parser_reads_the_published_definition() -> None:
    tool = parse_definition(build_published_definition())
    assert (tool.part_number, tool.manufacturer, tool.minimum_markers) == ("8700339", "NDI", 4)
    assert tool.markers_mm[1] == pytest.approx((28.59, 41.02, 0.0), abs=1e-5)


def test_variants_of_a_definition_are_valid() -> None:
    block = build_published_definition()
    away = parse_definition(reverse_normals(block))
    assert (away.normals[:, 2] == -1.0).all()
    moved = parse_definition(shift_origin(block, (10.0, 0.0, -5.0)))
    assert moved.part_number != "8700339"
    assert read_markers(shift_origin(block, (10.0, 0.0, -5.0)))[0] == (10.0, 0.0, -5.0)


class Flooded:
    """A line on which something comes for ever."""

    def __init__(self, zeros: IO[bytes]) -> None:
        self._zeros = zeros

    def fileno(self) -> int:
        return self._zeros.fileno()

    def recv(self, size: int) -> bytes:
        return bytes(size)


@pytest.mark.parametrize("hear", [PolarisLink.read_rest, PolarisLink.text])
def test_a_line_that_never_falls_silent_fails_before_it_fills_the_memory(
    hear: Callable[[PolarisLink], object],
) -> None:
    with open("/dev/zero", "rb") as zeros, pytest.raises(Nonconformity) as failed:
        hear(PolarisLink(Flooded(zeros)))  # type: ignore[arg-type]
    assert len(str(failed.value)) < 400
