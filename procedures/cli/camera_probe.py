"""Ask whatever is at a camera's address who it is, below every driver: who controls it, which packets pass.

Reading changes nothing. To find out which packet size passes, a camera that nobody controls is controlled for
a moment, sends test packets, and is given back; one that somebody controls is left alone.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from ipaddress import IPv4Address

from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network_interfaces import Interface, interface_of, interfaces
from ronna_hw.host.port_users import PortUser, user_of_udp_port
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GevStatus, GvcpCapability, GvcpCommand

ANSWER_S = 0.5  # per question; a camera answers within milliseconds
TRIES = 2
FOUND_S = 0.5  # for the answers to a question to everybody
TEST_PACKET_S = 0.2
PACKET_BYTES = (8192, 4000, 1500, 576)  # as the driver tries them, largest first
DATAGRAM_BYTES = 65_536
LOOPBACK_EVERYBODY = "127.255.255.255"


class Access(StrEnum):
    """Whether anything answers at an address."""

    ANSWERED = "answered"
    NO_WAY = "no way"  # this computer has no route to it
    REFUSED = "refused"  # a computer is there, and nothing on the port of cameras
    SILENT = "silent"


@dataclass(frozen=True)
class About:
    """What a device says about itself."""

    address: str
    vendor: str
    model: str
    serial: str
    name: str
    firmware: str


@dataclass(frozen=True)
class Control:
    """Who is in control: nobody, or a program at an address when the camera tells it."""

    taken: bool
    address: str = ""
    port: int = 0
    holder: PortUser | None = None  # the program, when it runs on this computer and may be seen
    here: bool = False  # that address is this computer's


@dataclass(frozen=True)
class CameraProbe:
    """What was found; fields stay None where it was not got so far."""

    endpoint: Endpoint
    access: Access
    interface: Interface | None = None
    about: About | None = None
    control: Control | None = None
    packet_bytes: int | None = None  # the largest that passes; 0 when no test packet came at all
    reason: str = ""  # of the system, where there is no way


def probe_camera(endpoint: Endpoint) -> CameraProbe:
    """Look at one camera's address. Takes a second or two, and never raises for what is at its far end."""
    try:
        link = _Link(endpoint.host)
    except OSError as error:
        return CameraProbe(endpoint, Access.NO_WAY, reason=str(error.strerror or error))
    with link:
        way = interface_of(link.local_address)
        memory = link.ask(GvcpCommand.DISCOVERY)
        if memory is None or len(memory) < gev.DISCOVERY_BYTES:
            access = Access.REFUSED if link.refused else Access.SILENT
            return CameraProbe(endpoint, access, way)
        control = _control(link)
        passes = None if control.taken else _largest_packet(link)
        return CameraProbe(endpoint, Access.ANSWERED, way, _about(memory), control, passes)


def found_on(interface: Interface) -> tuple[About, ...]:
    """Every camera that answers a question to everybody on one of this computer's networks."""
    everybody = LOOPBACK_EVERYBODY if interface.loopback else "255.255.255.255"
    question = struct.pack(gev.GVCP_COMMAND_HEADER, gev.GVCP_KEY, 1, GvcpCommand.DISCOVERY, 0, 1)
    found: dict[tuple[str, str], About] = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as caller, contextlib.suppress(OSError):
        caller.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        caller.bind((interface.address, 0))
        caller.sendto(question, (everybody, gev.GVCP_PORT))
        for datagram, sender in _arriving(caller, FOUND_S):
            memory = datagram[gev.GVCP_HEADER_BYTES :]
            if len(memory) == gev.DISCOVERY_BYTES:
                about = _about(memory)
                # a camera of another subnet answers to everybody as well; it tells its own address
                found[sender, about.serial] = about
    return tuple(sorted(found.values(), key=lambda about: socket.inet_aton(about.address)))


def found_around(endpoints: Sequence[Endpoint]) -> Iterator[tuple[Interface, tuple[About, ...]]]:
    """The same for each network where there are any; outside this computer only for cameras outside."""
    outside = any(not _is_loopback(endpoint.host) for endpoint in endpoints)
    for interface in interfaces():
        if (interface.loopback or outside) and (cameras := found_on(interface)):
            yield interface, cameras


