"""What comes over lines, sockets and pipes, line by line, and what cuts and reads it."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from good_inputs import Take
from record_inputs import ROOM_REQUESTS

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.telegrams import TelegramScanner
from drivers.ndi_polaris.command_link import CommandLink, decode_ascii, unit_error
from drivers.ndi_polaris.tool_loading import list_handles, request_handle
from drivers.ndi_polaris.unit import parse_whole_number, read_identity, read_parameter
from procedures.cli.case.piped_lines import LONGEST_LINE, READ_AHEAD, lines_from
from procedures.cli.tool.records import DIALS, read_gauge
from ronna_hw.arm_stream.control_channel import RECEIVE_BYTES
from ronna_hw.control_port import ControlPortClient
from ronna_hw.errors import RonnaError
from ronna_hw.tool_record import GAUGE_APPROACHES, Gauge
from ronna_hw.wire.kuka_eki import CommandName
from ronna_hw.wire.polaris import PARAMETER_FIRMWARE, HandleQuery, crc16
from sim.world.control_port import ControlledRoom, _Conversation
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

TOKEN = b'{"token": "a"}\n'
GAUGE = Gauge(joints_deg=(-40.0, -75.0, 99.0, 0.0, 66.0, 180.0))
ONE_APPROACH = b"0.01 -0.02 0.03 0.04 -0.05\n"
IDENTITY = b"Polaris Spectra Control Firmware\nNDI S/N: P9-1\nFreeze Tag:G.003\n"


def line_parsers(folder: Path) -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it; `folder` is theirs."""
    folder.mkdir()
    gauge = folder / "gauge.txt"

    def read(data: bytes) -> None:
        gauge.write_bytes(data)
        found = read_gauge(gauge, GAUGE)
        assert len(found["reading_mm"]) + len(found["upper_reading_mm"]) == len(DIALS)

    room = ControlledRoom(World.create(draw_scene("mini"), paced=False), None)
    return {
        "standard input": ((b"next\nstop\nresume\nquit",), _piped(folder / "piped")),
        "gauge readings": ((ONE_APPROACH * GAUGE_APPROACHES,), read),
        "control port": ((TOKEN + b"\n".join((*ROOM_REQUESTS, b"")),), _conversation(room)),
        "control port answer": (
            (b'{"ok": true, "a": [1.5]}\n', b'{"ok": false, "reason": "r"}\n'),
            _answered,
        ),
        "Polaris handles": ((b"020100102001", b"01", b"00"), _handles),
        "Polaris identity": ((IDENTITY, b"Info.Firmware=1\n", b"D.Param.Tracking=15"), _identity),
        "EKI acknowledgement": ((b'<Ack Id="7" Cmd="DRIVES" Code="0" Text="a"></Ack>',), _acknowledged),
    }


def _piped(path: Path) -> Take:
    """As far as it is read ahead; then whoever writes waits."""

    def take(data: bytes) -> None:
        path.write_bytes(data)
        descriptor = os.open(path, os.O_RDONLY)
        try:
            for line in islice(lines_from(descriptor), READ_AHEAD):
                assert len(line) <= LONGEST_LINE + 1
        finally:
            os.close(descriptor)

    return take


class _Came:
    """A socket on which all that comes is there, and then closed."""

    def __init__(self, came: bytes) -> None:
        self._came, self._at = came, 0
        self.sent: list[bytes] = []

    def settimeout(self, _limit_s: float) -> None:
        pass

    def recv(self, size: int) -> bytes:
        self._at += size
        return self._came[self._at - size : self._at]

    def sendall(self, data: bytes) -> None:
        self.sent.append(data)


def _conversation(room: ControlledRoom) -> Take:
    def take(data: bytes) -> None:
        came = _Came(data)
        conversation = _Conversation.__new__(_Conversation)
        conversation.request = cast("socket.socket", came)
        server = {"room": room, "token": "a", "limits_s": (1.0, 1.0), "changing": threading.Lock()}
        conversation.server = cast("Any", SimpleNamespace(**server, untrusted=[came], trusted=[]))
        conversation.handle()
        for answer in map(json.loads, came.sent):
            assert not str(answer.get("reason")).startswith("the simulator failed"), answer

    return take


def _answered(data: bytes) -> None:
    client = ControlPortClient.__new__(ControlPortClient)
    client._socket, client._endpoint = cast("socket.socket", _Came(data)), "tcp://127.0.0.1:1"
    with contextlib.suppress(RonnaError):
        client.ask("step")


class _Link:
    """A unit that gives the same answer to every command, with the right CRC."""

    def __init__(self, said: bytes) -> None:
        self._said = said.replace(b"\r", b"")

    def ask(self, name: str, *_: object, reply_bytes: int = 256, **_more: object) -> str:
        text = self._said[:reply_bytes]
        opened = decode_ascii(text + b"%04X" % crc16(text))
        if error := unit_error(opened, name):
            raise error
        return opened

    def mark_unsettled(self) -> None:
        pass


def _each(data: bytes, *asks: Callable[[CommandLink], object]) -> None:
    link = cast("CommandLink", _Link(data))
    for ask in asks:
        with contextlib.suppress(RonnaError):
            ask(link)


def _handles(data: bytes) -> None:
    _each(
        data,
        lambda link: list_handles(link, HandleQuery.ALL),
        lambda link: request_handle(link, "********"),
    )


def _identity(data: bytes) -> None:
    _each(
        data,
        read_identity,
        lambda link: parse_whole_number(read_parameter(link, PARAMETER_FIRMWARE)),
        lambda link: parse_whole_number(read_parameter(link, "Param.Tracking")),
    )


def _acknowledged(data: bytes) -> None:
    client = EkiClient.__new__(EkiClient)
    client._arrived, client._listener, client.latest = threading.Condition(), None, None
    client._acks, client._states, client._scanner = {}, {}, TelegramScanner()
    client.where, client._sent = "here", {7: CommandName.DRIVES}
    for begin in range(0, len(data), RECEIVE_BYTES):
        for telegram in client._split(data[begin : begin + RECEIVE_BYTES]):
            client._handle(telegram)
