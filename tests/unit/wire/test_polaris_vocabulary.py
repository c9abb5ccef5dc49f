"""CRC and code tables of the tracker link, checked against published values."""

import itertools

import pytest

from ronna_hw.wire import polaris, polaris_rom

KNOWN_CRCS = {
    "INIT:": 0xE3A5,
    "OKAY": 0xA896,
    "RESET": 0xBE6F,
    "VER:0": 0x65EE,
    "GETINFO:Features.Firmware.Version": 0x0492,
    "COMM:50000": 0x0048,
    "COMM:00000": 0x0084,
    "PHRQ:*********1****": 0xA4C1,
    "PHSR:00": 0x20FF,
    "PHSR:02": 0xE17E,
    "PINIT:01": 0x31EA,
    "PENA:01D": 0x6D3B,
    "APIREV:": 0x443E,
    "TSTART:": 0x5423,
    "TSTART:80": 0x1B0B,
    "TSTOP:": 0x2C14,
    "TX:0001": 0x031A,
    "TX:0801": 0xC19B,
    "TX:1801": 0x3D9A,
    "BX:0001": 0xC26D,
    "BX:0801": 0x00EC,
    "BX:1801": 0xFCED,
    "ERROR01": 0x6BC2,
    "ERROR04": 0x6802,
    "ERROR0C": 0x4E42,
    "ERROR10": 0x3B02,
    "ERROR2B": 0xEE82,
    "0": 0x1400,
    "WARNING": 0x7423,
    "WARNING05": 0x00CD,
}


@pytest.mark.parametrize(("text", "crc"), KNOWN_CRCS.items())
def test_the_crc_agrees_with_published_values(text: str, crc: int) -> None:
    assert polaris.crc16(text.encode()) == crc


def test_the_crc_over_data_and_its_own_crc_is_zero() -> None:
    data = b"\xc4\xa5\x2d\x00"
    crc = polaris.crc16(data)
    assert crc == 0x4330
    assert polaris.crc16(data + crc.to_bytes(2, "little")) == 0


def test_every_error_code_has_its_own_meaning() -> None:
    assert len(set(polaris.ERROR_MEANINGS.values())) == len(polaris.ERROR_MEANINGS)
    assert set(range(0x01, 0x43)) <= set(polaris.ERROR_MEANINGS)


def test_the_tool_definition_fields_fill_the_block_without_overlap() -> None:
    fields = [
        (polaris_rom.MARKER_POSITIONS_OFFSET, 240),
        (polaris_rom.MARKER_NORMALS_OFFSET, 240),
        (polaris_rom.FIRING_SEQUENCE_OFFSET, 20),
        (polaris_rom.LEDS_OFFSET, 4),
        (polaris_rom.MANUFACTURER_OFFSET, 12),
        (polaris_rom.PART_NUMBER_OFFSET, 20),
        (polaris_rom.CONSTANT_NINE_OFFSET, 1),
        (polaris_rom.MARKER_FACES_OFFSET, 20),
        (polaris_rom.MARKER_GROUPS_OFFSET, 20),
        (polaris_rom.FLAGS_OFFSET, 1),
        (polaris_rom.MARKER_TYPE_OFFSET, 1),
        (polaris_rom.FACE_NORMALS_OFFSET, 96),
    ]
    for (start, size), (following, _) in itertools.pairwise(fields):
        assert start + size <= following
    last, size = fields[-1]
    assert last + size == polaris_rom.ROM_BYTES
