"""Diagnosis of a camera's address: reply, controlling application, largest packet size, advice.

Reading changes nothing. To find the packet size, an uncontrolled camera is briefly controlled, sends test
packets, and is released; a controlled one is left alone.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, NamedTuple

from drivers.basler_stereo.control_channel import CameraControl
from drivers.basler_stereo.errors import CommandRefused, MalformedReply, NoCamera, NoReply
from drivers.basler_stereo.features import output_line
from drivers.basler_stereo.features.description import fetch_description, parse_description
from drivers.basler_stereo.features.feature_map import FeatureMap, RegisterMemory
from drivers.basler_stereo.identity import CameraIdentity, identify, list_cameras
from drivers.basler_stereo.options import ProjectorOptions
from drivers.basler_stereo.stream.receiver import choose_packet_bytes, open_stream_socket
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.network import Interface, find_interface, interfaces
from ronna_hw.host.port_users import LEAVE_A_CASE_ALONE, PortUser, find_udp_port_user
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GvcpCapability

REPLY_LIMIT_S = 1.0  # per command, including retries
TEST_LIMIT_S = 5.0  # for all test packets
DESCRIPTION_LIMIT_S = 5.0  # for the camera's description, up to a megabyte
LINE_ADVICE = "Correct `line` in [stereo.options.projector] to the output that switches the projector."
RECEIVE_BUFFER_BYTES = 65_536  # one test packet at a time
JUMBO_BYTES = 8000  # below this, both cameras at full rate keep a computer busy
SECTION = "cameras"
Finding = tuple[bool, str, str]  # whether all is well, observation, advice


class Response(StrEnum):
    """Reachability of a camera address."""

    ANSWERED = "answered"
    NO_ROUTE = "no way"
    REFUSED = "refused"  # a computer is there, but nothing listens on the cameras' port
    SILENT = "silent"


@dataclass(frozen=True)
class ControllingHost:
    """Application in control of a camera, if any; the camera may not report its address."""

    taken: bool
    address: str = ""
    port: int = 0
    holder: PortUser | None = None  # if it runs on this computer and is visible to us
    here: bool = False  # the address is this computer's


@dataclass(frozen=True)
class CameraState:
    """Diagnostic findings for one camera address; None marks stages not reached."""

    endpoint: Endpoint
    response: Response
    interface: Interface | None = None
    identity: CameraIdentity | None = None
    controller: ControllingHost | None = None
    packet_bytes: int | None = None  # the largest that arrives; 0 if no test packet arrived at all
    reason: str = ""  # the system's, if there is no route


def check_camera(endpoint: Endpoint) -> CameraState:
    """Check one camera's address within about two seconds; never raises."""
    try:
        with contextlib.closing(CameraControl(endpoint.host)) as control:
            return _check_stages(control, endpoint)
    except OSError as error:  # also when the network goes down meanwhile
        return CameraState(endpoint, Response.NO_ROUTE, reason=error.strerror or str(error))


def _check_stages(control: CameraControl, endpoint: Endpoint) -> CameraState:
    interface = find_interface(control.local_address)
    try:
        identity = identify(control, _reply_deadline_s())
    except (NoCamera, MalformedReply, CommandRefused):
        response = Response.REFUSED if control.port_closed else Response.SILENT
        return CameraState(endpoint, response, interface)
    controller = _read_controller(control)
    size = None if controller.taken else _find_largest_packet(control)
    return CameraState(endpoint, Response.ANSWERED, interface, identity, controller, size)


def _read_controller(control: CameraControl) -> ControllingHost:
    if _try_read_register(control, Bootstrap.CCP) == gev.CCP_OPEN:
        return ControllingHost(taken=False)
    capability = _try_read_register(control, Bootstrap.GVCP_CAPABILITY) or 0
    if not capability & GvcpCapability.CCP_APPLICATION:
        return ControllingHost(taken=True)
    port = _try_read_register(control, Bootstrap.PRIMARY_APPLICATION_PORT)
    address = _try_read_register(control, Bootstrap.PRIMARY_APPLICATION_ADDRESS)
    if not port or not address:
        return ControllingHost(taken=True)  # under exclusive access even reading is refused
    owner = socket.inet_ntoa(address.to_bytes(4, "big"))
    here = any(each.address == owner or (each.loopback and each.reaches(owner)) for each in interfaces())
    return ControllingHost(True, owner, port, find_udp_port_user(owner, port) if here else None, here)


