"""Network facilities of this computer: interfaces, per-process loopback addresses, and link peers."""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import sys
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path

import psutil


@dataclass(frozen=True)
class Interface:
    """IPv4 address of a network interface."""

    name: str
    address: str
    prefix: int
    mtu_bytes: int  # 0 if the system does not report it

    @property
    def loopback(self) -> bool:
        """Whether the interface is a loopback interface."""
        return IPv4Address(self.address).is_loopback

    def reaches(self, address: str) -> bool:
        """Return whether an address is in the subnet; False for host names."""
        try:
            return IPv4Address(address) in IPv4Network(f"{self.address}/{self.prefix}", strict=False)
        except ValueError:
            return False


def interfaces() -> tuple[Interface, ...]:
    """List the IPv4 addresses of all interfaces."""
    states = psutil.net_if_stats()
    return tuple(
        Interface(
            name,
            entry.address,
            IPv4Network(f"0.0.0.0/{entry.netmask or '255.255.255.255'}").prefixlen,
            states[name].mtu if name in states else 0,
        )
        for name, addresses in psutil.net_if_addrs().items()
        for entry in addresses
        if entry.family == socket.AF_INET
    )


def find_interface(local_address: str) -> Interface | None:
    """Find the interface with this address, or whose subnet contains it, or return None."""
    all_interfaces = interfaces()
    exact = (entry for entry in all_interfaces if entry.address == local_address)
    return next(exact, next((entry for entry in all_interfaces if entry.reaches(local_address)), None))


FIRST_PORT = 20_000  # below the ports that the kernel assigns itself, which start at 32768


def own_address(number: int = 0) -> str:
    """Return a loopback address unique among running processes and per `number`, 0 to 2.

    No race for free ports: the process id, at most 22 bits, determines it, and Linux answers on all of
    127.0.0.0/8.
    """
    process = os.getpid()
    return f"127.{64 * (number + 1) + (process >> 16)}.{process >> 8 & 255}.{process & 255}"


def own_udp_endpoint(number: int = 0) -> str:
    """Return a `udp://` endpoint unique among running processes and per `number`.

    For a device that must be configured with its client's address.
    """
    return f"udp://{own_address()}:{FIRST_PORT + number}"


Place = tuple[str, int]  # IPv4 address and port
ANSWERS_WITHIN_S = 0.1
_NETLINK_SOCK_DIAG = 4
_SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST = 20, 1
_ALL_STATES = 0xFFFFFFFF
_NO_COOKIE = b"\xff" * 8
_HEADER = struct.Struct("=IHHII")  # nlmsghdr: length, type, flags, sequence, port
_QUESTION = struct.Struct("=BBBxI")  # inet_diag_req_v2: family, protocol, extensions, states
_SOCKET = struct.Struct("=2s2s16s16sI8s")  # inet_diag_sockid: ports, addresses, interface, cookie
_ANSWER = struct.Struct("=4x48s12xII")  # inet_diag_msg: its socket, account, inode
_ANSWER_BYTES = 4096
_NOWHERE = ("0.0.0.0", 0)
_ACCOUNT, _INODE = 7, 9  # columns of /proc/net/tcp
_MAPPED = "0000000000000000FFFF0000"  # before an IPv4 address in IPv6, on a little-endian computer


def find_account(peer: Place, here: Place) -> int | None:
    """Return the user id of the program at `peer` connected to the listening TCP socket `here`.

    None if that end is closed, or on another computer. The kernel is asked for this one connection
    (sock_diag(7)), at a cost independent of their number. Anybody can fill /proc/net/tcp with thousands, so
    it is read only where the kernel has no sock_diag. psutil reports no account, and only processes of its
    own account.
    """
    with contextlib.suppress(OSError):
        found = _diagnosed(peer, here)
        if found is not None or _diagnosed(here, _NOWHERE) is not None:  # the second is always there
            account, inode = found or (None, 0)
            return account if inode else None  # without it its program has closed it, and its account is lost
    return _search_table(peer, here)


def _diagnosed(local: Place, remote: Place) -> tuple[int, int] | None:
    """Return the account and inode of the socket between these addresses, or None. Raises OSError."""
    addresses = (socket.inet_aton(address) for address, _ in (local, remote))
    wanted = _SOCKET.pack(*_ports(local, remote), *addresses, 0, _NO_COOKIE)
    question = _QUESTION.pack(socket.AF_INET, socket.IPPROTO_TCP, 0, _ALL_STATES) + wanted
    head = _HEADER.pack(_HEADER.size + len(question), _SOCK_DIAG_BY_FAMILY, _NLM_F_REQUEST, 0, 0)
    with socket.socket(socket.AF_NETLINK, socket.SOCK_DGRAM, _NETLINK_SOCK_DIAG) as kernel:
        kernel.settimeout(ANSWERS_WITHIN_S)
        kernel.sendto(head + question, (0, 0))
        answer = kernel.recv(_ANSWER_BYTES)
    if _HEADER.unpack_from(answer)[1] != _SOCK_DIAG_BY_FAMILY:  # an error: no such socket
        return None
    found, account, inode = _ANSWER.unpack_from(answer, _HEADER.size)
    if _SOCKET.unpack(found)[:2] != _ports(local, remote):  # a listening socket in place of a connection
        return None
    return account, inode


def _ports(*places: Place) -> tuple[bytes, ...]:
    return tuple(port.to_bytes(2, "big") for _, port in places)


def _search_table(peer: Place, here: Place) -> int | None:
    ends = [_format_place(peer), _format_place(here)]
    for table, mapped in (("tcp", ""), ("tcp6", _MAPPED)):
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
                fields = line.split()
                if fields[1:3] == [mapped + end for end in ends]:
                    return int(fields[_ACCOUNT]) if fields[_INODE] != "0" else None
    return None


def _format_place(place: Place) -> str:
    address = int.from_bytes(socket.inet_aton(place[0]), sys.byteorder)
    return f"{address:08X}:{place[1]:04X}"
