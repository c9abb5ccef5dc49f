"""Diagnosis of an unresponsive arm and search for controllers on local networks.

A controller serves one EKI client at a time and needs a moment before the next, so there is only one
connection, the driver's own.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Sequence

from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.options import EXAMPLE_CONTROLLER, KukaOptions
from drivers.kuka_rsi.realtime.sockets import bind
from ronna_hw.arm.catalogue import ARMS, KUKA
from ronna_hw.arm.kr6_r900 import SIXX
from ronna_hw.arm_stream.errors import ControllerNotFound, MalformedMessage, NoAnswer
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import (
    CONNECT_LIMIT_S,
    Diagnostic,
    Inspection,
    Option,
    Progress,
    Proposal,
    Search,
    connect_and_identify,
    describe_options,
    endpoints_of,
    inspect_nothing,
    reporting,
)
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.port_scan import describe_scan, find_listening
from ronna_hw.host.port_users import LEAVE_A_CASE_ALONE, find_udp_port_user
from ronna_hw.wire.kuka_context import load_context
from ronna_hw.wire.kuka_eki import PROJECT_PORT

DRIVER = "kuka_rsi"
VARIANT = "variant: see the name plate. The two variants of this arm differ by 10 mm in two links."
STREAM = (
    "rsi: the address to which the controller sends its telegrams, IP_NUMBER and PORT of the Ethernet file."
)


class KukaProbe:
    """Diagnosis and discovery for the KUKA driver."""

    table = "robot"

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        """Check the stream port, then the controller, without sending telegrams or moving the arm."""
        streams = [endpoint for endpoint in endpoints_of(config) if endpoint.scheme == "udp"]
        ports = tuple(map(stream_port_diagnostic, streams))  # before the driver itself listens there
        return (*ports, *connect_and_identify(name, config, KukaRsiArm, inspect=inspect))

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Propose every controller with our EKI server, at the given addresses or else on local networks.

        A controller serves one EKI client at a time; one that serves another is found but not identified.
        """
        known = search.controllers or tuple(find_listening(search.interfaces, PROJECT_PORT))
        found = []
        for controller in reporting(known, progress):
            proposal = _make_proposal(controller, stream_address(search))
            if search.controllers or not proposal.absent:  # on a network, other machines also listen
                found.append(proposal)
        return found

    def example(self, search: Search) -> Proposal:
        endpoints = _endpoints(EXAMPLE_CONTROLLER, stream_address(search))
        absent = describe_scan(search.interfaces, f"EKI server of ours at port {PROJECT_PORT}")
        return Proposal(DRIVER, "", endpoints, _options(), (VARIANT, STREAM), absent)


probe = KukaProbe()


def stream_port_diagnostic(endpoint: Endpoint) -> Diagnostic:
    """Check whether the driver can bind its stream port."""
    subject = f"stream port {endpoint}"
    try:
        bind(endpoint.host, endpoint.port).close()
    except OSError as error:
        return Diagnostic(subject, False, *_describe_refusal(endpoint, error))
    return Diagnostic(subject, True, "free for the driver to listen on")


def _describe_refusal(endpoint: Endpoint, error: OSError) -> tuple[str, str]:
    """Explain why a port cannot be bound, and advise."""
    if error.errno == errno.EADDRINUSE:
        if user := find_udp_port_user(endpoint.host, endpoint.port):
            return f"in use by {user}", f"{LEAVE_A_CASE_ALONE} Otherwise stop it."
        advice = f"Find it with: sudo ss -ulnp 'sport = {endpoint.port}'"
        return "in use by a program not visible to this user", advice
    if error.errno == errno.EADDRNOTAVAIL:
        advice = "Give the network card towards the controller the address in the Ethernet file (IP_NUMBER)."
        return f"{endpoint.host} is not an address of this computer", advice
    if error.errno == errno.EACCES:
        advice = "Ports below 1024 are reserved: choose another, here and in the Ethernet file."
        return "permission denied", advice
    return error.strerror or str(error), "Give an IPv4 address of this computer."


def stream_address(search: Search) -> str:
    """Return the receiving address for telegrams, by default from the shipped Ethernet file."""
    ethernet = load_context().ethernet
    return str(search.stream or Endpoint("udp", ethernet.pc_ip, ethernet.pc_port))


def _make_proposal(controller: Endpoint, stream: str) -> Proposal:
    """Propose a controller with everything known about it, even if it cannot be identified."""
    remarks: tuple[str, ...] = (VARIANT, STREAM)
    what, variant, absent = "a controller", None, ""
    try:
        with contextlib.closing(EkiClient(controller.host, controller.port, CONNECT_LIMIT_S)) as eki:
            state = eki.status(CONNECT_LIMIT_S)
        known = {arm.reported_as: arm.name for arm in ARMS.values() if arm.make == KUKA}
        variant = known.get(state.variant or "")
        what = f"a controller of {state.variant or 'an arm that it does not identify'}, in mode {state.mode}"
        remarks = (STREAM,) if variant else remarks
    except (ControllerNotFound, NoAnswer, MalformedMessage) as error:
        absent = error.what
        if not isinstance(error, ControllerNotFound):
            absent += ": it is not the EKI server of the project's files"
    except RonnaError as error:
        remarks = (f"It could not be identified: {error.code} {error.summary}", *remarks)
    return Proposal(DRIVER, what, _endpoints(str(controller), stream), _options(variant), remarks, absent)


def _endpoints(controller: str, stream: str) -> dict[str, str]:
    return {"rsi": stream, "eki_project": controller}


def _options(variant: str | None = None) -> tuple[Option, ...]:
    return describe_options(KukaOptions, {"variant": variant or SIXX})
