"""What devices send to the conformance suite, and what reads it there."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Callable
from functools import partial
from typing import cast

from good_inputs import DESCRIPTION, PACKET_BYTES, STATE, TELEGRAM, Take, packets

from conformance.case import Nonconformity, NotShown, check
from conformance.gige.client import GigeFeatures, GigeLink
from conformance.gige.stream import GigeStream, decode_leader, require_leader
from conformance.kuka.client import EkiLine, Telegram
from conformance.polaris.client import PolarisLink
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.gige_vision import TEXT_BYTES, Bootstrap, GevStatus
from ronna_hw.wire.polaris import BX_START, crc16

XML_AT = 0x10000
LONGEST_READ_BYTES = 536
LEFT_UNREAD_BYTES = 1 << 20  # of a socket between two ends of one process


def conformance_parsers() -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it: a device that is not as it should be fails."""
    body = b"\1\1\2" + bytes(10)
    return {
        "conformance features": ((_url(DESCRIPTION) + b"\n" + DESCRIPTION,), _features),
        "conformance stream": ((packets(),), _stream),
        "conformance EKI": ((STATE + b'<Ack Id="7" Code="0"></Ack>\r\n',), _eki),
        "conformance RSI": ((TELEGRAM,), _telegram),
        "conformance Polaris": ((b"020100102001", b"OKAY", body), _unit),
    }


class _Memory(GigeLink):
    """A camera's memory: an address of its description, and what is there."""

    def __init__(self, url: bytes, description: bytes) -> None:
        self._url, self._description = url, description

    def memory(self, address: int, count: int) -> bytes:
        struct.pack(">IHH", address, 0, count)
        check(count <= LONGEST_READ_BYTES, "a piece of memory", count)
        if address == Bootstrap.FIRST_URL:
            return self._url[: TEXT_BYTES[Bootstrap.FIRST_URL]].ljust(count, b"\0")
        at = address - XML_AT
        found = self._description[at : at + count] if at >= 0 else b"\x40\x09"
        return found.ljust(count, b"\0")

    def write_memory(self, address: int, data: bytes) -> int:
        struct.pack(">IH", address, len(data))
        return GevStatus.SUCCESS

    def write(self, address: int, value: int) -> int:
        struct.pack(">II", address, value)
        return GevStatus.SUCCESS


def _fails(ask: Callable[[], object]) -> None:
    with contextlib.suppress(Nonconformity, NotShown):
        ask()


def _features(data: bytes) -> None:
    url, _, description = data.partition(b"\n")
    for one in (url, _url(description)):
        _asked(GigeFeatures(_Memory(one, description)))


def _url(description: bytes) -> bytes:
    return b"Local:cam.xml;%x;%x" % (XML_AT, len(description))


def _asked(features: GigeFeatures) -> None:
    _fails(lambda: features.description)
    _fails(features.addresses)
    if "description" not in vars(features):
        return
    for name in list(features.nodes)[:50]:
        for ask in (
            partial(features.get, name),
            partial(features.whole, name),
            partial(features.set, name, 5),
            partial(features.set, name, "On"),
            partial(features.limit, name, "Min"),
            partial(features.limit, name, "Max"),
            partial(features.execute, name),
        ):
            _fails(ask)


class _Stream(GigeStream):
    """A stream of packets that have come."""

    def __init__(self, came: list[bytes]) -> None:
        self._came = came

    def datagram(self, limit_s: float) -> bytes | None:
        return self._came.pop(0) if self._came else None


def _stream(data: bytes) -> None:
    came = [data[at : at + PACKET_BYTES] for at in range(0, len(data), PACKET_BYTES)]
    stream = _Stream(came)
    while came:
        _fails(lambda: require_leader(stream.frame()))
    _fails(lambda: [decode_leader(one) for one in _Stream([data]).drain_packets()])


class _Line(EkiLine):
    """A channel over which all that came is there, and then closed."""

    came = b""

    def _connect(self) -> socket.socket:
        return cast("socket.socket", self)

    def settimeout(self, _limit_s: float) -> None:
        pass

    def recv(self, size: int) -> bytes:
        given, self.came = self.came[:size], self.came[size:]
        return given

    def sendall(self, _data: bytes) -> None:
        pass


ENDPOINT = parse_endpoint("tcp://127.0.0.1:1")


def _eki(data: bytes) -> None:
    for ask in (lambda line: line.ask("STOP"), lambda line: line.answer("State", "7")):
        line = _Line(ENDPOINT)
        line.came, line._number = data, 6
        _fails(partial(ask, line))


def _telegram(data: bytes) -> None:
    telegram = Telegram(data, ("127.0.0.1", 1), 0.0)
    for ask in (lambda: telegram.ipoc, lambda: telegram.late, lambda: telegram.values("AIPos")):
        _fails(ask)


def _unit(data: bytes) -> None:
    """The CRC is no secret."""
    header = struct.pack("<HH", BX_START, len(data) & 0xFFFF)
    checked = data.replace(b"\r", b"")
    whole = header + struct.pack("<H", crc16(header)) + data + struct.pack("<H", crc16(data))
    said = b"%b%04X\r" % (checked, crc16(checked))
    for came, ask in (
        (data, PolarisLink.text),
        (said, PolarisLink.handles),
        (said, lambda link: link.load_tool(bytes(752))),
        (data, lambda link: link.ask_binary("BX 0001")),
        (whole, lambda link: link.ask_binary("BX 0001")),
        (data, PolarisLink.read_rest),
    ):
        theirs, ours = socket.socketpair()
        with theirs, ours:
            theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, LEFT_UNREAD_BYTES)
            theirs.setblocking(False)
            theirs.send(came)
            theirs.shutdown(socket.SHUT_WR)
            _fails(partial(ask, PolarisLink(ours)))
