"""`ronna-procedure doctor`: what this computer offers, and what answers at a theatre file's endpoints.

The tracker's line and the cameras' addresses are looked at below their drivers as well: a wrong rate, another
program, a missing permission or a wrong subnet are the usual reasons for a device that does not answer.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ronna_hw.command_line.console import Progress, print_json, print_table
from ronna_hw.config import DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, RonnaError

if TYPE_CHECKING:
    from procedures.cli.camera_probe import About
    from procedures.cli.line_cause import Verdict
    from procedures.cli.line_probe import Probe

RECEIVE_BUFFER_WANTED = 4 * 1024 * 1024  # bytes; a full frame of both cameras at 1500-byte packets
ANSWER_S = 3.0  # host time per device
JUDGED = ("device ", "line ", "stream port ", "camera gev:")  # one of them not well is the doctor's exit code


@dataclass(frozen=True)
class Finding:
    """One line: what was looked at, whether it is well, what was seen, what to do."""

    subject: str
    well: bool
    seen: str
    advice: str = ""


@dataclass(frozen=True)
class Awaited:
    """A camera that is to be looked at, and which one it should be, where that is known."""

    endpoint: Endpoint
    serial: str | None = None
    model: str | None = None


@dataclass(frozen=True)
class Report:
    """All findings, and what was seen of each tracker's line and each camera in numbers and bytes."""

    findings: tuple[Finding, ...]
    lines: tuple[dict[str, Any], ...] = ()
    cameras: tuple[dict[str, Any], ...] = ()


def examine(
    config: Path | None, endpoints: Sequence[str] = (), progress: Progress = lambda share: None
) -> Report:
    """Look at the computer, at a tracker's line or a camera at each endpoint, and at a theatre's devices."""
    asked = [parse_endpoint(text).require("serial", "tcp", "gev") for text in endpoints]
    trackers = [endpoint for endpoint in asked if endpoint.scheme != "gev"]
    cameras = [Awaited(endpoint) for endpoint in asked if endpoint.scheme == "gev"]
    theatre = None if config is None else read_theatre_file(config)
    findings = [_python(), _foreign_packages(), _receive_buffer(), _real_time(), *_serial_ports()]
    if theatre is not None and theatre.tracker is not None:
        trackers += _polaris_lines(theatre.tracker)
    if theatre is not None and theatre.stereo is not None:
        cameras += _gige_cameras(theatre.stereo)
    devices = [] if theatre is None else _devices(theatre)
    everything = len(trackers) + len(cameras) + len(devices)
    probes = []
    for endpoint in trackers:
        probes.append(_probed(endpoint))
        progress(len(probes) / everything)
    findings += [_line(probe) for probe in probes]
    causes = {str(probe.endpoint): _judged(probe).advice for probe in probes if not _judged(probe).well}
    seen, documents = _look_at_cameras(cameras)
    findings += seen
    causes |= {each["endpoint"]: each["cause"] for each in documents if not each["well"]}
    findings += [] if theatre is None else _stream_ports(theatre)
    for number, (name, device) in enumerate(devices, start=1):
        findings.append(_device(name, device, causes))
        progress((everything - len(devices) + number) / everything)
    return Report(tuple(findings), tuple(_documented(probe) for probe in probes), tuple(documents))


def show(report: Report, *, as_json: bool) -> None:
    """Print the findings; ends with exit code 4 when a device of the theatre or a line did not answer."""
    if as_json:
        findings = [asdict(item) for item in report.findings]
        print_json({"findings": findings, "lines": list(report.lines), "cameras": list(report.cameras)})
    else:
        print_table(
            "Doctor",
            ("looked at", "", "seen", "what to do"),
            [(f.subject, "well" if f.well else "look", f.seen, f.advice) for f in report.findings],
        )
    if any(not f.well and f.subject.startswith(JUDGED) for f in report.findings):
        raise SystemExit(EXIT_NOT_FOUND)


def _python() -> Finding:
    return Finding("Python", sys.version_info >= (3, 11), sys.version.split()[0])


def _foreign_packages() -> Finding:
    from ronna_hw.host.own_packages import foreign_packages

    foreign = foreign_packages()
    return Finding(
        "packages",
        not foreign,
        f"foreign: {', '.join(foreign)}" if foreign else "ours",
        "Run in an environment where no other package has these names." if foreign else "",
    )


def _receive_buffer() -> Finding:
    try:
        size = int(Path("/proc/sys/net/core/rmem_max").read_text())
    except OSError:
        return Finding("camera receive buffer", True, "unknown on this system")
    advice = (
        "" if size >= RECEIVE_BUFFER_WANTED else "Raise net.core.rmem_max to 4194304, or use jumbo packets."
    )
    return Finding("camera receive buffer", not advice, f"net.core.rmem_max {size}", advice)


def _real_time() -> Finding:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        return Finding(
            "real-time priority",
            False,
            "not permitted",
            "Allow RLIMIT_RTPRIO 80 for hardware; tests go without.",
        )
    return Finding("real-time priority", True, "permitted")


def _serial_ports() -> list[Finding]:
    from serial.tools import list_ports

    ports = sorted(list_ports.comports(), key=lambda port: str(port.device))
    if not ports:
        return [Finding("serial ports", True, "none on this computer")]
    return [_serial_port(str(port.device), _described(str(port.description))) for port in ports]


def _described(description: str) -> str:
    return "no description" if description == "n/a" else description


def _serial_port(path: str, description: str) -> Finding:
    from procedures.cli.line_cause import permission_advice, permissions
    from ronna_hw.host.port_users import users_of_serial_port

    subject = f"serial port {path}"
    seen = f"{description}; {permissions(path)}"
    if not os.access(path, os.R_OK | os.W_OK):
        return Finding(subject, False, f"{seen}; permission denied", permission_advice(path))
    if holders := users_of_serial_port(path):
        return Finding(subject, True, f"{seen}; in use by " + " and ".join(map(str, holders)))
    return Finding(subject, True, seen)


