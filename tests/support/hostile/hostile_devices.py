"""Stands between a driver and a true simulator, and from some byte on is a device that means harm.

One kind of malice per connection, begun at any byte. What the driver sends arrives unchanged, so that the
conversation gets as far as it can.
"""

from __future__ import annotations

import contextlib
import os
import random
import re
import select
import socket
import struct
import sys
import tempfile
import threading
import time
import traceback
import tty
from collections.abc import Callable
from enum import StrEnum
from itertools import count
from pathlib import Path

from conformance.disturbed_line import DisturbedLine
from conformance.kuka.tap import RsiTap
from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.gige_vision import GVCP_ACK_HEADER, GVCP_HEADER_BYTES, GVCP_PORT, Bootstrap, GvcpCommand
from ronna_hw.wire.polaris import BX_CRC_BYTES, BX_HEADER_BYTES, BX_START, crc16

RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # linger for 0 s
TAKES_S = 3.0  # a driver that takes nothing for so long is let alone
DRIP_S = 0.05
DRIPS_MOST = 400  # bytes in drips; then silence
FLOOD_BYTES = 8 << 20
BEGINS_BEFORE = (1, 500, 4000, 60_000)  # the byte of a conversation at which malice begins
DATAGRAM_BYTES = 65536
STREAM_BUFFER_BYTES = 4 << 20
LOOK_S = 0.02
PIECE_BYTES = 512  # of a terminal that has room for some
NUMBERS = (b"9" * 400, b"-1", b"4294967296", b"1e400", b"NaN", b"Infinity", b"\xd9\xa3", b"")
ENDLESS = (b"A", b"<", b"\0", b"\xff", b"<a>", b'<State Id="', b"=\n", b"0 ", b"\xc4\xa5\xff\xff")
DIGITS = re.compile(rb"\d+(?:\.\d+)?")
GOLDEN_SECTION = (5**0.5 - 1) / 2  # its multiples leave no part of a whole out
Mended = Callable[[bytes, bytes], bytes]


def with_right_crcs(true: bytes, lie: bytes) -> bytes:
    """A tracker's reply that lies, with the CRC of what it says: who means ill sends the right one."""
    start = struct.pack("<H", BX_START)
    if not true.startswith(start):
        *lines, rest = lie.split(b"\r")  # a regular expression costs the square of an endless line
        return b"".join(b"%b%04X\r" % (line[:-4], crc16(line[:-4])) for line in lines) + rest
    head, body = start + lie[2:4], lie[BX_HEADER_BYTES:-BX_CRC_BYTES]
    return b"".join(part + crc16(part).to_bytes(BX_CRC_BYTES, "little") for part in (head, body))


class Malice(StrEnum):
    """What a device may do to a byte stream."""

    RESET = "reset"
    SILENCE = "silence"
    DRIP = "drip"
    ENDLESS = "endless"
    LYING_LENGTHS = "lying lengths"
    LYING_NUMBERS = "lying numbers"
    ANOTHER_IDENTITY = "another identity"


