"""Addresses of the cameras: UDP port 3956 is fixed by the standard, so each camera needs its own address."""

from __future__ import annotations

import contextlib
import errno
import socket
from collections.abc import Iterator, Sequence
from ipaddress import IPv4Address

from ronna_hw.wire.gige_vision import GVCP_PORT
from sim.errors import EndpointTaken

FIRST_ADDRESS = IPv4Address("127.77.0.1")
PAIRS_TRIED = 2000
BROADCAST_ADDRESSES = ("255.255.255.255", "127.255.255.255")


def bind_pair(addresses: Sequence[str]) -> tuple[socket.socket, socket.socket]:
    """Control sockets on two given addresses, or on a free pair if none are given; raises SIM-004."""
    if addresses:
        left, right = addresses
        return _bind(left, right)
    for left, right in _candidates():
        with contextlib.suppress(EndpointTaken):
            return _bind(left, right)
    raise EndpointTaken(
        f"no pair of addresses from {FIRST_ADDRESS} on has UDP port {GVCP_PORT} free",
        limit=f"{PAIRS_TRIED} pairs tried",
    )


def bind_broadcast() -> list[socket.socket]:
    """Sockets that receive broadcasts from clients; several programs may listen in parallel."""
    sockets = []
    for address in BROADCAST_ADDRESSES:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((address, GVCP_PORT))
        except OSError:  # a program that does not share: cameras can then be found by address only
            listener.close()
            continue
        sockets.append(listener)
    return sockets


def _candidates() -> Iterator[tuple[str, str]]:
    for pair in range(PAIRS_TRIED):
        yield str(FIRST_ADDRESS + 2 * pair), str(FIRST_ADDRESS + 2 * pair + 1)


def _bind(left: str, right: str) -> tuple[socket.socket, socket.socket]:
    first = _bind_one(left)
    try:
        return first, _bind_one(right)
    except EndpointTaken:
        first.close()
        raise


def _bind_one(address: str) -> socket.socket:
    control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        control.bind((address, GVCP_PORT))
    except OSError as error:
        control.close()
        reason = "is in use" if error.errno == errno.EADDRINUSE else f"cannot be bound: {error.strerror}"
        raise EndpointTaken(f"UDP port {GVCP_PORT} of {address} {reason}") from error
    return control
