"""Camera identification through GVCP discovery, by address or by broadcast."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from ipaddress import IPv4Address

from drivers.basler_stereo import gvcp
from drivers.basler_stereo.control_channel import CameraControl
from drivers.basler_stereo.errors import MalformedReply, NoCamera, NoReply
from ronna_hw.host.network import Interface, find_interface
from ronna_hw.text import printable
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCommand

REPLY_LIMIT_S = 0.5  # a camera replies within milliseconds
BROADCAST_ADDRESS = "255.255.255.255"
DATAGRAM_LIMIT_BYTES = 2048
REQUEST_ID = gev.REQUEST_ID_FIRST
LISTED_CAMERAS = 4
NO_INFO = "none"  # in the register of a Basler camera


@dataclass(frozen=True)
class CameraIdentity:
    """Camera identity from the bootstrap registers."""

    address: str
    mac: str
    vendor: str
    model: str
    serial: str
    version: str
    user_name: str
    info: str = ""  # of the manufacturer; empty as it comes from the factory

    def __str__(self) -> str:
        """Return model, serial number, address and further information, for a person who looks for it."""
        whose = f" ({printable(self.info)})" if self.info else ""
        return f"{self.model} {self.serial} at {self.address}{whose}"


def identify(control: CameraControl, deadline_s: float) -> CameraIdentity:
    """Identify the device at the channel's address; raises GEV-001, GEV-008."""
    try:
        memory = control.ask(GvcpCommand.DISCOVERY, b"", deadline_s, "discovery")
    except NoReply as error:
        raise NoCamera(f"no camera replied at {control.address}", expected="a reply to discovery") from error
    return decode_identity(memory, control.address)


def decode_identity(memory: bytes, address: str) -> CameraIdentity:
    """Decode the identity from a discovery reply; raises GEV-008."""
    if len(memory) != gev.DISCOVERY_BYTES:
        raise MalformedReply(
            f"{address}: the reply to discovery has the wrong length",
            expected=f"{gev.DISCOVERY_BYTES} bytes",
            got=f"{len(memory)} bytes",
            wire=memory[:16],
        )
    (high,) = struct.unpack_from(">H", memory, Bootstrap.MAC_HIGH + 2)
    (low,) = struct.unpack_from(">I", memory, Bootstrap.MAC_LOW)
    return CameraIdentity(
        address=address,
        mac=(high << 32 | low).to_bytes(6, "big").hex(":"),
        vendor=_read_text(memory, Bootstrap.MANUFACTURER_NAME),
        model=_read_text(memory, Bootstrap.MODEL_NAME),
        serial=_read_text(memory, Bootstrap.SERIAL_NUMBER),
        version=_read_text(memory, Bootstrap.DEVICE_VERSION),
        user_name=_read_text(memory, Bootstrap.USER_DEFINED_NAME),
        info=_read_text(memory, Bootstrap.MANUFACTURER_INFO).removeprefix(NO_INFO),
    )


def _read_text(memory: bytes, register: Bootstrap) -> str:
    field = memory[register : register + gev.TEXT_BYTES[register]]
    return field.split(b"\0", 1)[0].decode("utf-8", errors="replace").strip()


def discover_cameras(interface: Interface, limit_s: float = REPLY_LIMIT_S) -> tuple[CameraIdentity, ...]:
    """Find all GigE Vision devices that reply on one network interface, without taking control.

    A device also replies if its address belongs to another subnet.
    """
    found: dict[tuple[str, str], CameraIdentity] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as broadcast_socket, contextlib.suppress(OSError):
        broadcast_socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        broadcast_socket.bind((interface.address, 0))  # also selects the interface
        broadcast_socket.sendto(
            gvcp.encode(GvcpCommand.DISCOVERY, REQUEST_ID), (BROADCAST_ADDRESS, gev.GVCP_PORT)
        )
        deadline_s = time.monotonic() + limit_s
        while (remaining_s := deadline_s - time.monotonic()) > 0.0 and select.select(
            [broadcast_socket], [], [], remaining_s
        )[0]:
            with contextlib.suppress(MalformedReply):
                identity = _decode_reply(*broadcast_socket.recvfrom(DATAGRAM_LIMIT_BYTES))
                found[identity.address, identity.serial] = identity
    return tuple(sorted(found.values(), key=lambda identity: IPv4Address(identity.address)))


def describe_cameras_near(address: str, wanted: Collection[str | None] = ()) -> str:
    """Describe the cameras that reply on the same network as an address, those with wanted serials first."""
    if (interface := find_interface(address)) is None:
        return f"no network interface of this computer is in the subnet of {address}"
    if not (cameras := discover_cameras(interface)):
        return "no camera replied to broadcast discovery"
    wanted_first = sorted(cameras, key=lambda each: each.serial not in wanted)
    return f"broadcast discovery found {list_cameras(wanted_first)}"


def list_cameras(cameras: Sequence[CameraIdentity]) -> str:
    """List cameras for a sentence, at most `LISTED_CAMERAS` of them by name."""
    more = f" and {len(cameras) - LISTED_CAMERAS} more" if len(cameras) > LISTED_CAMERAS else ""
    return f"{', '.join(map(str, cameras[:LISTED_CAMERAS]))}{more}"


def _decode_reply(datagram: bytes, sender: tuple[str, int]) -> CameraIdentity:
    """Decode a broadcast discovery reply; raises GEV-008 for any other datagram."""
    acknowledge = gvcp.decode(datagram)
    if (
        acknowledge is None
        or acknowledge.command != GvcpCommand.DISCOVERY_ACK
        or acknowledge.status != GevStatus.SUCCESS
    ):
        raise MalformedReply(f"{sender[0]}: not a reply to discovery", wire=datagram[:16])
    # a camera of another subnet also replies: its own address is in the reply
    own = acknowledge.payload[Bootstrap.CURRENT_ADDRESS :][: gev.REGISTER_BYTES]
    is_stated = any(own) and len(own) == gev.REGISTER_BYTES
    return decode_identity(acknowledge.payload, socket.inet_ntoa(own) if is_stated else sender[0])