def _find_largest_packet(control: CameraControl) -> int | None:
    """Determine the largest test packet that arrives, or None if the camera refuses control."""
    try:
        control.write_register(Bootstrap.CCP, gev.CCP_CONTROL, _reply_deadline_s())
    except (CommandRefused, NoReply):
        return None
    before = _try_read_register(control, Bootstrap.SCPS)
    try:
        with open_stream_socket(control.local_address, RECEIVE_BUFFER_BYTES) as stream:
            size, arrived = choose_packet_bytes(control, stream, None, time.monotonic() + TEST_LIMIT_S)
        return size if arrived else 0
    except (CommandRefused, NoReply, MalformedReply):
        return 0
    finally:
        if before is not None:
            with contextlib.suppress(CommandRefused, NoReply):
                control.write_register(Bootstrap.SCPS, before & ~gev.SCPS_FIRE_TEST, _reply_deadline_s())
        with contextlib.suppress(CommandRefused, NoReply):
            control.write_register(Bootstrap.CCP, gev.CCP_OPEN, _reply_deadline_s())


def _try_read_register(control: CameraControl, register: int) -> int | None:
    """Read a register, or return None if the camera refuses or does not reply."""
    try:
        return control.read_register(register, _reply_deadline_s())
    except (CommandRefused, NoReply, MalformedReply):
        return None


def _reply_deadline_s() -> float:
    return time.monotonic() + REPLY_LIMIT_S


class ExpectedCamera(NamedTuple):
    """Camera address with the expected serial number and model, if known."""

    endpoint: Endpoint
    serial: str | None = None
    model: str | None = None


def camera_diagnostic(
    camera: CameraState, found: Sequence[CameraIdentity], expected: ExpectedCamera
) -> Diagnostic:
    """Return the doctor's finding for a camera; `found` lists the replies to broadcast discovery."""
    well, seen, advice = _diagnose(camera, found, expected)
    document: dict[str, Any] = {
        "endpoint": str(camera.endpoint),
        "well": well,
        "access": camera.response.value,
        "interface": asdict(camera.interface) if camera.interface else None,
        "camera": _identity_document(camera.identity) if camera.identity else None,
        "control": asdict(camera.controller) if camera.controller else None,
        "packet_bytes": camera.packet_bytes,
        "seen": seen,
        "cause": advice,
    }
    serials = {str(camera.endpoint): camera.identity.serial if camera.identity else None}
    return Diagnostic(f"camera {camera.endpoint}", well, seen, advice, SECTION, document, serials)


def discovery_diagnostic(interface: Interface, found: Sequence[CameraIdentity]) -> Diagnostic:
    """Report the cameras on one network and any duplicate serial numbers."""
    serials = [each.serial for each in found]
    doubled = sorted({serial for serial in serials if serials.count(serial) > 1})
    where = "cell on this computer" if interface.loopback else "cell on this network"
    advice = f"{' and '.join(doubled)} replied several times: there is another {where}." if doubled else ""
    shown = ", ".join(map(str, found))
    by_endpoint = {f"gev://{each.address}": each.serial for each in found}
    return Diagnostic(f"cameras on {interface.name}", True, shown, advice, serials=by_endpoint)


def _diagnose(camera: CameraState, found: Sequence[CameraIdentity], expected: ExpectedCamera) -> Finding:
    identity, controller = camera.identity, camera.controller
    if identity is None or controller is None:
        return _diagnose_no_reply(camera, found)
    if expected.model and identity.model != expected.model:
        advice = f"Expected a {expected.model}, got a {identity.model}: check address and cable."
        return False, f"a {identity.model}, expected a {expected.model}", advice
    if expected.serial and identity.serial != expected.serial:
        seen = f"camera {identity.serial}, expected {expected.serial}"
        return False, seen, _wrong_serial_advice(expected.serial, found)
    seen = "; ".join(_observations(camera, identity, controller))
    if controller.taken:
        advice = _release_advice(controller)
    elif camera.packet_bytes is None:
        advice = "It refused control although no application has it: power-cycle it."
    elif not camera.packet_bytes:
        advice = "No test packet arrived: a firewall drops UDP from the camera, or it sends none."
    else:
        jumbo = camera.packet_bytes >= JUMBO_BYTES
        return True, seen, "" if jumbo else _small_packets_advice(camera.interface)
    return False, seen, advice