class HostileLine(DisturbedLine):
    """A stream. `malice` is chosen anew with `choose`; the same for a seed."""

    def __init__(self, device: Endpoint, seed: int, mended: Mended = lambda _true, lie: lie) -> None:
        """`mended` makes of what the device sent, and the lie in its place, what a parser takes up."""
        super().__init__(device)
        self._chosen = random.Random(seed)
        self._mended = mended
        self._longest = 1  # bytes of a conversation without malice, as far as there was one
        self.resets: list[float] = []  # at which share of it
        self._idle = threading.Event()  # set while there is no connection
        self._idle.set()
        self._begins_at = sys.maxsize  # the first connection shows how long one is
        self._passed = 0
        self.malice = Malice.RESET

    def choose(self) -> str:
        """Another malice for the next connection, every other time a reset; tells which."""
        if self._begins_at == sys.maxsize:
            self._longest = max(self._longest, self._passed)
        if self._longest == 1:
            return "none"
        if self._chosen.random() < 0.5:
            self.resets.append(len(self.resets) * GOLDEN_SECTION % 1.0)
            self.malice, self._begins_at = Malice.RESET, int(self.resets[-1] * self._longest)
        else:
            self.malice = self._chosen.choice(list(Malice))
            self._begins_at = self._chosen.randrange(self._chosen.choice(BEGINS_BEFORE))
        self._passed = 0
        return f"{self.malice} from byte {self._begins_at}"

    def relent(self) -> None:
        """From now on, and from a new connection on, a line without malice."""
        self._begins_at = sys.maxsize
        self.silence(False)
        self.cut()
        assert self._idle.wait(2 * TAKES_S), "the connection that means harm is still there"

    def _pass_on(self, client: socket.socket, device: object) -> None:
        self._idle.clear()
        try:
            client.settimeout(TAKES_S)
            if self.malice is Malice.RESET:
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_ON_CLOSE)
            super()._pass_on(client, device)  # type: ignore[arg-type]  # the type of that end is private
        finally:
            self._idle.set()

    def _disturb(self, data: bytes) -> list[tuple[float, bytes]]:
        begin = max(self._begins_at - self._passed, 0)
        self._passed += len(data)
        if begin >= len(data):
            return [(0.0, data)]
        true, rest = data[:begin], data[begin:]
        match self.malice:
            case Malice.RESET:
                self.cut()
                return [(0.0, true)]
            case Malice.SILENCE:
                self.silence()
                return [(0.0, true)]
            case Malice.DRIP:
                return [(0.0, true), *((DRIP_S, rest[k : k + 1]) for k in range(len(rest)))][:DRIPS_MOST]
            case Malice.ENDLESS:
                what = self._chosen.choice(ENDLESS)
                return [(0.0, true + what * (FLOOD_BYTES // len(what)))]
            case Malice.LYING_LENGTHS:
                return [(0.0, self._mended(data, true + self._lie(rest, rb"\xc4\xa5..|\d{2,}")))]
            case Malice.LYING_NUMBERS:
                return [(0.0, self._mended(data, true + DIGITS.sub(self._number, rest)))]
            case Malice.ANOTHER_IDENTITY:
                return [(0.0, self._mended(data, true + self._lie(rest, rb"[A-Z0-9]{4,}")))]

    def _number(self, found: re.Match[bytes]) -> bytes:
        return self._chosen.choice(NUMBERS) if self._chosen.random() < 0.2 else found[0]

    def _lie(self, data: bytes, where: bytes) -> bytes:
        def another(found: re.Match[bytes]) -> bytes:
            if self._chosen.random() < 0.5:
                return found[0]
            return bytes(self._chosen.choice(b"0129AFZ\xff\0") for _ in found[0])

        return re.sub(where, another, data, flags=re.DOTALL)


class HostileSerialLine(HostileLine):
    """The same on a pseudo-terminal. After a reset there is another one, under the same name, as by udev."""

    def __init__(self, device: Endpoint, seed: int, mended: Mended) -> None:
        super().__init__(device, seed, mended)
        self._folder = tempfile.TemporaryDirectory()
        self._name = Path(self._folder.name) / "tracker"
        self._plugged = threading.Condition()
        self._terminals = 0  # so far

    @property
    def endpoint(self) -> str:
        with self._plugged:
            assert self._plugged.wait_for(lambda: self._terminals > 0, TAKES_S)
        return f"serial://{self._name}"

    def relent(self) -> None:
        with self._plugged:  # a terminal that is plugged in meanwhile would be cut, or keep its malice
            of_malice = self._terminals
            super().relent()
            replaced = self._plugged.wait_for(lambda: self._terminals > of_malice, 2 * TAKES_S)
        where = sys._current_frames().get(self._thread.ident or 0)
        assert replaced, f"the terminal of {self.malice} is still there: {traceback.format_stack(where)}"

    def _serve(self) -> None:
        with self._folder:
            while not self._ended:
                with contextlib.closing(_Terminal()) as terminal, contextlib.suppress(OSError):
                    with self._plugged:
                        self._cut = False
                        self._name.symlink_to(terminal.path)
                        self._terminals += 1
                        self._plugged.notify_all()
                    with contextlib.closing(self._open_device()) as device:
                        DisturbedLine._pass_on(self, terminal, device)  # type: ignore[arg-type]  # the type of that end is private
                self._name.unlink()


class _Terminal:
    """The device's end of a pseudo-terminal, as far as a line uses its socket."""

    def __init__(self) -> None:
        self._own, self._drivers = os.openpty()
        tty.setraw(self._drivers)
        os.set_blocking(self._own, False)  # a write may wait for ever although `select` found room
        self.path = os.ttyname(self._drivers)

    def fileno(self) -> int:
        return self._own

    def setsockopt(self, *_: object) -> None:
        """A terminal has no such options."""

    def sendall(self, data: bytes) -> None:
        given_up_s = time.monotonic() + TAKES_S
        while data:
            select.select([], [self._own], [], LOOK_S)
            with contextlib.suppress(BlockingIOError):  # also where `select` finds room
                data = data[os.write(self._own, data[:PIECE_BYTES]) :]
                given_up_s = time.monotonic() + TAKES_S
            if time.monotonic() > given_up_s:
                raise TimeoutError

    def close(self) -> None:
        os.close(self._own)
        os.close(self._drivers)


class HostileTelegrams(RsiTap):
    """Telegrams of the arm's controller, some of them changed, doubled, or among thousands of others."""

    def __init__(self, controller_sends_to: Endpoint, driver: Endpoint, seed: int) -> None:
        super().__init__(controller_sends_to, driver)
        self._chosen = random.Random(seed)
        self.share = 0.0  # of telegrams that are treated badly

    def _from_controller(self, telegram: bytes, sender: tuple[str, int]) -> None:
        super()._from_controller(telegram, sender)
        self.traffic_forgotten()
        if self._chosen.random() >= self.share:
            return
        for bad in self._bad(telegram):
            self._inside.sendto(bad, self._driver)

    def traffic_forgotten(self) -> None:
        """Nobody reads it here, and it would grow."""
        self._traffic.telegrams.clear()
        self._traffic.replies.clear()

    def _bad(self, telegram: bytes) -> list[bytes]:
        draw = self._chosen
        match draw.randrange(6):
            case 0:
                return [telegram] * draw.choice((1, 2, 200))
            case 1:
                return [draw.randbytes(draw.choice((0, 1, 100, 8192, 60_000)))]
            case 2:
                return [telegram[: draw.randrange(len(telegram))]]
            case 3:
                return [DIGITS.sub(lambda _: draw.choice(NUMBERS), telegram)]
            case 4:
                return [b"<Rob" + b"<a>" * 10_000 + telegram]
            case _:
                return [re.sub(rb"<IPOC>\d+", b"<IPOC>%d" % draw.choice((0, 7, 10**19 - 1, 2**32)), telegram)]


class HostileCamera:
    """A GigE Vision camera that passes on control and stream of a true one, and lies in some of both."""

    def __init__(self, camera: str, address: str, seed: int) -> None:
        """`camera` and `address` are IP addresses: where the true one is, and where the driver finds us."""
        self._chosen = random.Random(seed)
        self.share = 0.0  # of acknowledgements and packets that are treated badly
        self._front = _bound(address, GVCP_PORT)
        self._back = _bound("127.0.0.1", 0)
        self._back.connect((camera, GVCP_PORT))
        self._address = address
        self._stream = _bound(address, 0)  # images from elsewhere than the camera are none
        self._stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, STREAM_BUFFER_BYTES)
        self._driver: tuple[str, int] | None = None
        self._wants_stream = ["127.0.0.1", 0]
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        for each in (self._front, self._back, self._stream):
            each.close()

    def _serve(self) -> None:
        ends = {self._front: self._command, self._back: self._acknowledge, self._stream: self._packet}
        while not self._ending.is_set():
            for ready in select.select(list(ends), [], [], LOOK_S)[0]:
                try:
                    data, sender = ready.recvfrom(DATAGRAM_BYTES)
                    ends[ready](data, sender)
                except OSError:  # the driver, or the camera, is not there at this moment
                    continue

    def _command(self, data: bytes, sender: tuple[str, int]) -> None:
        self._driver = sender
        if data[2:4] == GvcpCommand.WRITEREG.to_bytes(2, "big") and len(data) == GVCP_HEADER_BYTES + 8:
            address, value = struct.unpack(">II", data[GVCP_HEADER_BYTES:])
            if address == Bootstrap.SCDA:
                self._wants_stream[0] = socket.inet_ntoa(value.to_bytes(4, "big"))
                value = int.from_bytes(socket.inet_aton(self._address), "big")
            elif address == Bootstrap.SCP and value:
                self._wants_stream[1] = value & 0xFFFF
                value = self._stream.getsockname()[1]
            data = data[:GVCP_HEADER_BYTES] + struct.pack(">II", address, value)
        self._back.send(data)

    def _acknowledge(self, data: bytes, _sender: object) -> None:
        if self._driver is None:
            return
        for each in self._treated(data, self._lying_head):
            self._front.sendto(each, self._driver)

    def _packet(self, data: bytes, _sender: object) -> None:
        host, port = self._wants_stream
        for each in self._treated(data, self._lying_packet):
            self._stream.sendto(each, (host, port))

    def _treated(self, data: bytes, lie: Callable[[bytes], bytes]) -> list[bytes]:
        draw = self._chosen
        if draw.random() >= self.share:
            return [data]
        match draw.randrange(6):
            case 0:
                return []
            case 1:
                return [data] * draw.choice((2, 50))
            case 2:
                return [data[: draw.randrange(len(data) + 1)]]
            case 3:
                return [draw.randbytes(draw.choice((0, 1, 8, 540, 9000)))]
            case 4:
                place = draw.randrange(len(data)) if data else 0
                return [data[:place] + bytes((draw.randrange(256),)) + data[place + 1 :]]
            case _:
                return [lie(data)]

    def _lying_head(self, data: bytes) -> bytes:
        """Another status, code or length over the same request, as a PENDING for ever, or other content."""
        status, code, length, request = struct.unpack_from(GVCP_ACK_HEADER, data)
        draw = self._chosen
        head = (
            draw.choice((status, 0x8007, 0x8FFF)),
            draw.choice((code, GvcpCommand.PENDING_ACK, 0xFFFF)),
            draw.choice((length, 0, 0xFFFF)),
            request,
        )
        body = draw.choice((data[GVCP_HEADER_BYTES:], b"\xff" * length, b"\0" * length, b"\0\0\xff\xff"))
        return struct.pack(GVCP_ACK_HEADER, *head) + body

    def _lying_packet(self, data: bytes) -> bytes:
        """Other numbers in the head of a packet: block, packet, format; then sizes of the leader."""
        draw = self._chosen
        head = bytearray(data[:44])
        for _ in range(draw.randint(1, 4)):
            place = draw.randrange(max(len(head) - 4, 1))
            head[place : place + 4] = draw.choice((b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff"))
        return bytes(head) + data[44:]


def _bound(host: str, port: int) -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.bind((host, port))
    return end


_pairs = count(1)


def free_camera_addresses() -> tuple[str, str]:
    """Two addresses on which no camera of ours is simulated."""
    number = next(_pairs)
    return f"127.99.{number}.1", f"127.99.{number}.2"
