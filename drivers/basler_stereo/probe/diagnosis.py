"""Interprets the state of a camera's address: observation, likely cause, what to do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from drivers.basler_stereo.control.identity import CameraIdentity
from drivers.basler_stereo.probe.camera_state import CameraState, Controller, Response
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network import Interface

JUMBO_BYTES = 8000  # below this, both cameras at full rate keep a computer busy
LISTED_CAMERAS = 4
SECTION = "cameras"


class Expected(NamedTuple):
    """A camera's address, and its expected identity, if known."""

    endpoint: Endpoint
    serial: str | None = None
    model: str | None = None


class Diagnosis(NamedTuple):
    """One line for display."""

    well: bool
    seen: str
    advice: str = ""


def camera_diagnostic(camera: CameraState, found: Sequence[CameraIdentity], expected: Expected) -> Diagnostic:
    """The camera for the doctor, including figures. `found` replied to broadcast discovery."""
    well, seen, advice = diagnose(camera, found, expected)
    document: dict[str, Any] = {
        "endpoint": str(camera.endpoint),
        "well": well,
        "access": camera.response.value,
        "interface": asdict(camera.interface) if camera.interface else None,
        "camera": _identity(camera.identity) if camera.identity else None,
        "control": _control(camera.controller) if camera.controller else None,
        "packet_bytes": camera.packet_bytes,
        "seen": seen,
        "cause": advice,
    }
    serials = {str(camera.endpoint): camera.identity.serial if camera.identity else None}
    return Diagnostic(f"camera {camera.endpoint}", well, seen, advice, SECTION, document, serials)


def discovery_diagnostic(interface: Interface, found: Sequence[CameraIdentity]) -> Diagnostic:
    """The cameras on one network, with those whose serial number replied several times."""
    serials = [each.serial for each in found]
    doubled = sorted({serial for serial in serials if serials.count(serial) > 1})
    advice = (
        f"{' and '.join(doubled)} replied several times: there is another cell on this network."
        if doubled
        else ""
    )
    shown = ", ".join(map(_shown, found))
    by_endpoint = {f"gev://{each.address}": each.serial for each in found}
    return Diagnostic(f"cameras on {interface.name}", True, shown, advice, serials=by_endpoint)


def diagnose(camera: CameraState, found: Sequence[CameraIdentity], expected: Expected) -> Diagnosis:
    """State the observation, and what it means."""
    identity, controller = camera.identity, camera.controller
    if identity is None or controller is None:
        return _unanswered(camera, found)
    if expected.model and identity.model != expected.model:
        advice = f"Expected a {expected.model}, got a {identity.model}: check address and cable."
        return Diagnosis(False, f"a {identity.model}, expected a {expected.model}", advice)
    if expected.serial and identity.serial != expected.serial:
        seen = f"camera {identity.serial}, expected {expected.serial}"
        return Diagnosis(False, seen, _wrong_serial(expected.serial, found))
    seen = "; ".join(_seen(camera, identity, controller))
    if controller.taken:
        advice = _taken(controller)
    elif camera.packet_bytes is None:
        advice = "It refused control although no application has it: power-cycle it."
    elif not camera.packet_bytes:
        advice = "No test packet arrived: a firewall drops UDP from the camera, or it sends none."
    else:
        jumbo = camera.packet_bytes >= JUMBO_BYTES
        return Diagnosis(True, seen, "" if jumbo else _small_packets(camera.interface))
    return Diagnosis(False, seen, advice)


def _identity(identity: CameraIdentity) -> dict[str, str]:
    return {
        "address": identity.address,
        "vendor": identity.vendor,
        "model": identity.model,
        "serial": identity.serial,
        "name": identity.user_name,
        "firmware": identity.version,
    }


def _control(controller: Controller) -> dict[str, Any]:
    return {
        "taken": controller.taken,
        "address": controller.address,
        "port": controller.port,
        "holder": asdict(controller.process) if controller.process else None,
        "here": controller.here,
    }


def _seen(camera: CameraState, identity: CameraIdentity, controller: Controller) -> Iterator[str]:
    yield f"{identity.vendor} {identity.model} {identity.serial}".strip()
    if camera.interface is not None:
        yield f"via {camera.interface.name} ({camera.interface.address}, MTU {camera.interface.mtu_bytes})"
    yield f"controlled by {_who(controller)}" if controller.taken else "no application in control"
    if camera.packet_bytes:
        yield f"packets of {camera.packet_bytes} bytes arrive"


def _who(controller: Controller) -> str:
    if controller.process is not None:
        return str(controller.process)
    if controller.port:
        return f"{controller.address}:{controller.port}"
    return "an application not identified by the camera"


def _taken(controller: Controller) -> str:
    if controller.process is not None:
        return "Stop that program; a camera releases a crashed one within its heartbeat time-out."
    if controller.here:
        return "That program has ended, or belongs to another user: wait for the heartbeat time-out, or ask."
    return "Close the program on the other computer; if it crashed, wait for its heartbeat time-out."


def _wrong_serial(serial: str, found: Sequence[CameraIdentity]) -> str:
    if others := [each for each in found if each.serial == serial]:
        more = f" (and replied {len(others)} times)" if len(others) > 1 else ""
        return (
            f"Camera {serial} is at {others[0].address}{more}: swap cables, or endpoints in the theatre file."
        )
    return f"Expected camera {serial}, which did not reply. After replacing a camera, recalibrate the head."


def _small_packets(interface: Interface | None) -> str:
    where = f"{interface.name} has an MTU of {interface.mtu_bytes}" if interface else "The path MTU is small"
    return f"{where}: for full frames at full rate allow jumbo frames on the card and every switch."


def _unanswered(camera: CameraState, found: Sequence[CameraIdentity]) -> Diagnosis:
    interface = camera.interface
    if camera.response is Response.NO_ROUTE:
        advice = "Give this computer an address in the camera's subnet."
        return Diagnosis(False, f"no route: {camera.reason}", advice)
    via = f" via {interface.name} ({interface.address})" if interface else ""
    elsewhere = _elsewhere(camera, found)
    if camera.response is Response.REFUSED:
        advice = "A computer is at this address, not a camera: check the camera's power, cable and address."
        return Diagnosis(False, f"refused{via}: nothing listens on the GigE Vision port", advice + elsewhere)
    if interface is not None and not interface.reaches(camera.endpoint.host):
        advice = "No network card of this computer is in its subnet: camera and host must share one."
    else:
        advice = "Check power and cable of the camera, and its address."
    return Diagnosis(False, f"silent{via}", advice + elsewhere)


def _elsewhere(camera: CameraState, found: Sequence[CameraIdentity]) -> str:
    others = [each for each in found if each.address != camera.endpoint.host]
    if not others:
        return ""
    listed = ", ".join(map(_shown, others[:LISTED_CAMERAS]))
    more = f" and {len(others) - LISTED_CAMERAS} more" if len(others) > LISTED_CAMERAS else ""
    return f" These reply: {listed}{more}."


def _shown(camera: CameraIdentity) -> str:
    return f"{camera.model} {camera.serial} at {camera.address}"
