"""RSI link: the UDP socket of a run, and faults of telegrams and replies in transit."""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import time
from collections.abc import Callable
from ipaddress import IPv4Address

import numpy as np

from ronna_hw.endpoints import Endpoint
from sim.kuka.errors import CLIENT_ADDRESS_INVALID
from sim.kuka.rsi.telegrams import Reply
from sim.world.faults import Fault
from sim.world.noise import noise

DATAGRAM_BYTES = 65535
LOOPBACK = "127.0.0.1"
WAIT_S = 0.001  # longest wait of `wait_for_datagram`, host time
POLL_NS = 60_000  # busy-wait part of this, host time: longer than a client needs that has its reply prepared
_TIMEVAL = struct.Struct("ll")

PERCENT = 100.0
STAMP = re.compile(rb"(?<=<IPOC>)\d+(?=</IPOC>)")
STAMP_ELEMENT = re.compile(rb"<IPOC>[^<]*</IPOC>")
TYPE = re.compile(rb'(?<=<Sen Type=")[^"]*(?=")')
NUMBER = re.compile(rb'(?<==")[-+.\deE]+(?=")|(?<=>)[-+.\deE]+(?=</(?!IPOC))')
STRANGE_TYPE = b"Stranger"
NO_NUMBERS = (b"nan", b"inf", b"one")
WRONG_BY = 1  # ms: no cycle ever has this time stamp
FUTURE_BY = 12  # ms: the stamp of a later cycle, of 4 ms or of 12
NOT_TEXT = 0xFF  # a byte invalid in XML: it destroys a telegram or reply


def resolve(endpoint: Endpoint) -> tuple[str, int]:
    """Return the client's numeric address, with localhost as loopback; raises KRC-002 for other names."""
    host = LOOPBACK if endpoint.host == "localhost" else endpoint.host
    try:
        socket.inet_pton(socket.AF_INET, host)
    except OSError as error:
        raise CLIENT_ADDRESS_INVALID(f"{endpoint} is not an address", expected="four numbers") from error
    return host, endpoint.port


class RsiSocket:
    """UDP socket of one run, accepting datagrams only from the client's host.

    The kernel chooses the source port, which stays for the whole run.
    """

    def __init__(self, client: tuple[str, int]) -> None:
        self._client = client
        self._host = client[0]
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if IPv4Address(self._host).is_loopback:
            self.socket.bind((LOOPBACK, 0))  # a client on this host is not exposed to the network
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(0, round(WAIT_S * 1e6)))

    def send(self, telegram: bytes) -> None:
        """Send a telegram, which is lost if the network refuses it."""
        with contextlib.suppress(OSError):
            self.socket.sendto(telegram, socket.MSG_DONTWAIT, self._client)

    def receive(self) -> bytes | None:
        """Return a waiting datagram, None if there is none, or empty bytes if it came from another host."""
        try:
            data, source = self.socket.recvfrom(DATAGRAM_BYTES, socket.MSG_DONTWAIT)
        except OSError:
            return None
        return data if source[0] == self._host else b""

    def wait_for_datagram(self, *, awake: bool = False) -> bytes | None:
        """Wait up to `WAIT_S`, then return the next datagram as `receive` does.

        `awake`: poll at first. Two processes that alternate within tens of microseconds spend more on
        sleeping and waking each other than on everything else.
        """
        receive = self.socket.recvfrom
        end_ns = time.monotonic_ns() + POLL_NS if awake else 0
        while True:
            try:
                data, source = receive(DATAGRAM_BYTES, socket.MSG_DONTWAIT if end_ns else 0)
            except OSError:
                if not end_ns:
                    return None
                if time.monotonic_ns() > end_ns:
                    end_ns = 0
                continue
            return data if source[0] == self._host else b""

    def close(self) -> None:
        """Release the port."""
        self.socket.close()