class _Link:
    """One socket to one camera."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((address, gev.GVCP_PORT))
        except OSError:
            self._socket.close()
            raise
        self._request_id = 0
        self.refused = False

    def __enter__(self) -> _Link:
        return self

    def __exit__(self, *reason: object) -> None:
        self._socket.close()

    @property
    def local_address(self) -> str:
        return str(self._socket.getsockname()[0])

    def ask(self, command: GvcpCommand, payload: bytes = b"") -> bytes | None:
        """The payload of a successful answer, or None."""
        self._request_id += 1
        head = (gev.GVCP_KEY, 1, command, len(payload), self._request_id)
        for _ in range(TRIES):
            with contextlib.suppress(OSError):
                self._socket.send(struct.pack(gev.GVCP_COMMAND_HEADER, *head) + payload)
            try:
                for datagram, _ in _arriving(self._socket, ANSWER_S):
                    status, _, _, request_id = struct.unpack_from(gev.GVCP_ACK_HEADER, datagram)
                    if request_id == self._request_id:
                        return datagram[gev.GVCP_HEADER_BYTES :] if status == GevStatus.SUCCESS else None
            except ConnectionRefusedError:
                self.refused = True
                time.sleep(ANSWER_S / 10)  # it is said at once: without a pause all tries are one
        return None

    def read(self, address: int) -> int | None:
        """A register, or None when the camera refuses or says nothing."""
        payload = self.ask(GvcpCommand.READREG, struct.pack(gev.READREG_ITEM, address))
        return None if payload is None or len(payload) < 4 else int.from_bytes(payload[:4], "big")

    def write(self, address: int, value: int) -> bool:
        """True when the camera took it."""
        return self.ask(GvcpCommand.WRITEREG, struct.pack(gev.WRITEREG_ITEM, address, value)) is not None


def _arriving(receiver: socket.socket, limit_s: float) -> Iterator[tuple[bytes, str]]:
    """Datagrams with at least a header, and their senders, until the time is up."""
    deadline_s = time.monotonic() + limit_s
    while True:
        # also after the time: what came while this computer stalled is an answer in time
        receiver.settimeout(max(1e-3, deadline_s - time.monotonic()))
        try:
            datagram, sender = receiver.recvfrom(DATAGRAM_BYTES)
        except TimeoutError:
            return
        if len(datagram) >= gev.GVCP_HEADER_BYTES:
            yield datagram, str(sender[0])


def _control(link: _Link) -> Control:
    privilege = link.read(Bootstrap.CCP)
    if privilege == gev.CCP_OPEN:
        return Control(taken=False)
    told = (link.read(Bootstrap.GVCP_CAPABILITY) or 0) & GvcpCapability.CCP_APPLICATION
    port = link.read(Bootstrap.PRIMARY_APPLICATION_PORT) if told else None
    address = link.read(Bootstrap.PRIMARY_APPLICATION_ADDRESS) if told else None
    if not port or not address:
        return Control(taken=True)  # under exclusive access not even reading is allowed
    owner = socket.inet_ntoa(address.to_bytes(4, "big"))
    here = _is_loopback(owner) or owner in {each.address for each in interfaces()}
    return Control(True, owner, port, user_of_udp_port(owner, port) if here else None, here)


def _largest_packet(link: _Link) -> int | None:
    """The largest test packet that comes; None when the camera does not give control."""
    if not link.write(Bootstrap.CCP, gev.CCP_CONTROL):
        return None
    before = link.read(Bootstrap.SCPS)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stream:
            stream.bind((link.local_address, 0))
            link.write(Bootstrap.SCDA, int.from_bytes(socket.inet_aton(link.local_address), "big"))
            link.write(Bootstrap.SCP, stream.getsockname()[1])
            return next((size for size in PACKET_BYTES if _passes(link, stream, size)), 0)
    finally:
        link.write(Bootstrap.SCP, 0)
        if before is not None:
            link.write(Bootstrap.SCPS, before & ~gev.SCPS_FIRE_TEST)
        link.write(Bootstrap.CCP, gev.CCP_OPEN)


def _passes(link: _Link, stream: socket.socket, size: int) -> bool:
    for _ in range(TRIES):
        link.write(Bootstrap.SCPS, size | gev.SCPS_FIRE_TEST | gev.SCPS_DO_NOT_FRAGMENT)
        wanted = size - gev.IP_UDP_HEADER_BYTES
        if any(len(datagram) == wanted for datagram, _ in _arriving(stream, TEST_PACKET_S)):
            return True
    return False


def _is_loopback(host: str) -> bool:
    try:
        return IPv4Address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _about(memory: bytes) -> About:
    def text(register: Bootstrap) -> str:
        field = memory[register : register + gev.TEXT_BYTES[register]]
        return field.split(b"\0", 1)[0].decode("utf-8", "replace").strip()

    return About(
        address=socket.inet_ntoa(memory[Bootstrap.CURRENT_ADDRESS : Bootstrap.CURRENT_ADDRESS + 4]),
        vendor=text(Bootstrap.MANUFACTURER_NAME),
        model=text(Bootstrap.MODEL_NAME),
        serial=text(Bootstrap.SERIAL_NUMBER),
        name=text(Bootstrap.USER_DEFINED_NAME),
        firmware=text(Bootstrap.DEVICE_VERSION),
    )
