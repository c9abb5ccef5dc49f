"""Diagnosis of an unresponsive arm, and search for controllers on local networks."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from drivers.universal_robots.arm import UniversalRobotsArm
from drivers.universal_robots.dashboard import DashboardClient
from drivers.universal_robots.generations import GENERATIONS, arm_of_version
from drivers.universal_robots.identification import CALIBRATION
from drivers.universal_robots.options import EXAMPLE_HOST, ROLES, UrOptions
from drivers.universal_robots.rtde import RtdeSetup
from drivers.universal_robots.services import SERVICES, identify_service
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.universal_robots import UR5E
from ronna_hw.arm_stream.errors import ControllerNotFound
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Device, Identity
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
    inspect_nothing,
    reporting,
)
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.host.port_scan import describe_scan, find_listening
from ronna_hw.wire.universal_robots_services import Query

DRIVER = "universal_robots"
PORTS = {role: parse_endpoint(ROLES[role].example).port for role in ROLES}
MODEL = "model: ur5 (CB3 controller), or ur5e, ur3e, ur10e or ur16e (e-Series)."
ARM_OF_THIS_THEATRE = (
    "serial, calibration: they bind this theatre to this one arm. Remove them to accept any of the model."
)


class UrProbe:
    """Diagnosis and discovery for the Universal Robots driver."""

    table = "robot"
    endpoint_schemes = frozenset({"tcp"})
    endpoint_ports = frozenset(SERVICES)

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        """Connect, read identity and calibration, without starting anything or moving the arm."""

        def inspect_arm(device: Device, identity: Identity) -> Iterator[Diagnostic]:
            yield Diagnostic(f"{name}: factory calibration", True, dict(identity.details)[CALIBRATION])
            yield from inspect(device, identity)

        return connect_and_identify(name, config, UniversalRobotsArm, inspect=inspect_arm)

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        """Say which service of a controller answers at each endpoint; nothing is commanded."""
        return [identify_service(endpoint) for endpoint in reporting(endpoints, progress)]

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Propose every controller at the given addresses, at any port, or else on local networks."""
        given = [controller.host for controller in search.controllers]
        hosts = given or [one.host for one in find_listening(search.interfaces, PORTS["dashboard"])]
        found = []
        for host in reporting(hosts, progress):
            proposal = _make_proposal(host)
            if given or not proposal.absent:  # on a network, other machines also listen
                found.append(proposal)
        return found

    def example(self, search: Search) -> Proposal:
        absent = describe_scan(search.interfaces, f"dashboard at port {PORTS['dashboard']}")
        return Proposal(DRIVER, "", _endpoints(EXAMPLE_HOST), _options({}), (MODEL,), absent)


probe = UrProbe()


def _make_proposal(host: str) -> Proposal:
    """Propose a controller with everything known about it, even if it cannot be identified."""
    endpoints = _endpoints(host)
    chosen: dict[str, Any] = {}
    what, absent = "a Universal Robots controller", ""
    remarks: tuple[str, ...] = (MODEL,)
    try:
        model = _read_model(host)
        chosen["model"] = model
        config = DeviceConfig(driver=DRIVER, endpoints=endpoints, options=dict(chosen))
        with contextlib.closing(UniversalRobotsArm("found", config, HostClock())) as arm:
            identity = arm.connect(CONNECT_LIMIT_S)
        chosen |= {"serial": identity.serial, "calibration": dict(identity.details)[CALIBRATION]}
        what = f"a controller of {model} {identity.serial}, software {identity.firmware}"
        remarks = (ARM_OF_THIS_THEATRE,)
    except ControllerNotFound as error:
        absent = error.what
    except RonnaError as error:
        remarks = (f"It could not be identified: {error.code} {error.summary}", *remarks)
    return Proposal(DRIVER, what, endpoints, _options(chosen), remarks, absent)


def _read_model(host: str) -> str:
    """Return the model that the controller reports; of an unknown one the usual, which the driver refuses."""
    with contextlib.closing(RtdeSetup(host, PORTS["rtde"], CONNECT_LIMIT_S)) as rtde:
        major = rtde.read_version().major
    with contextlib.closing(DashboardClient(host, PORTS["dashboard"], CONNECT_LIMIT_S)) as dashboard:
        reported = dashboard.ask(Query.ROBOT_MODEL, CONNECT_LIMIT_S)
    known = (model for model, generation in GENERATIONS.items() if generation.major == major)
    usual = arm_of_version(major) or UR5E
    return next((model for model in known if find_arm(model).reported_as == reported), usual)


def _endpoints(host: str) -> dict[str, str]:
    return {role: f"tcp://{host}:{port}" for role, port in PORTS.items()}


def _options(chosen: Mapping[str, Any]) -> tuple[Option, ...]:
    return describe_options(UrOptions, {"model": UR5E, **chosen})
