"""A port of this computer that nobody has, for a device that is told where its client will listen."""

from __future__ import annotations

import socket

LOOPBACK = "127.0.0.1"


def free_udp_port() -> int:
    """A UDP port on loopback that is free now; whoever asked binds it in a moment."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])
