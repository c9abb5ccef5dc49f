"""Finds out why an arm does not answer: whether its stream port is free, and what EKI reports.

A controller serves one EKI client at a time and needs a moment before the next, so there is only one
connection, the driver's own.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence

from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.kuka_rsi.controller_discovery import example_arm, find_controllers
from drivers.kuka_rsi.realtime.sockets import bind
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    Diagnostic,
    Inspection,
    Progress,
    Proposal,
    Search,
    connect_and_leave,
    endpoints_of,
    leave_alone,
)
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import user_of_udp_port


class KukaProbe:
    """The probe of this driver; its `find` serves a new theatre file."""

    table = "robot"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = leave_alone
    ) -> Sequence[Diagnostic]:
        """The stream's port, then the controller. Nothing is sent to the stream, and nothing moves."""
        streams = [endpoint for endpoint in endpoints_of(config) if endpoint.scheme == "udp"]
        ports = tuple(map(stream_port_diagnostic, streams))  # before the driver itself listens there
        return (*ports, *connect_and_leave(name, config, KukaRsiArm, inspect=inspect))

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        return find_controllers(search, progress)

    def example(self, search: Search) -> Proposal:
        return example_arm(search)


probe = KukaProbe()


def stream_port_diagnostic(endpoint: Endpoint) -> Diagnostic:
    """Whether the driver can listen on the controller's destination: bind as it would, and release."""
    subject = f"stream port {endpoint}"
    try:
        bind(endpoint.host, endpoint.port).close()
    except OSError as error:
        return Diagnostic(subject, False, *_refusal(endpoint, error))
    return Diagnostic(subject, True, "free for the driver to listen on")


def _refusal(endpoint: Endpoint, error: OSError) -> tuple[str, str]:
    """(observation, what to do)."""
    if error.errno == errno.EADDRINUSE:
        if user := user_of_udp_port(endpoint.host, endpoint.port):
            return f"in use by {user}", "Stop that program; it may be another run of the robot."
        return (
            "in use by a program not visible to this user",
            f"Find it with: sudo ss -ulnp 'sport = {endpoint.port}'",
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return (
            f"{endpoint.host} is not an address of this computer",
            "Give the network card towards the controller the address in the Ethernet file (IP_NUMBER).",
        )
    if error.errno == errno.EACCES:
        return (
            "permission denied",
            "Ports below 1024 are reserved: choose another, here and in the Ethernet file.",
        )
    return error.strerror or str(error), "Give an IPv4 address of this computer."
