"""Search of local networks for hosts that accept connections at a port."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from ipaddress import IPv4Network
from itertools import islice

from ronna_hw.endpoints import Endpoint
from ronna_hw.host.network import Interface

KNOCK_LIMIT_S = 0.5  # a controller on the same network accepts within milliseconds
KNOCKS_AT_ONCE = 64
MOST_ADDRESSES = 1024  # of one network; a cell's has 254


def find_listening(interfaces: Sequence[Interface], port: int) -> Iterator[Endpoint]:
    """Yield the hosts on these networks that accept connections at a port."""
    hosts = [host for each in interfaces for host in list_hosts(each)]
    with ThreadPoolExecutor(KNOCKS_AT_ONCE) as pool:
        for host, is_accepted in zip(hosts, pool.map(partial(_is_listening, port), hosts), strict=True):
            if is_accepted:
                yield Endpoint("tcp", host, port)


def list_hosts(interface: Interface) -> list[str]:
    """List the host addresses on a network except our own, or only our own for loopback."""
    if interface.loopback:
        return [interface.address]
    network = IPv4Network(f"{interface.address}/{interface.prefix}", strict=False)
    return [str(host) for host in islice(network.hosts(), MOST_ADDRESSES) if str(host) != interface.address]


def describe_scan(interfaces: Sequence[Interface], what: str) -> str:
    """Describe a scan that did not find `what`; empty if no network was scanned."""
    if not (hosts := [host for each in interfaces for host in list_hosts(each)]):
        return ""
    tried = hosts[0] if len(hosts) == 1 else f"{len(hosts)} addresses, {hosts[0]} to {hosts[-1]}"
    return f"no {what} of {tried}"


def _is_listening(port: int, host: str) -> bool:
    try:
        socket.create_connection((host, port), KNOCK_LIMIT_S).close()
    except OSError:
        return False
    return True
