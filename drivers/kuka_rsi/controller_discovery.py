"""Controllers on the searched networks, each as a theatre file entry."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from ipaddress import IPv4Network
from itertools import islice

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.errors import BadEkiTelegram, ControllerNotFound, NoAnswer
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.kr6_r900 import ArmVariant
from ronna_hw.devices.probing import CONNECT_LIMIT_S, Option, Progress, Proposal, Search, documented_options
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.network import Interface
from ronna_hw.wire.kuka_context import load_context
from ronna_hw.wire.kuka_eki import PROJECT_PORT

DRIVER = "kuka_rsi"
EXAMPLE_CONTROLLER = f"tcp://172.31.1.147:{PROJECT_PORT}"  # default address of a KR C4
KNOCK_LIMIT_S = 0.5  # a controller on the same network accepts within milliseconds
KNOCKS_AT_ONCE = 64
MOST_ADDRESSES = 1024  # of one network; a cell's has 254
VARIANT = "variant: see the name plate. The two variants of this arm differ by 10 mm in two links."
STREAM = (
    "rsi: the address to which the controller sends its telegrams, IP_NUMBER and PORT of the Ethernet file."
)


def find_controllers(search: Search, progress: Progress) -> Sequence[Proposal]:
    """Every controller with our EKI server: at the given addresses, or else on the networks.

    A controller serves one EKI client at a time; one that serves another is found but not identified.
    """
    known = search.controllers or tuple(_listening(search.interfaces))
    found = []
    for number, controller in enumerate(known, start=1):
        proposal = _proposal(controller, stream_of(search))
        if search.controllers or not proposal.absent:  # on a network, other machines also listen
            found.append(proposal)
        progress(number / len(known))
    return found


def example_arm(search: Search) -> Proposal:
    """The table for an arm that was not found."""
    return Proposal(
        DRIVER, "", _endpoints(EXAMPLE_CONTROLLER, stream_of(search)), _options(), (VARIANT, STREAM)
    )


def stream_of(search: Search) -> str:
    """Receiving address for telegrams: as given, or as in the shipped Ethernet file."""
    ethernet = load_context().ethernet
    return str(search.stream or Endpoint("udp", ethernet.pc_ip, ethernet.pc_port))


def _listening(interfaces: Sequence[Interface]) -> Iterator[Endpoint]:
    """Addresses on the networks that accept a connection on the port of our EKI server."""
    hosts = [host for each in interfaces for host in _hosts(each)]
    with ThreadPoolExecutor(KNOCKS_AT_ONCE) as pool:
        for host, taken in zip(hosts, pool.map(_listens, hosts), strict=True):
            if taken:
                yield Endpoint("tcp", host, PROJECT_PORT)


def _hosts(interface: Interface) -> list[str]:
    """Addresses of one network except our own; on loopback only its own."""
    if interface.loopback:
        return [interface.address]
    network = IPv4Network(f"{interface.address}/{interface.prefix}", strict=False)
    return [str(host) for host in islice(network.hosts(), MOST_ADDRESSES) if str(host) != interface.address]


def _listens(host: str) -> bool:
    try:
        socket.create_connection((host, PROJECT_PORT), KNOCK_LIMIT_S).close()
    except OSError:
        return False
    return True


def _proposal(controller: Endpoint, stream: str) -> Proposal:
    """As far as it can be identified: one that serves another client, or is silent, is also proposed."""
    remarks: tuple[str, ...] = (VARIANT, STREAM)
    what, variant, absent = "a controller", None, ""
    try:
        with contextlib.closing(EkiClient(controller.host, controller.port, CONNECT_LIMIT_S)) as eki:
            state = eki.status(CONNECT_LIMIT_S)
        known = {each.value for each in ArmVariant}
        variant = state.variant if state.variant in known else None
        what = f"a controller of {state.variant or 'an arm that it does not identify'}, in mode {state.mode}"
        remarks = (STREAM,) if variant else remarks
    except (ControllerNotFound, NoAnswer, BadEkiTelegram) as error:
        absent = error.what
        if not isinstance(error, ControllerNotFound):
            absent += ": it is not the EKI server of the project's files"
    except RonnaError as error:
        remarks = (f"It could not be identified: {error.code} {error.summary}", *remarks)
    return Proposal(DRIVER, what, _endpoints(str(controller), stream), _options(variant), remarks, absent)


def _endpoints(controller: str, stream: str) -> dict[str, str]:
    return {"rsi": stream, "eki_project": controller}


def _options(variant: str | None = None) -> tuple[Option, ...]:
    return documented_options(KukaOptions, {"variant": variant or ArmVariant.SIXX.value})
