"""Whether this computer can listen where a controller is to send its stream."""

from __future__ import annotations

import errno
import socket

from procedures.cli.line_cause import Verdict
from ronna_hw.endpoints import Endpoint


def look_at_stream_port(endpoint: Endpoint) -> Verdict:
    """Take the port as the driver would, and give it back. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        try:
            link.bind((endpoint.host, endpoint.port))
        except OSError as error:
            return _refused(endpoint, error)
    return Verdict(True, "free for the driver to listen at")


def _refused(endpoint: Endpoint, error: OSError) -> Verdict:
    seen, advice = {
        errno.EADDRINUSE: (
            "another program listens there",
            f"See which by `ss -ulnp 'sport = {endpoint.port}'`: another run of the robot?",
        ),
        errno.EADDRNOTAVAIL: (
            f"{endpoint.host} is no address of this computer",
            "Give the adapter that the controller is wired to the address of the Ethernet file (IP_NUMBER).",
        ),
        errno.EACCES: (
            "not permitted",
            "Ports below 1024 are the system's: choose another one, here and in the Ethernet file.",
        ),
    }.get(error.errno or 0, (error.strerror or str(error), "Name an IPv4 address of this computer."))
    return Verdict(False, seen, advice)
