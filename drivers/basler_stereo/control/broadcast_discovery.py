"""Broadcast discovery: the GigE Vision devices on a network, for a client without their addresses."""

from __future__ import annotations

import contextlib
import select
import socket
import time
from ipaddress import IPv4Address

from drivers.basler_stereo.control import gvcp
from drivers.basler_stereo.control.identity import CameraIdentity, decode_identity
from drivers.basler_stereo.errors import MalformedReply
from ronna_hw.host.network import Interface, interface_of
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand

REPLY_LIMIT_S = 0.5  # a camera replies within milliseconds
EVERYBODY = "255.255.255.255"
DATAGRAM_LIMIT_BYTES = 2048
REQUEST_ID = gev.REQUEST_ID_FIRST


def discover_cameras(interface: Interface, limit_s: float = REPLY_LIMIT_S) -> tuple[CameraIdentity, ...]:
    """Every GigE Vision device that replies on one network interface, by address; needs no control.

    A device also replies if its address belongs to another subnet.
    """
    found: dict[tuple[str, str], CameraIdentity] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as caller, contextlib.suppress(OSError):
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        caller.bind((interface.address, 0))  # also selects the interface
        caller.sendto(gvcp.encode(GvcpCommand.DISCOVERY, REQUEST_ID), (EVERYBODY, gev.GVCP_PORT))
        deadline_s = time.monotonic() + limit_s
        while (left_s := deadline_s - time.monotonic()) > 0.0 and select.select([caller], [], [], left_s)[0]:
            with contextlib.suppress(MalformedReply):
                identity = _replied(*caller.recvfrom(DATAGRAM_LIMIT_BYTES))
                found[identity.address, identity.serial] = identity
    return tuple(sorted(found.values(), key=lambda identity: IPv4Address(identity.address)))


def cameras_near(address: str) -> str:
    """For messages: the cameras on the network of an address. No other network is queried."""
    if (interface := interface_of(address)) is None:
        return f"no network interface of this computer is in the subnet of {address}"
    if not (cameras := discover_cameras(interface)):
        return "no camera replied to broadcast discovery"
    return "broadcast discovery found " + ", ".join(f"{each.serial} at {each.address}" for each in cameras)


def _replied(datagram: bytes, sender: tuple[str, int]) -> CameraIdentity:
    """Raises GEV-008 for anything but a reply to discovery."""
    acknowledge = gvcp.decode(datagram)
    if (
        acknowledge is None
        or acknowledge.command != GvcpCommand.DISCOVERY_ACK
        or acknowledge.status != GevStatus.SUCCESS
    ):
        raise MalformedReply(f"{sender[0]}: not a reply to discovery", wire=datagram[:16])
    # a camera of another subnet also replies: its own address is in the reply
    place = acknowledge.payload[Bootstrap.CURRENT_ADDRESS : Bootstrap.CURRENT_ADDRESS + gev.REGISTER_BYTES]
    own = socket.inet_ntoa(place) if any(place) and len(place) == gev.REGISTER_BYTES else sender[0]
    return decode_identity(acknowledge.payload, own)