def _polaris_lines(tracker: DeviceConfig) -> list[Endpoint]:
    """The endpoint of a tracker whose driver speaks the protocol that the probe speaks."""
    from ronna_hw.registry import load_driver

    try:
        protocol = getattr(load_driver(tracker.driver), "wire_protocol", None)
        endpoint = tracker.address()
    except RonnaError:  # told with the device itself
        return []
    return [endpoint] if protocol == "ndi-polaris" and endpoint.scheme in ("serial", "tcp") else []


def _probed(endpoint: Endpoint) -> Probe:
    from procedures.cli.line_probe import probe_line

    return probe_line(endpoint)


def _judged(probe: Probe) -> Verdict:
    from procedures.cli.line_cause import judge

    return judge(probe)


def _documented(probe: Probe) -> dict[str, Any]:
    from procedures.cli.line_cause import document

    return document(probe)


def _line(probe: Probe) -> Finding:
    verdict = _judged(probe)
    return Finding(f"line {probe.endpoint}", verdict.well, verdict.seen, verdict.advice)


def _gige_cameras(stereo: DeviceConfig) -> list[Awaited]:
    """The cameras of a stereo head whose driver speaks the protocol that the probe speaks."""
    from ronna_hw.registry import load_driver

    try:
        protocol = getattr(load_driver(stereo.driver), "wire_protocol", None)
        sides = {side: parse_endpoint(text) for side, text in stereo.endpoints.items()}
    except RonnaError:  # told with the device itself
        return []
    if protocol != "gige-vision":
        return []
    awaited = []
    for side, endpoint in sides.items():
        serial, model = stereo.options.get(f"{side}_serial"), stereo.options.get("expected_model")
        if endpoint.scheme == "gev":
            texts = [each if isinstance(each, str) else None for each in (serial, model)]
            awaited.append(Awaited(endpoint, *texts))
    return awaited


def _look_at_cameras(cameras: Sequence[Awaited]) -> tuple[list[Finding], list[dict[str, Any]]]:
    """What answers on each network, then each camera's address; nothing without cameras to look for."""
    if not cameras:
        return [], []
    from procedures.cli.camera_cause import document, judge
    from procedures.cli.camera_probe import found_around, probe_camera

    findings: list[Finding] = []
    found: list[About] = []
    for interface, answered in found_around([camera.endpoint for camera in cameras]):
        found += answered
        listed = ", ".join(f"{each.model} {each.serial} at {each.address}" for each in answered)
        findings.append(Finding(f"cameras on {interface.name}", True, listed))
    documents = []
    for camera in cameras:
        probe = probe_camera(camera.endpoint)
        verdict = judge(probe, found, camera.serial, camera.model)
        documents.append(document(probe, verdict))
        findings.append(Finding(f"camera {camera.endpoint}", verdict.well, verdict.seen, verdict.advice))
    return findings, documents


def _stream_ports(theatre: TheatreFile) -> list[Finding]:
    """Where the robots' controllers are to send to: a driver listens there only while its stream runs."""
    from procedures.cli.stream_port import look_at_stream_port

    texts = [text for device in theatre.robot.values() for text in device.endpoints.values()]
    streams = [endpoint for endpoint in map(parse_endpoint, texts) if endpoint.scheme == "udp"]
    return [_stream_port(endpoint, look_at_stream_port(endpoint)) for endpoint in streams]


def _stream_port(endpoint: Endpoint, verdict: Verdict) -> Finding:
    return Finding(f"stream port {endpoint}", verdict.well, verdict.seen, verdict.advice)


def _devices(theatre: TheatreFile) -> list[tuple[str, DeviceConfig]]:
    devices = [(f"robot.{name}", device) for name, device in theatre.robot.items()]
    for name in ("tracker", "stereo"):
        device = getattr(theatre, name)
        if device is not None:
            devices.append((name, device))
    return devices


def _device(name: str, device: DeviceConfig, causes: dict[str, str]) -> Finding:
    """Connect as the procedure would, read the identity, and leave. `causes`: endpoint -> likely cause."""
    from ronna_hw.clock import HostClock
    from ronna_hw.registry import make_device

    addresses = ", ".join(device.endpoints.values()) or str(device.endpoint)
    try:
        session = make_device(name, device, HostClock())
        try:
            identity = session.connect(ANSWER_S)
        finally:
            session.close()
    except RonnaError as error:
        own = [*device.endpoints.values()] or [str(device.endpoint)]
        known = next((causes[text] for text in own if text in causes), "")
        cause = known or _cause(device) or error.advice
        return Finding(f"device {name}", False, f"{addresses}: {error.code} {error.what}", cause)
    return Finding(
        f"device {name}", True, f"{addresses}: {identity.model} {identity.serial} {identity.firmware}"
    )


def _cause(device: DeviceConfig) -> str:
    """Why nothing answers at the TCP endpoints of a device of any kind, in plain words."""
    for text in [*device.endpoints.values()] or [str(device.endpoint)]:
        endpoint = parse_endpoint(text)
        if endpoint.scheme == "tcp" and (cause := _look_at_tcp(endpoint)):
            return cause
    return ""


def _look_at_tcp(endpoint: Endpoint) -> str:
    try:
        socket.create_connection((endpoint.host, endpoint.port), 1.0).close()
    except ConnectionRefusedError:
        return f"Nothing listens at {endpoint}: is the device on, and the program on it started?"
    except OSError as error:
        return f"{endpoint} cannot be reached ({error.strerror or error}): check cable and subnet."
    return ""
