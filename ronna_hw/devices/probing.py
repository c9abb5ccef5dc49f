"""Probes find out why a device does not answer; `ronna-procedure doctor` shows the findings.

A driver's package declares its probe under the name of the driver::

    [project.entry-points."ronna_hw.probes"]
    my_tracker = "my_package.probe:probe"

A driver without one gets the default: connect, read the identity, close.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

from ronna_hw.clock import Clock, HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Device, Identity
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConnectError, RonnaError

CONNECT_LIMIT_S = 3.0  # host time
REACH_LIMIT_S = 1.0

D = TypeVar("D", bound=Device)

Progress = Callable[[float], None]  # called with the fraction done, 0 to 1


@dataclass(frozen=True)
class Diagnostic:
    """One line: what was checked, whether it is OK, what was observed, what to do.

    `document` contains the same in numbers and bytes, ready for JSON; `section` is the list in the doctor's
    JSON that it belongs to, such as `lines` or `cameras`. `serials` are those of the devices that replied,
    by endpoint; None where nothing did.
    """

    subject: str
    well: bool
    seen: str
    advice: str = ""
    section: str = ""
    document: Mapping[str, Any] | None = None
    serials: Mapping[str, str | None] = field(default_factory=dict)


def refusal(subject: str, error: RonnaError) -> Diagnostic:
    """A device's refusal as a diagnostic."""
    return Diagnostic(subject, False, f"{error.code} {error.summary}", error.advice)


Inspection = Callable[[Device, Identity], Iterable[Diagnostic]]  # further checks on a connected device


def leave_alone(_device: Device, _identity: Identity) -> Iterable[Diagnostic]:
    """No further checks."""
    return ()


class Probe(Protocol):
    """Checks one device of a theatre file."""

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = leave_alone
    ) -> Sequence[Diagnostic]:
        """The findings, in reading order; never raises, whatever the device does.

        Talks only to the endpoints of `config`, in bounded time; nothing moves and no setting stays changed.
        The findings of `inspect` on the connected device are appended: a device accepts one client at a time.
        """
        ...


@runtime_checkable
class EndpointProbe(Probe, Protocol):
    """A probe that needs no theatre file: it can also check bare endpoints."""

    @property
    def endpoint_schemes(self) -> frozenset[str]:
        """Schemes that it can check, such as `serial`."""
        ...

    def look_at(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        """Like a call, but without the driver itself: what is at each endpoint?"""
        ...


def connect_and_leave(
    name: str,
    config: DeviceConfig,
    make_device: Callable[[str, DeviceConfig, Clock], D],
    advice: str = "",
    inspect: Inspection = leave_alone,
) -> tuple[Diagnostic, ...]:
    """Connect as a procedure would, read the identity, run `inspect`, and close.

    `advice` is what to do if that fails, when the caller knows better than the driver's error.
    """
    endpoints = endpoints_of(config)
    addresses = ", ".join(map(str, endpoints))
    subject = f"device {name}"
    try:
        device = make_device(name, config, HostClock())
        try:
            identity = device.connect(CONNECT_LIMIT_S)
            found = tuple(inspect(device, identity))
        finally:
            device.close()
    except RonnaError as error:
        if isinstance(error, ConnectError):  # a wrong configuration has its own advice
            advice = advice or next(filter(None, map(why_unreachable, endpoints)), "")
        advice = advice or error.advice
        return (Diagnostic(subject, False, f"{addresses}: {error.code} {error.summary}", advice),)
    seen = f"{addresses}: {identity.model} {identity.serial} {identity.firmware}"
    return (Diagnostic(subject, True, seen), *found)


def endpoints_of(config: DeviceConfig) -> tuple[Endpoint, ...]:
    """All endpoints of a device, in the order of its theatre file."""
    texts = config.endpoints.values() if config.endpoint is None else (config.endpoint,)
    return tuple(parse_endpoint(text) for text in texts)


def why_unreachable(endpoint: Endpoint) -> str:
    """Why a TCP endpoint accepts no connection, as advice; empty if it does, and for other endpoints."""
    if endpoint.scheme != "tcp":
        return ""
    try:
        socket.create_connection((endpoint.host, endpoint.port), REACH_LIMIT_S).close()
    except ConnectionRefusedError:
        return f"Nothing listens at {endpoint}: is the device on, its server program running, the port right?"
    except OSError as error:
        return f"{endpoint} is unreachable ({error.strerror or error}): check cable and subnet."
    return ""
