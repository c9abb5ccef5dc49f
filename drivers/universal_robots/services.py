"""Recognition of a controller's services at endpoints that no theatre file names."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Mapping
from typing import NamedTuple

from drivers.universal_robots.dashboard import DashboardClient
from drivers.universal_robots.errors import STREAM_ERRORS
from drivers.universal_robots.primary.client import PrimaryClient
from drivers.universal_robots.primary.packages import LONGEST_PACKAGE_BYTES
from drivers.universal_robots.rtde import RtdeSetup
from ronna_hw.config import BadTheatreFile
from ronna_hw.devices.probing import CONNECT_LIMIT_S, Diagnostic, explain_unreachable
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.wire import universal_robots as wire
from ronna_hw.wire.universal_robots_services import Query

SECTION = "controllers"
SIZE_BYTES = 4  # with which every package of the client interfaces begins


class Service(NamedTuple):
    """Service of a controller: its role in a theatre file, if any, and what it says when asked."""

    name: str
    role: str
    ask: Callable[[Endpoint], str]  # raises a `RonnaError` if it is no such service


def _ask_dashboard(endpoint: Endpoint) -> str:
    client = DashboardClient(endpoint.host, endpoint.port, CONNECT_LIMIT_S)
    with contextlib.closing(client):
        model = client.ask(Query.ROBOT_MODEL, CONNECT_LIMIT_S)
        return f"arm {model}, {client.robot_mode(CONNECT_LIMIT_S).name}"


def _read_primary(endpoint: Endpoint) -> str:
    with contextlib.closing(PrimaryClient(endpoint.host, endpoint.port, CONNECT_LIMIT_S)) as client:
        client.await_state(CONNECT_LIMIT_S)
    return "it sends the arm's state"


def _read_size(endpoint: Endpoint) -> str:
    try:
        with socket.create_connection((endpoint.host, endpoint.port), CONNECT_LIMIT_S) as connection:
            size = int.from_bytes(connection.recv(SIZE_BYTES, socket.MSG_WAITALL), "big")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise STREAM_ERRORS.not_found(f"{endpoint} sends no package ({reason})") from error
    if not SIZE_BYTES < size <= LONGEST_PACKAGE_BYTES:
        raise STREAM_ERRORS.not_found(f"{endpoint} sends a package of {size} bytes, which none has")
    return "it sends the arm's state"


def _ask_rtde(endpoint: Endpoint) -> str:
    with contextlib.closing(RtdeSetup(endpoint.host, endpoint.port, CONNECT_LIMIT_S)) as rtde:
        return f"software {rtde.read_version()}"


SERVICES = {  # by their ports, which the controller has fixed
    wire.DASHBOARD_PORT: Service("dashboard", "dashboard", _ask_dashboard),
    wire.PRIMARY_PORT: Service("primary interface", "primary", _read_primary),
    wire.SECONDARY_PORT: Service("secondary interface", "", _read_size),
    wire.REALTIME_PORT: Service("real-time interface", "", _read_size),
    wire.RTDE_PORT: Service("RTDE server", "rtde", _ask_rtde),
    wire.READ_ONLY_PRIMARY_PORT: Service("read-only primary interface", "", _read_size),
    wire.READ_ONLY_SECONDARY_PORT: Service("read-only secondary interface", "", _read_size),
    wire.READ_ONLY_REALTIME_PORT: Service("read-only real-time interface", "", _read_size),
}


def require_own_services(device: str, addresses: Mapping[str, Endpoint]) -> None:
    """Raise CFG-001 for an endpoint at the fixed port of another service, or services of two controllers."""
    for role, address in addresses.items():
        if (service := SERVICES.get(address.port)) is not None and service.role != role:
            own = next(port for port, one in SERVICES.items() if one.role == role)
            raise BadTheatreFile(
                f"[{device}.endpoints] {role}: port {address.port} is that of the {service.name}",
                expected=f"port {own}, the {SERVICES[own].name}",
            )
    hosts = {role: address.host for role, address in addresses.items()}
    if len(set(hosts.values())) > 1:
        raise BadTheatreFile(
            f"[{device}.endpoints]: not all endpoints are at one controller",
            expected="one host for all of them, written alike",
            got=", ".join(f"{role} at {host}" for role, host in hosts.items()),
        )


def identify_service(endpoint: Endpoint) -> Diagnostic:
    """Say which service of a controller answers at an endpoint with one of the fixed ports."""
    service = SERVICES[endpoint.port]
    try:
        well, seen = True, f"the {service.name} of a Universal Robots controller: {service.ask(endpoint)}"
        advice = (
            f"It is endpoint {service.role} of [robot.master] with driver universal_robots"
            if service.role
            else "Driver universal_robots needs other services of it"
        ) + "; this command writes its table:"
        command = f"ronna-procedure new-theatre --controller {endpoint.host}"
    except RonnaError as error:
        well, seen, command = False, f"{error.code} {error.summary}", ""
        advice = explain_unreachable(endpoint) or (
            f"Port {endpoint.port} is that of a Universal Robots controller's {service.name}: {error.advice}"
        )
    document = {"endpoint": str(endpoint), "well": well, "service": service.name if well else None}
    return Diagnostic(f"endpoint {endpoint}", well, seen, advice, SECTION, document, command=command)
