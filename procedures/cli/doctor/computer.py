"""What this computer offers: Python, packages, receive buffer, real-time priority, serial ports."""

from __future__ import annotations

import getpass
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from ronna_hw.devices.probing import Diagnostic

LIMITS_FILE = "/etc/security/limits.d/ronna-hw.conf"
RECEIVE_BUFFER_WANTED = 4 * 1024 * 1024  # bytes; a full frame of both cameras at 1500-byte packets


def computer_diagnostics() -> Iterator[Diagnostic]:
    """All checks that need no device."""
    yield Diagnostic("Python", sys.version_info >= (3, 11), sys.version.split()[0])
    yield _packages()
    yield _receive_buffer()
    yield _real_time()
    yield from _serial_ports()


def _packages() -> Diagnostic:
    from ronna_hw.host.process import foreign_packages

    if foreign := foreign_packages():
        advice = "Use an environment in which no other package has these names."
        return Diagnostic("packages", False, f"foreign: {', '.join(foreign)}", advice)
    return Diagnostic("packages", True, "none foreign")


def _receive_buffer() -> Diagnostic:
    try:
        size = int(Path("/proc/sys/net/core/rmem_max").read_text())
    except OSError:
        return Diagnostic("camera receive buffer", True, "unknown on this system")
    large = size >= RECEIVE_BUFFER_WANTED
    advice = "" if large else "sudo sysctl -w net.core.rmem_max=4194304, or use jumbo packets."
    return Diagnostic("camera receive buffer", large, f"net.core.rmem_max {size}", advice)


def _real_time() -> Diagnostic:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        advice = (
            f"For hardware: echo '{getpass.getuser()} - rtprio 80' | sudo tee {LIMITS_FILE}, then log in "
            "again; simulators do not need it."
        )
        return Diagnostic("real-time priority", False, "not permitted", advice)
    return Diagnostic("real-time priority", True, "permitted")


def _serial_ports() -> Iterator[Diagnostic]:
    from serial.tools import list_ports

    ports = sorted(list_ports.comports(), key=lambda port: str(port.device))
    if not ports:
        yield Diagnostic("serial ports", True, "none on this computer")
    for port in ports:
        description = "no description" if port.description == "n/a" else str(port.description)
        yield _serial_port(str(port.device), description)


def _serial_port(path: str, description: str) -> Diagnostic:
    from ronna_hw.host.port_users import permission_advice, permissions, users_of_serial_port

    subject = f"serial port {path}"
    seen = f"{description}; {permissions(path)}"
    if not os.access(path, os.R_OK | os.W_OK):
        return Diagnostic(subject, False, f"{seen}; permission denied", permission_advice(path))
    if users := users_of_serial_port(path):
        seen += "; in use by " + " and ".join(map(str, users))
    return Diagnostic(subject, True, seen)
