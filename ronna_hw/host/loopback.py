"""Loopback addresses that belong to one process, without a race for free ports."""

from __future__ import annotations

import os

FIRST_PORT = 20_000  # below the ports that the kernel assigns itself, which start at 32768


def own_udp_endpoint(number: int = 0) -> str:
    """A `udp://` endpoint that no other running process gets, nor this one under another `number`.

    For a device that must be configured with its client's address. The process id, at most 22 bits,
    determines the address: Linux answers on all of 127.0.0.0/8.
    """
    process = os.getpid()
    return f"udp://127.{64 + (process >> 16)}.{process >> 8 & 255}.{process & 255}:{FIRST_PORT + number}"
