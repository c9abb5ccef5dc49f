"""The lies of a hostile tracker reach the parsers: their CRCs are right."""

from __future__ import annotations

import struct

import pytest
from hostile_devices import with_right_crcs

from drivers.ndi_polaris.command_link import open_ascii, split_binary
from ronna_hw.wire.polaris import BX_START, crc16


@pytest.mark.parametrize("true", [b"0101", b"VER 1\n2"])
def test_a_text_that_lies_is_opened(true: bytes) -> None:
    reply = true + b"%04X\r" % crc16(true)
    told = with_right_crcs(reply, true.replace(b"1", b"9999") + reply[len(true) :])
    assert open_ascii(told.removesuffix(b"\r")) == true.replace(b"1", b"9999").decode()


@pytest.mark.parametrize(("length", "read"), [(4, b"\xff\xff\xff\xff"), (5, None)])
def test_a_binary_reply_that_lies_is_opened_and_one_of_another_length_waited_for(
    length: int, read: bytes | None
) -> None:
    head, body = struct.pack("<HH", BX_START, 4), b"\1\2\3\4"
    reply = b"".join(part + struct.pack("<H", crc16(part)) for part in (head, body))
    told = with_right_crcs(reply, b"\0\0" + struct.pack("<H", length) + b"\0\0" + b"\xff" * 4 + b"\0\0")
    opened = split_binary(told)
    assert (opened and opened[0]) == read
