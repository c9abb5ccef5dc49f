"""The UDP socket of one run: the kernel chooses its source port, which stays for the whole run."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from ipaddress import IPv4Address

from ronna_hw.endpoints import Endpoint
from sim.kuka.errors import ClientAddressInvalid

DATAGRAM_BYTES = 65535
LOOPBACK = "127.0.0.1"
WAIT_S = 0.001  # longest wait of `await_datagram`, host time
POLL_NS = 60_000  # busy-wait part of this, host time: longer than a client needs that has its reply prepared
_TIMEVAL = struct.Struct("ll")


def resolve(endpoint: Endpoint) -> tuple[str, int]:
    """Numeric address of the client; raises KRC-002. An Ethernet file contains numbers, never names."""
    host = LOOPBACK if endpoint.host == "localhost" else endpoint.host
    try:
        socket.inet_pton(socket.AF_INET, host)
    except OSError as error:
        raise ClientAddressInvalid(f"{endpoint} is not an address", expected="four numbers") from error
    return host, endpoint.port


class RsiSocket:
    """Sends to the client and accepts datagrams from its host only."""

    def __init__(self, client: tuple[str, int]) -> None:
        self._client = client
        self._host = client[0]
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if IPv4Address(self._host).is_loopback:
            self.socket.bind((LOOPBACK, 0))  # a client on this host is not exposed to the network
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _TIMEVAL.pack(0, round(WAIT_S * 1e6)))

    def send(self, telegram: bytes) -> None:
        """Send one telegram; if the network refuses it, it is lost as on any wire."""
        with contextlib.suppress(OSError):
            self.socket.sendto(telegram, socket.MSG_DONTWAIT, self._client)

    def receive(self) -> bytes | None:
        """One waiting datagram from the client's host; None if there is none; empty if foreign."""
        try:
            data, source = self.socket.recvfrom(DATAGRAM_BYTES, socket.MSG_DONTWAIT)
        except OSError:
            return None
        return data if source[0] == self._host else b""

    def await_datagram(self, *, awake: bool = False) -> bytes | None:
        """The same, but wait briefly: the cheapest wait for a single socket.

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
