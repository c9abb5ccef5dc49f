"""Who is there at all: asks everybody on this computer's networks, as a client does that knows no address."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from collections.abc import Sequence
from contextlib import ExitStack
from ipaddress import IPv4Address

from drivers.basler_stereo.control import gvcp
from drivers.basler_stereo.control.identity import CameraIdentity, decode_identity
from drivers.basler_stereo.errors import MalformedReply
from ronna_hw.host.network_interfaces import Interface, interfaces
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand

FOUND_S = 0.5  # for the answers; a camera answers within milliseconds
EVERYBODY = "255.255.255.255"
DATAGRAM_LIMIT_BYTES = 2048
REQUEST_ID = gev.REQUEST_ID_FIRST


def discover_cameras(near: str, limit_s: float = FOUND_S) -> tuple[CameraIdentity, ...]:
    """Every GigE Vision device that answers, by address; needs no control, and no address of its own subnet.

    `near` says where to ask: an address inside this computer asks only there, any other only outside.
    """
    inside = IPv4Address(near).is_loopback
    found: dict[tuple[str, str], CameraIdentity] = {}
    with ExitStack() as opened:
        callers = [
            opened.enter_context(caller)
            for network in interfaces()
            if network.loopback == inside and (caller := _calling(network)) is not None
        ]
        deadline_s = time.monotonic() + limit_s
        while ready := _ready(callers, deadline_s):
            for caller in ready:
                with contextlib.suppress(MalformedReply):
                    identity = _answered(*caller.recvfrom(DATAGRAM_LIMIT_BYTES))
                    found[identity.address, identity.serial] = identity
    return tuple(sorted(found.values(), key=lambda identity: IPv4Address(identity.address)))


def listed(cameras: Sequence[CameraIdentity]) -> str:
    """The cameras that replied, for a message."""
    if not cameras:
        return "no camera replied to broadcast discovery"
    return "broadcast discovery found " + ", ".join(f"{each.serial} at {each.address}" for each in cameras)


def _calling(network: Interface) -> socket.socket | None:
    """A socket that has asked everybody on one network; None where that is not possible."""
    caller = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        caller.bind((network.address, 0))  # this chooses the network card as well
        caller.sendto(gvcp.encode(GvcpCommand.DISCOVERY, REQUEST_ID), (EVERYBODY, gev.GVCP_PORT))
    except OSError:
        caller.close()
        return None
    return caller


def _ready(callers: list[socket.socket], deadline_s: float) -> list[socket.socket]:
    return select.select(callers, [], [], max(0.0, deadline_s - time.monotonic()))[0]


def _answered(datagram: bytes, sender: tuple[str, int]) -> CameraIdentity:
    """Raises GEV-008 for anything but an answer to a discovery."""
    answer = gvcp.decode(datagram)
    if answer is None or answer.command != GvcpCommand.DISCOVERY_ACK or answer.status != GevStatus.SUCCESS:
        raise MalformedReply(f"{sender[0]}: no answer to a discovery", wire=datagram[:16])
    # a camera of another subnet answers to everybody as well: it tells its own address
    place = answer.payload[Bootstrap.CURRENT_ADDRESS : Bootstrap.CURRENT_ADDRESS + gev.REGISTER_BYTES]
    own = socket.inet_ntoa(place) if any(place) and len(place) == gev.REGISTER_BYTES else sender[0]
    return decode_identity(answer.payload, own)
