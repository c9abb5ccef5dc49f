"""The account of this computer that has the other end of a connection.

The kernel is asked for one connection (sock_diag(7)), which costs the same however many there are: anybody
can have thousands listed in /proc/net/tcp, and would hold up whoever reads that for each connection. It is
read only where the kernel has no sock_diag. psutil reports no account, and processes only of its own one.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import sys
from pathlib import Path

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


def account_at(peer: Place, here: Place) -> int | None:
    """The user id of the program at `peer` of a TCP connection to the listening socket `here`.

    None if that end is closed, or elsewhere.
    """
    with contextlib.suppress(OSError):
        found = _diagnosed(peer, here)
        if found is not None or _diagnosed(here, _NOWHERE) is not None:  # the second is always there
            account, inode = found or (None, 0)
            return account if inode else None  # without it its program has closed it, and its account is lost
    return _listed(peer, here)


def _diagnosed(local: Place, remote: Place) -> tuple[int, int] | None:
    """Account and inode of the socket with these ends; None if there is none. Raises OSError."""
    wanted = _SOCKET.pack(*_ports(local, remote), *_addresses(local, remote), 0, _NO_COOKIE)
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


def _addresses(*places: Place) -> tuple[bytes, ...]:
    return tuple(socket.inet_aton(address) for address, _ in places)


def _listed(peer: Place, here: Place) -> int | None:
    ends = [_in_list(peer), _in_list(here)]
    for table, mapped in (("tcp", ""), ("tcp6", _MAPPED)):
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
                fields = line.split()
                if fields[1:3] == [mapped + end for end in ends]:
                    return int(fields[_ACCOUNT]) if fields[_INODE] != "0" else None
    return None


def _in_list(place: Place) -> str:
    address = int.from_bytes(socket.inet_aton(place[0]), sys.byteorder)
    return f"{address:08X}:{place[1]:04X}"
