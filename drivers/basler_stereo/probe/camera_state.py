"""State of a camera's address: who replies, who controls it, which packet size arrives.

Reading changes nothing. To find the packet size, an uncontrolled camera is briefly controlled, sends test
packets, and is released; a controlled one is left alone.
"""

from __future__ import annotations

import contextlib
import socket
import time
from dataclasses import dataclass
from enum import StrEnum

from drivers.basler_stereo.control.channel import ControlChannel
from drivers.basler_stereo.control.identity import CameraIdentity, identify
from drivers.basler_stereo.errors import CommandRefused, MalformedReply, NoCamera, NoReply
from drivers.basler_stereo.stream.packet_size import choose_packet_bytes
from drivers.basler_stereo.stream.stream_socket import open_stream_socket
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network import Interface, interface_of, interfaces
from ronna_hw.host.port_users import PortUser, user_of_udp_port
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GvcpCapability

REPLY_LIMIT_S = 1.0  # per command, including retries
TEST_LIMIT_S = 5.0  # for all test packets
RECEIVE_BUFFER_BYTES = 65_536  # one test packet at a time


class Response(StrEnum):
    """Whether anything replies at an address."""

    ANSWERED = "answered"
    NO_ROUTE = "no way"
    REFUSED = "refused"  # a computer is there, but nothing listens on the cameras' port
    SILENT = "silent"


@dataclass(frozen=True)
class Controller:
    """The application in control: none, or one with an address if the camera reports it."""

    taken: bool
    address: str = ""
    port: int = 0
    process: PortUser | None = None  # if it runs on this computer and is visible to us
    here: bool = False  # the address is this computer's


@dataclass(frozen=True)
class CameraState:
    """What was found; fields are None for stages not reached."""

    endpoint: Endpoint
    response: Response
    interface: Interface | None = None
    identity: CameraIdentity | None = None
    controller: Controller | None = None
    packet_bytes: int | None = None  # the largest that arrives; 0 if no test packet arrived at all
    reason: str = ""  # the system's, if there is no route


def look_at_camera(endpoint: Endpoint) -> CameraState:
    """Check one camera's address, in a second or two. Never raises, whatever is at the other end."""
    try:
        with contextlib.closing(ControlChannel(endpoint.host)) as control:
            return _look_through(control, endpoint)
    except OSError as error:  # also when the network goes down meanwhile
        return CameraState(endpoint, Response.NO_ROUTE, reason=error.strerror or str(error))


def _look_through(control: ControlChannel, endpoint: Endpoint) -> CameraState:
    interface = interface_of(control.local_address)
    try:
        identity = identify(control, _soon())
    except (NoCamera, MalformedReply, CommandRefused):
        response = Response.REFUSED if control.port_closed else Response.SILENT
        return CameraState(endpoint, response, interface)
    controller = _controller(control)
    size = None if controller.taken else _largest_packet(control)
    return CameraState(endpoint, Response.ANSWERED, interface, identity, controller, size)


def _controller(control: ControlChannel) -> Controller:
    if _read(control, Bootstrap.CCP) == gev.CCP_OPEN:
        return Controller(taken=False)
    names_it = (_read(control, Bootstrap.GVCP_CAPABILITY) or 0) & GvcpCapability.CCP_APPLICATION
    port = _read(control, Bootstrap.PRIMARY_APPLICATION_PORT) if names_it else None
    address = _read(control, Bootstrap.PRIMARY_APPLICATION_ADDRESS) if names_it else None
    if not port or not address:
        return Controller(taken=True)  # under exclusive access even reading is refused
    owner = socket.inet_ntoa(address.to_bytes(4, "big"))
    own = [each for each in interfaces() if each.address == owner or (each.loopback and each.reaches(owner))]
    return Controller(True, owner, port, user_of_udp_port(owner, port) if own else None, bool(own))


def _largest_packet(control: ControlChannel) -> int | None:
    """The largest test packet that arrives; None if the camera does not grant control."""
    try:
        control.write_register(Bootstrap.CCP, gev.CCP_CONTROL, _soon())
    except (CommandRefused, NoReply):
        return None
    before = _read(control, Bootstrap.SCPS)
    try:
        with open_stream_socket(control.local_address, RECEIVE_BUFFER_BYTES) as stream:
            size, arrived = choose_packet_bytes(control, stream, None, time.monotonic() + TEST_LIMIT_S)
        return size if arrived else 0
    except (CommandRefused, NoReply, MalformedReply):
        return 0
    finally:
        if before is not None:
            with contextlib.suppress(CommandRefused, NoReply):
                control.write_register(Bootstrap.SCPS, before & ~gev.SCPS_FIRE_TEST, _soon())
        with contextlib.suppress(CommandRefused, NoReply):
            control.write_register(Bootstrap.CCP, gev.CCP_OPEN, _soon())


def _read(control: ControlChannel, register: int) -> int | None:
    """A register, or None if the camera refuses or does not reply."""
    try:
        return control.read_register(register, _soon())
    except (CommandRefused, NoReply, MalformedReply):
        return None


def _soon() -> float:
    return time.monotonic() + REPLY_LIMIT_S