def _identity_document(identity: CameraIdentity) -> dict[str, str]:
    return {
        "address": identity.address,
        "vendor": identity.vendor,
        "model": identity.model,
        "serial": identity.serial,
        "name": identity.user_name,
        "firmware": identity.version,
        "info": identity.info,
    }


def _observations(
    camera: CameraState, identity: CameraIdentity, controller: ControllingHost
) -> Iterator[str]:
    yield f"{identity.vendor} {identity.model} {identity.serial}".strip()
    if camera.interface is not None:
        yield f"via {camera.interface.name} ({camera.interface.address}, MTU {camera.interface.mtu_bytes})"
    yield f"controlled by {_controller_name(controller)}" if controller.taken else "no application in control"
    if camera.packet_bytes:
        yield f"packets of {camera.packet_bytes} bytes arrive"


def _controller_name(controller: ControllingHost) -> str:
    if controller.holder is not None:
        return str(controller.holder)
    if controller.port:
        return f"{controller.address}:{controller.port}"
    return "an application not identified by the camera"


def _release_advice(controller: ControllingHost) -> str:
    if controller.holder is not None:
        return f"{LEAVE_A_CASE_ALONE} Otherwise stop it, then wait for the camera's heartbeat time-out."
    if controller.here:
        return "That program has ended, or belongs to another user: wait for the heartbeat time-out, or ask."
    return "Close the program on the other computer; if it crashed, wait for its heartbeat time-out."


def _wrong_serial_advice(serial: str, found: Sequence[CameraIdentity]) -> str:
    if others := [each for each in found if each.serial == serial]:
        more = f" (and replied {len(others)} times)" if len(others) > 1 else ""
        return (
            f"Camera {serial} is at {others[0].address}{more}: swap cables, or endpoints in the theatre file."
        )
    return f"Expected camera {serial}, which did not reply. After replacing a camera, recalibrate the head."


def _small_packets_advice(interface: Interface | None) -> str:
    limit_text = (
        f"{interface.name} has an MTU of {interface.mtu_bytes}" if interface else "The path MTU is small"
    )
    return f"{limit_text}: for full frames at full rate allow jumbo frames on the card and every switch."


def _diagnose_no_reply(camera: CameraState, found: Sequence[CameraIdentity]) -> Finding:
    interface = camera.interface
    if camera.response is Response.NO_ROUTE:
        advice = "Give this computer an address in the camera's subnet."
        return False, f"no route: {camera.reason}", advice
    via = f" via {interface.name} ({interface.address})" if interface else ""
    other_replies = _other_replies(camera, found)
    if camera.response is Response.REFUSED:
        advice = "A computer is at this address, not a camera: check the camera's power, cable and address."
        return False, f"refused{via}: nothing listens on the GigE Vision port", advice + other_replies
    if interface is not None and not interface.reaches(camera.endpoint.host):
        advice = "No network card of this computer is in its subnet: camera and host must share one."
    else:
        advice = "Check power and cable of the camera, and its address."
    return False, f"silent{via}", advice + other_replies


def _other_replies(camera: CameraState, found: Sequence[CameraIdentity]) -> str:
    if not (others := [each for each in found if each.address != camera.endpoint.host]):
        return ""
    return f" These reply: {list_cameras(others)}."


def diagnose_output_line(endpoint: Endpoint, projector: ProjectorOptions) -> Diagnostic | None:
    """Check that a camera has the projector's line, without control; None if it cannot be asked."""
    try:
        with contextlib.closing(CameraControl(endpoint.host)) as control:
            deadline_s = time.monotonic() + DESCRIPTION_LIMIT_S
            memory = RegisterMemory(control)
            memory.deadline_s = deadline_s
            features = FeatureMap(parse_description(fetch_description(control, deadline_s)), memory)
            lines = output_line.list_lines(features)
    except (OSError, RonnaError):
        return None  # the camera's own diagnosis says why
    camera = f"{projector.camera} camera"
    missing = output_line.missing_line(lines, projector.line, camera)
    seen = missing or f"the {camera} has line {projector.line}"
    return Diagnostic("line projector", not missing, seen, LINE_ADVICE if missing else "")