class LinkFaults:
    """Effects of the fault script on one controller's telegrams and replies.

    Counted in cycles, so that in lock-step, too, a reply is dropped or late by the controller's own time.
    Random draws depend on the cycle number only: the same cycles are hit regardless of earlier hits.
    """

    def __init__(self, seed: int, hit: Callable[[str], None], *, takes_second: bool = False) -> None:
        """Call `hit` with the kind of each fault that takes effect.

        `takes_second`: of two replies to the same telegram the second counts.
        """
        self._takes_second = takes_second
        self._stamp: bytes | None = None  # stamp repeated in all replies while a fault holds it
        self._seed = seed
        self._hit = hit
        self.cycle = 0  # the present one
        self._active: dict[str, list[Fault]] = {}
        self._in_transit: list[tuple[int, bytes]] = []  # cycle of arrival, datagram

    @property
    def idle(self) -> bool:
        """Whether no fault is active and no reply is delayed."""
        return not self._active and not self._in_transit

    def set_active(self, acting: tuple[Fault, ...]) -> None:
        """Set the active faults."""
        self._active = {}
        for fault in acting:
            self._active.setdefault(fault.kind.name, []).append(fault)
        if not self.is_active("constant_ipoc"):
            self._stamp = None

    def begin_run(self) -> None:
        """Discard replies still delayed from the previous run."""
        self._in_transit.clear()

    def is_active(self, kind: str) -> bool:
        """Return whether a lasting fault of this kind is active."""
        return kind in self._active

    def outgoing(self, telegram: bytes) -> tuple[bytes | None, bool]:
        """Return the telegram to send (None if lost) and whether the client can answer it."""
        if self.is_active("network_cut") or self._strikes("lose_telegrams"):
            return None, False
        if self._strikes("corrupt_telegrams"):
            return self._corrupt_data(telegram, "corrupt_telegrams"), False
        return telegram, True

    def incoming(self, datagram: bytes | None, read: Callable[[bytes], Reply | None]) -> Reply | None:
        """Return the reply arriving in this cycle, given the client's datagram."""
        now = [data for arrival, data in self._in_transit if arrival <= self.cycle]
        self._in_transit = [item for item in self._in_transit if item[0] > self.cycle]
        if datagram is not None:
            now = self._list_arriving(datagram, now)
        if self.is_active("network_cut"):
            return None
        replies = [reply for reply in map(read, now) if reply is not None]
        if not replies:
            return None
        return replies[-1] if self._takes_second else replies[0]

    def _list_arriving(self, datagram: bytes, before: list[bytes]) -> list[bytes]:
        if self._strikes("drop"):
            return before
        if self._strikes("corrupt_replies"):
            datagram = self._corrupt_data(datagram, "corrupt_replies")
        datagram = self._alter(datagram)
        copies = [datagram, datagram] if self._strikes("duplicate_replies") else [datagram]
        delay_cycles = max(
            (int(fault.argument) for fault in self._active.get("delay_replies", ())), default=0
        )
        if delay_cycles:
            self._hit("delay_replies")
            self._in_transit += [(self.cycle + delay_cycles, copy) for copy in copies]
            return before
        if self._strikes("reorder_replies"):
            self._in_transit += [(self.cycle + 1, copy) for copy in copies]
            return before
        # a datagram comes after the ones that overtook it
        return [*copies, *before]

    def _alter(self, datagram: bytes) -> bytes:
        """Apply content faults to a reply, which may remain XML but is no longer a valid answer."""
        if self._strikes("wrong_ipoc"):
            datagram = _restamp(datagram, WRONG_BY)
        if self._strikes("future_ipoc"):
            datagram = _restamp(datagram, FUTURE_BY)
        if self.is_active("constant_ipoc"):
            found = STAMP.search(datagram)
            self._stamp = self._stamp or (found[0] if found else b"0")
            datagram = STAMP.sub(self._stamp, datagram)
            self._hit("constant_ipoc")
        if self._strikes("missing_ipoc"):
            datagram = STAMP_ELEMENT.sub(b"", datagram)
        if self._strikes("wrong_type"):
            datagram = TYPE.sub(STRANGE_TYPE, datagram)
        if self._strikes("bad_number"):
            chance = self._draw_chance("bad_number")
            chance.random()  # skip the draw that selected it
            datagram = NUMBER.sub(NO_NUMBERS[int(chance.integers(0, len(NO_NUMBERS)))], datagram, count=1)
        return datagram

    def _strikes(self, kind: str) -> bool:
        shares = [float(fault.argument) for fault in self._active.get(kind, ())]
        if not shares or self._draw_chance(kind).random() * PERCENT >= max(shares):
            return False
        self._hit(kind)
        return True

    def _corrupt_data(self, data: bytes, kind: str) -> bytes:
        """Truncate the data or make one byte invalid."""
        chance = self._draw_chance(kind)
        chance.random()  # skip the draw that selected it
        place = int(chance.integers(0, len(data)))
        if chance.random() < 0.5:
            return data[:place]
        return data[:place] + bytes([NOT_TEXT]) + data[place + 1 :]

    def _draw_chance(self, kind: str) -> np.random.Generator:
        return noise(self._seed, f"robot {kind}", self.cycle)


def _restamp(datagram: bytes, by_ms: int) -> bytes:
    return STAMP.sub(lambda stamp: b"%d" % (int(stamp[0]) + by_ms), datagram)
