"""`ronna-procedure doctor`: what this computer offers, and what answers at a theatre file's endpoints."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from ronna_hw.command_line.console import print_json, print_table
from ronna_hw.config import DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import EXIT_NOT_FOUND, RonnaError

RECEIVE_BUFFER_WANTED = 4 * 1024 * 1024  # bytes; a full frame of both cameras at 1500-byte packets
ANSWER_S = 3.0  # host time per device


@dataclass(frozen=True)
class Finding:
    """One line: what was looked at, whether it is well, what was seen, what to do."""

    subject: str
    well: bool
    seen: str
    advice: str = ""


def examine(config: Path | None) -> list[Finding]:
    """Look at the computer, and at every device of a theatre file when one is given."""
    findings = [_python(), _foreign_packages(), _receive_buffer(), _real_time(), *_serial_ports()]
    if config is not None:
        theatre = read_theatre_file(config)
        findings += [_device(name, device) for name, device in _devices(theatre)]
    return findings


def show(findings: list[Finding], *, as_json: bool) -> None:
    """Print the findings; ends with exit code 4 when a device of the theatre did not answer."""
    if as_json:
        print_json({"findings": [asdict(finding) for finding in findings]})
    else:
        print_table(
            "Doctor",
            ("looked at", "", "seen", "what to do"),
            [(f.subject, "well" if f.well else "look", f.seen, f.advice) for f in findings],
        )
    if any(not f.well and f.subject.startswith("device ") for f in findings):
        raise SystemExit(EXIT_NOT_FOUND)


def _python() -> Finding:
    return Finding("Python", sys.version_info >= (3, 11), sys.version.split()[0])


def _foreign_packages() -> Finding:
    from ronna_hw.own_packages import foreign_packages

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
    return [
        Finding(
            f"serial port {port.device}",
            os.access(port.device, os.R_OK | os.W_OK),
            str(port.description),
            ""
            if os.access(port.device, os.R_OK | os.W_OK)
            else "Join the group that owns it (often dialout).",
        )
        for port in ports
    ]


def _devices(theatre: TheatreFile) -> list[tuple[str, DeviceConfig]]:
    devices = [(f"robot.{name}", device) for name, device in theatre.robot.items()]
    for name in ("tracker", "stereo"):
        device = getattr(theatre, name)
        if device is not None:
            devices.append((name, device))
    return devices


def _device(name: str, device: DeviceConfig) -> Finding:
    """Connect as the procedure would, read the identity, and leave."""
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
        return Finding(
            f"device {name}", False, f"{addresses}: {error.code} {error.what}", _cause(device, error)
        )
    return Finding(
        f"device {name}", True, f"{addresses}: {identity.model} {identity.serial} {identity.firmware}"
    )


def _cause(device: DeviceConfig, error: RonnaError) -> str:
    """The likely cause in plain words, from a look below the protocol."""
    texts = [*device.endpoints.values()] or [str(device.endpoint)]
    for text in texts:
        endpoint = parse_endpoint(text)
        look = _LOOKS.get(endpoint.scheme)
        cause = look(endpoint) if look else ""
        if cause:
            return cause
    return error.advice


def _look_at_tcp(endpoint: Endpoint) -> str:
    try:
        socket.create_connection((endpoint.host, endpoint.port), 1.0).close()
    except ConnectionRefusedError:
        return f"Nothing listens at {endpoint}: is the device on, and the program on it started?"
    except OSError as error:
        return f"{endpoint} cannot be reached ({error.strerror or error}): check cable and subnet."
    return ""


def _look_at_serial(endpoint: Endpoint) -> str:
    if not os.path.exists(endpoint.path):
        return f"{endpoint.path} does not exist: is the adapter plugged in?"
    if not os.access(endpoint.path, os.R_OK | os.W_OK):
        return f"No permission for {endpoint.path}: join the group that owns it."
    return ""


_LOOKS: dict[str, Callable[[Endpoint], str]] = {"tcp": _look_at_tcp, "serial": _look_at_serial}
