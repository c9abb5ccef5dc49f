"""Framing: command lines out of the byte stream, and replies with their CRC."""

from __future__ import annotations

import pytest

from sim.polaris.unit.framing import LineBuffer, Overlong, ascii_reply, binary_reply, parse_request
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode

LIMIT = 40


@pytest.mark.parametrize(
    ("line", "name", "argument"),
    [
        (b"INIT:E3A5", "INIT", ""),
        (b"INIT ", "INIT", ""),
        (b"INIT", "INIT", ""),
        (b"TX:1801" + b"3D9A", "TX", "1801"),
        (b"TX 1801", "TX", "1801"),
        (b"PHSR:0020ff", "PHSR", "00"),
        (b"SET Param.User.String0=a:b c", "SET", "Param.User.String0=a:b c"),
        (b"\nTSTOP ", "TSTOP", ""),
    ],
)
def test_all_three_forms_of_a_command_are_read(line: bytes, name: str, argument: str) -> None:
    request = parse_request(line)
    assert (request.name, request.argument) == (name, argument)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"INIT:E3A6", NdiErrorCode.WRONG_CRC),
        (b"INIT:+3A5", NdiErrorCode.WRONG_CRC),
        (b"INIT:E3", NdiErrorCode.TOO_SHORT),
        (b"", NdiErrorCode.TOO_SHORT),
        (Overlong(b"ECHO"), NdiErrorCode.TOO_LONG),
    ],
)
def test_a_malformed_line_is_refused_with_its_own_code(line: bytes, code: NdiErrorCode) -> None:
    with pytest.raises(CommandRefusal) as refused:
        parse_request(line)
    assert refused.value.code is code


def test_an_answer_carries_its_crc_high_byte_first() -> None:
    assert ascii_reply("OKAY") == b"OKAYA896\r"
    assert ascii_reply("RESET") == b"RESETBE6F\r"
    assert ascii_reply("ERROR01") == b"ERROR016BC2\r"


def test_a_binary_answer_ends_with_its_crc() -> None:
    body = bytes.fromhex("01 0102 31000000 2D010000 0000")
    assert binary_reply(body) == bytes.fromhex("C4A5 0D00 2983") + body + bytes.fromhex("9E7D")


def test_commands_may_arrive_byte_by_byte_or_several_at_once() -> None:
    buffer = LineBuffer(LIMIT)
    assert [buffer.feed(b"%c" % byte, 0.0) for byte in b"INIT \r"] == [[], [], [], [], [], [b"INIT "]]
    assert buffer.feed(b"TSTOP \rVER 0\rTX", 0.1) == [b"TSTOP ", b"VER 0"]
    assert buffer.feed(b" 0001\r", 0.2) == [b"TX 0001"]


def test_a_half_sent_command_is_dropped_after_a_pause() -> None:
    buffer = LineBuffer(LIMIT)
    assert buffer.feed(b"PVWR 0100", 0.0) == []
    assert buffer.feed(b"INIT \r", 5.0) == [b"INIT "]


def test_an_overlong_line_is_cut_and_the_next_one_is_intact() -> None:
    buffer = LineBuffer(LIMIT)
    for _ in range(10):
        assert buffer.feed(b"x" * 30, 0.0) == []
    first, second = buffer.feed(b"xxx\rINIT \r", 0.0)
    assert isinstance(first, Overlong)
    assert second == b"INIT "
