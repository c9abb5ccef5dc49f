"""Cameras are identified by their replies to discovery, by address or by broadcast."""

from __future__ import annotations

import itertools
import select
import socket
import struct
import time
from typing import Any

import pytest

from drivers.basler_stereo.errors import MalformedReply
from drivers.basler_stereo.identity import decode_identity, discover_cameras
from ronna_hw.host.network import Interface


def memory(serial="21900001", model="acA2000-50gmNIR"):
    data = bytearray(248)
    data[0x08:0x10] = struct.pack(">HHI", 0, 0x0030, 0x53112233)
    for place, text in ((0x48, "Basler"), (0x68, model), (0x88, "106755-17"), (0xD8, serial), (0xE8, "left")):
        data[place : place + len(text)] = text.encode()
    return bytes(data)


def test_the_reply_identifies_the_camera():
    found = decode_identity(memory(), "10.0.0.1")
    assert (found.vendor, found.model, found.serial) == ("Basler", "acA2000-50gmNIR", "21900001")
    assert (found.version, found.user_name, found.mac) == ("106755-17", "left", "00:30:53:11:22:33")


def test_a_reply_of_another_length_is_malformed():
    with pytest.raises(MalformedReply, match="GEV-008"):
        decode_identity(memory()[:-1], "10.0.0.1")


def test_text_that_is_not_utf8_is_still_read():
    data = bytearray(memory())
    data[0x48:0x68] = b"\xff" * 32
    assert decode_identity(bytes(data), "x").vendor


LIMIT_S = 0.5
A_DATAGRAM_S = 0.1  # what each takes by this test's clock
MOST_READ = 10


class FloodedSocket(socket.socket):
    """Socket with always another datagram to read that is no camera's reply."""

    read = 0

    def sendto(self, *_: Any) -> int:
        return 0

    def recvfrom(self, *_: Any) -> tuple[bytes, tuple[str, int]]:
        FloodedSocket.read += 1
        assert FloodedSocket.read <= MOST_READ, "discovery goes on after its time"
        return b"flood", ("127.0.0.1", 9)


def test_a_flood_of_datagrams_does_not_prolong_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(0.0, A_DATAGRAM_S)
    monkeypatch.setattr(socket, "socket", FloodedSocket)
    monkeypatch.setattr(select, "select", lambda readers, *_: (readers, [], []))
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    assert discover_cameras(Interface("lo", "127.0.0.1", 8, 0), LIMIT_S) == ()
    assert FloodedSocket.read < LIMIT_S / A_DATAGRAM_S
