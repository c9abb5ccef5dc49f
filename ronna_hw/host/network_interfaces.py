"""The network interfaces of this computer: name, IPv4 address, MTU."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network

import psutil


@dataclass(frozen=True)
class Interface:
    """One IPv4 address of a network interface."""

    name: str
    address: str
    prefix: int
    mtu_bytes: int  # 0 if the system does not report it

    @property
    def loopback(self) -> bool:
        """Whether it is the network inside this computer."""
        return IPv4Address(self.address).is_loopback

    def reaches(self, address: str) -> bool:
        """Whether an address is in its own subnet; False for a host name."""
        try:
            return IPv4Address(address) in IPv4Network(f"{self.address}/{self.prefix}", strict=False)
        except ValueError:
            return False


def interfaces() -> tuple[Interface, ...]:
    """All interfaces with an IPv4 address."""
    states = psutil.net_if_stats()
    return tuple(
        Interface(name, each.address, _prefix(each.netmask), states[name].mtu if name in states else 0)
        for name, addresses in psutil.net_if_addrs().items()
        for each in addresses
        if each.family == socket.AF_INET
    )


def interface_of(local_address: str) -> Interface | None:
    """The interface with that address, or else the one whose subnet contains it; None if there is none."""
    every = interfaces()
    exact = (each for each in every if each.address == local_address)
    return next(exact, next((each for each in every if each.reaches(local_address)), None))


def _prefix(netmask: str | None) -> int:
    return IPv4Network(f"0.0.0.0/{netmask or '255.255.255.255'}").prefixlen
