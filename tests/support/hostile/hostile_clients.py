"""A client of a simulator that means harm: on a stream, or by datagrams."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time
from collections.abc import Iterator, Sequence

from mutations import mutants

from ronna_hw.wire.gige_vision import (
    CCP_CONTROL,
    GVCP_COMMAND_HEADER,
    GVCP_KEY,
    WRITEREG_ITEM,
    Bootstrap,
    GvcpCommand,
)
from ronna_hw.wire.polaris import PVWR_BLOCK_BYTES
from ronna_hw.wire.polaris_rom import CHECKSUM_FROM, CHECKSUM_OFFSET, ROM_BYTES

RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # linger for 0 s
GIVES_UP_S = 0.3  # of a send that nobody takes
DRIP_S = 0.005
DRIPS = 60
ENDLESS_BYTES = 1 << 20
ASKED_UNREAD = 3000  # requests, whose answers are not read
MUTANTS = 200
ON_REGISTERS = (GvcpCommand.READREG, GvcpCommand.WRITEREG, GvcpCommand.READMEM, GvcpCommand.WRITEMEM)
FEATURES_ADDRESS, FEATURES = 0x20000, 64  # of the simulated cameras; some are none
WRONG_HEADERS = 0.1  # share of commands
BRACKETS = (b"[", b"{", b"<a>", b"<!DOCTYPE a [<!ENTITY b 'c'>", b"(", b"\0", b"\xff", b"9", b"GET ", b"\r\n")


def maltreat(line: socket.socket, good: Sequence[bytes], chosen: random.Random) -> str:
    """One malice on a fresh connection, by requests that would be `good`; tells which."""
    line.settimeout(GIVES_UP_S)
    kind = chosen.choice(("idle", "drip", "endless", "mutants", "unread", "reset", "half"))
    with contextlib.suppress(OSError):  # the simulator may well hang up, or take nothing more
        match kind:
            case "drip":
                for byte in (chosen.choice(good) * DRIPS)[:DRIPS]:
                    line.sendall(bytes((byte,)))
                    time.sleep(DRIP_S)
            case "endless":
                what = chosen.choice(BRACKETS)
                line.sendall(
                    chosen.choice((b"", chosen.choice(good)[:-1])) + what * (ENDLESS_BYTES // len(what))
                )
            case "mutants":
                for mutant in mutants(tuple(good), MUTANTS, chosen.randrange(2**32)):
                    line.sendall(mutant)
            case "unread":
                line.sendall(chosen.choice(good) * ASKED_UNREAD)
            case "reset":
                request = chosen.choice(good)
                line.sendall(request[: chosen.randrange(len(request) + 1)])
                line.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
                line.close()
            case "half":
                request = chosen.choice(good)
                line.sendall(request[: chosen.randrange(len(request))])
    return kind


def write_register(address: int, value: int) -> bytes:
    """The command to a camera."""
    body = struct.pack(WRITEREG_ITEM, address, value)
    return struct.pack(GVCP_COMMAND_HEADER, GVCP_KEY, 1, GvcpCommand.WRITEREG, len(body), 1) + body


def camera_commands(chosen: random.Random, count: int) -> Iterator[bytes]:
    """Commands of an application in control, most of them with a right header; some are no commands."""
    yield write_register(Bootstrap.CCP, CCP_CONTROL)
    for _ in range(count):
        code = chosen.choice((*ON_REGISTERS * 4, *GvcpCommand, chosen.randrange(0x10000)))
        feature = FEATURES_ADDRESS + 4 * chosen.randrange(4 * FEATURES)
        address = chosen.choice((*Bootstrap, feature, feature, feature, 0xFFFFFFFC, chosen.randrange(2**32)))
        number = chosen.choice((0, 1, 2, 48, 64, 1500, 0x7F000001, chosen.randrange(2**32)))
        body = struct.pack(">I", address) + chosen.choice(
            (
                b"",
                struct.pack(">HH", 0, chosen.choice((0, 4, 536, 0xFFFF))),
                *[struct.pack(">I", number)] * 3,
                chosen.randbytes(chosen.choice((1, 8, 536, 8000))),
            )
        )
        key, flags, length = GVCP_KEY, 1, len(body)
        if chosen.random() < WRONG_HEADERS:
            key, length = chosen.choice((GVCP_KEY, 0)), chosen.choice((length, 0, 0xFFFF))
            flags = chosen.choice((1, 0x11, 0x80, 0))
        yield struct.pack(GVCP_COMMAND_HEADER, key, flags, code, length, chosen.randint(1, 0xFFFF)) + body
        if chosen.random() < WRONG_HEADERS:
            yield chosen.randbytes(chosen.choice((0, 1, 7, 60_000)))


def loading(definition: bytes) -> Iterator[bytes]:
    """The tracker's commands, without their CR, that load a definition into its first handle."""
    yield b"PHRQ *********1****"
    for address in range(0, ROM_BYTES, PVWR_BLOCK_BYTES):
        block = definition[address : address + PVWR_BLOCK_BYTES].ljust(PVWR_BLOCK_BYTES, b"\0")
        yield b"PVWR 01%04X" % address + block.hex().encode()
    yield b"PINIT 01"


def with_right_checksum(definition: bytes) -> bytes:
    """The same, padded or cut: the checksum is no secret, who means ill sends the right one."""
    block = bytearray(definition.ljust(ROM_BYTES, b"\0")[:ROM_BYTES])
    struct.pack_into("<H", block, CHECKSUM_OFFSET, sum(block[CHECKSUM_FROM:]) & 0xFFFF)
    return bytes(block)
