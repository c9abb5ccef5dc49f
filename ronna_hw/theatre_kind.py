"""Distinction between simulated and real theatres; a simulated one must declare itself.

The address decides. A simulated device is on this computer: at a pseudo-terminal, a loopback address or
in shared memory; a real one is at a serial port or a network address. The clock of a simulated theatre
is in shared memory.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from typing import Protocol

from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ErrorCode, RefusedError

PSEUDO_TERMINALS = "/dev/pts/"


class Addresses(Protocol):
    """Addresses and banner that distinguish a real theatre from a simulated one."""

    @property
    def addresses(self) -> Mapping[str, tuple[str, ...]]: ...
    @property
    def clock_address(self) -> str: ...
    @property
    def banner(self) -> str: ...


MIXED_THEATRE = ErrorCode(
    "CFG-004",
    RefusedError,
    "The theatre file mixes simulated and real devices, or does not declare itself simulated.",
    "Use one theatre per file: ronna-sim theatre writes the simulated one, you write the real one.",
)


def is_on_this_computer(endpoint: Endpoint) -> bool | None:
    """Return whether an address is local to this computer, or None if it cannot be determined.

    Links and names count as what they lead to.
    """
    if endpoint.scheme == "shm":
        return True
    endpoint = endpoint.resolve_names()
    if endpoint.scheme == "serial":
        return endpoint.path.startswith(PSEUDO_TERMINALS)
    if endpoint.scheme == "host":
        return None
    try:
        address = ipaddress.ip_address(endpoint.host)
    except ValueError:
        return False  # a name that nobody knows
    return None if address.is_unspecified else address.is_loopback


def is_simulated(theatre: Addresses) -> bool:
    """Return whether all devices are simulated, judging by their addresses."""
    simulated, real = _sort_by_kind(theatre)
    return bool(simulated) and not real


def require_one_kind(theatre: Addresses) -> None:
    """Raise CFG-004 for mixed real and simulated devices, or a simulated theatre without a banner."""
    simulated, real = _sort_by_kind(theatre)
    if simulated and real:
        raise MIXED_THEATRE(
            "the theatre file mixes simulated and real devices",
            expected="one kind",
            got=f"simulated: {', '.join(simulated)}; real: {', '.join(real)}",
        )
    if simulated and not theatre.banner:
        raise MIXED_THEATRE(
            "every device is on this computer, as with simulators, and the theatre file has no banner",
            action="Add a banner that says so; if they are real, give their network addresses.",
        )


def _sort_by_kind(theatre: Addresses) -> tuple[list[str], list[str]]:
    """Separate simulated from real devices, each with its address."""
    simulated: list[str] = []
    real: list[str] = []
    for name, addresses in theatre.addresses.items():
        for address in addresses:
            if (here := is_on_this_computer(parse_endpoint(address))) is not None:
                (simulated if here else real).append(f"{name} at {address}")
    clock = theatre.clock_address
    if parse_endpoint(clock).scheme == "shm":
        simulated.insert(0, f"the clock at {clock}")
    return simulated, real
