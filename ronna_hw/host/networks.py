"""The networks of this computer: name, address, largest packet."""

from __future__ import annotations

import contextlib
import fcntl
import socket
import struct
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path

NETWORKS = Path("/sys/class/net")
SIOCGIFADDR, SIOCGIFNETMASK = 0x8915, 0x891B  # from linux/sockios.h
REQUEST_BYTES = 256
ADDRESS_PLACE = slice(20, 24)  # of the answer


@dataclass(frozen=True)
class Interface:
    """One network interface with an IPv4 address."""

    name: str
    address: str
    prefix: int
    mtu_bytes: int  # 0 where the system does not say

    @property
    def loopback(self) -> bool:
        """True for the network inside this computer."""
        return IPv4Address(self.address).is_loopback

    def reaches(self, address: str) -> bool:
        """True for an address of its own subnet; False for a name."""
        try:
            return IPv4Address(address) in IPv4Network(f"{self.address}/{self.prefix}", strict=False)
        except ValueError:
            return False


def interfaces() -> tuple[Interface, ...]:
    """All interfaces that have an address."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        for _, name in socket.if_nameindex():
            request = struct.pack(f"{REQUEST_BYTES}s", name.encode()[:15])
            try:
                address = fcntl.ioctl(asker, SIOCGIFADDR, request)[ADDRESS_PLACE]
                mask = fcntl.ioctl(asker, SIOCGIFNETMASK, request)[ADDRESS_PLACE]
            except OSError:  # without an address
                continue
            prefix = int.from_bytes(mask, "big").bit_count()
            found.append(Interface(name, socket.inet_ntoa(address), prefix, _mtu_bytes(name)))
    return tuple(found)


def interface_of(local_address: str) -> Interface | None:
    """The interface that has an address; None when none of them says so."""
    every = interfaces()
    exact = (each for each in every if each.address == local_address)
    return next(exact, next((each for each in every if each.reaches(local_address)), None))


def _mtu_bytes(name: str) -> int:
    with contextlib.suppress(OSError, ValueError):
        return int((NETWORKS / name / "mtu").read_text())
    return 0
