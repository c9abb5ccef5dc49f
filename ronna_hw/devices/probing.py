"""Probes for finding devices and diagnosing unresponsive ones.

`ronna-procedure doctor` and `new-theatre` show the findings. A driver's package declares its probe under the
name of the driver::

    [project.entry-points."ronna_hw.probes"]
    my_tracker = "my_package.probe:probe"

A driver without one gets the default: connect, read the identity, close. A probe may also be a `Finder`,
which searches lines and networks and proposes entries of a theatre file.
"""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar, runtime_checkable

from pydantic import BaseModel

from ronna_hw.clock import Clock, HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import TellsReadiness
from ronna_hw.devices.lifecycle import Device, Identity
from ronna_hw.devices.readings import StereoReading, Validity
from ronna_hw.devices.sensors import StereoPair
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConnectError, RonnaError
from ronna_hw.host.network import Interface
from ronna_hw.host.processor import describe_load

CONNECT_LIMIT_S = 3.0  # host time
REACH_LIMIT_S = 1.0

D = TypeVar("D", bound=Device)
T = TypeVar("T")

Progress = Callable[[float], None]  # called with the fraction done, 0 to 1


@dataclass(frozen=True)
class Diagnostic:
    """Doctor finding: subject, verdict, observation, advice.

    `command` is one that a person can copy, and that solves the problem or says more about it.
    `document` contains the same in numbers and bytes, ready for JSON; `section` is the list in the doctor's
    JSON that it belongs to, such as `lines` or `cameras`. `serials` are those of the devices that replied, by
    endpoint; None where nothing did. An `explained` one has its cause told by another finding.
    """

    subject: str
    well: bool
    seen: str
    advice: str = ""
    section: str = ""
    document: Mapping[str, Any] | None = None
    serials: Mapping[str, str | None] = field(default_factory=dict)
    command: str = ""
    explained: bool = False


def refusal(subject: str, error: RonnaError) -> Diagnostic:
    """Report a device's refusal as a diagnostic."""
    return Diagnostic(subject, False, f"{error.code} {error.summary}", error.advice)


def fact_diagnostics(subject: str, device: TellsReadiness) -> Iterator[Diagnostic]:
    """Report each fact as a doctor finding, with advice if it prevents a case."""
    for fact in device.readiness():
        yield Diagnostic(f"{subject}{fact.name}", fact.ready, fact.found, "" if fact.ready else fact.advice)


def reporting(items: Sequence[T], progress: Progress) -> Iterator[T]:
    """Yield the items, and report the fraction of them that is done after each."""
    for number, item in enumerate(items, start=1):
        yield item
        progress(number / len(items))


Inspection = Callable[[Device, Identity], Iterable[Diagnostic]]  # further checks on a connected device


def inspect_nothing(_device: Device, _identity: Identity) -> Iterable[Diagnostic]:
    """Perform no further checks."""
    return ()


class Probe(Protocol):
    """Diagnosis of a device in a theatre file."""

    def __call__(
        self, name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
    ) -> Sequence[Diagnostic]:
        """Return the findings in reading order; never raises, whatever the device does.

        Talks only to the endpoints of `config`, in bounded time; nothing moves and no setting stays changed.
        The findings of `inspect` on the connected device are appended: a device accepts one client at a time.
        """


@runtime_checkable
class EndpointProbe(Probe, Protocol):
    """Probe that can also check bare endpoints, without a theatre file."""

    @property
    def endpoint_schemes(self) -> frozenset[str]:
        """Endpoint schemes that the probe can check, such as `serial`."""

    def probe_endpoints(self, endpoints: Sequence[Endpoint], progress: Progress) -> Sequence[Diagnostic]:
        """Identify the device at each endpoint without using the driver."""


@runtime_checkable
class PortProbe(EndpointProbe, Protocol):
    """Probe of a device whose ports are fixed: it checks endpoints at these, and no other probe does."""

    @property
    def endpoint_ports(self) -> frozenset[int]:
        """Ports of the endpoints that the probe can check."""


def connect_and_identify(
    name: str,
    config: DeviceConfig,
    make_device: Callable[[str, DeviceConfig, Clock], D],
    advice: str = "",
    inspect: Inspection = inspect_nothing,
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
            named = [one for one in endpoints if str(one) in error.summary]
            advice = advice or next(filter(None, map(explain_unreachable, (*named, *endpoints))), "")
        advice = advice or error.advice
        return (Diagnostic(subject, False, f"{addresses}: {error.code} {error.summary}", advice),)
    seen = f"{addresses}: {identity.model} {identity.serial} {identity.firmware}"
    return (Diagnostic(subject, True, seen), *found)


def endpoints_of(config: DeviceConfig) -> tuple[Endpoint, ...]:
    """Return all endpoints of a device in theatre file order."""
    texts = config.endpoints.values() if config.endpoint is None else (config.endpoint,)
    return tuple(parse_endpoint(text) for text in texts)


def explain_unreachable(endpoint: Endpoint) -> str:
    """Explain why a TCP endpoint refuses connections; empty if it accepts them or is not TCP."""
    if endpoint.scheme not in ("tcp", "igtl"):
        return ""
    try:
        socket.create_connection((endpoint.host, endpoint.port), REACH_LIMIT_S).close()
    except ConnectionRefusedError:
        return f"Nothing listens at {endpoint}: is the device on, its server program running, the port right?"
    except OSError as error:
        return f"{endpoint} is unreachable ({error.strerror or error}): check cable and subnet."
    return ""


ONLY = ""  # role of the endpoint of a device with only one


@dataclass(frozen=True)
class Search:
    """Scope of a device search; nothing is sent to any other line, network or address."""

    interfaces: tuple[Interface, ...] = ()
    lines: tuple[Endpoint, ...] = ()  # of trackers, serial or TCP
    controllers: tuple[Endpoint, ...] = ()  # of robots; without any, the networks of `interfaces`
    stream: Endpoint | None = None  # where a robot's telegrams should arrive, if already decided


@dataclass(frozen=True)
class Option:
    """Driver option with its purpose, and its value if it differs from the default."""

    key: str
    value: Any  # as in TOML; None if it has no default
    chosen: bool
    meaning: str
    model: type[BaseModel] | None = None  # of all options of that driver, for validating a value


@dataclass(frozen=True)
class Proposal:
    """Proposed theatre file entry for a device."""

    driver: str
    what: str  # what was found, in words; empty for an example
    endpoints: Mapping[str, str]
    options: tuple[Option, ...] = ()
    remarks: tuple[str, ...] = ()  # what a person should check or complete
    absent: str = ""  # why there is no such device at the given address, if there is none


@runtime_checkable
class Finder(Protocol):
    """Probe that can also search. `table` is the theatre file table: `tracker`, `robot` or `stereo`."""

    table: str

    def find(self, search: Search, progress: Progress) -> Sequence[Proposal]:
        """Find all devices of this kind, and explain why any other given address failed.

        Nothing moves and no setting is changed.
        """

    def example(self, search: Search) -> Proposal:
        """Return an example table, with placeholder addresses, for a device that was not found."""


def describe_options(model: type[BaseModel], chosen: Mapping[str, Any]) -> tuple[Option, ...]:
    """Describe a driver's options, including the chosen values."""
    return tuple(
        Option(
            name,
            chosen.get(name, None if field.is_required() else field.get_default(call_default_factory=True)),
            name in chosen,
            field.description or "",
            model,
        )
        for name, field in model.model_fields.items()
    )


PAIRS_OF_A_CASE = 200  # of five spheres for three trajectories, with some searching
MOST_FAILED_PAIRS = 0.02  # in a case, expected: each ends it


def _advise_on_lost_pairs(lost: Collection[Validity]) -> str:
    """Advise on pairs that did not arrive complete: their packets were lost, or they came late."""
    load = describe_load()
    advice = [f"This computer has {load}: end what else runs on it, then look again."] if load else []
    if not {Validity.PARTIAL, Validity.MISSING, Validity.CORRUPT}.isdisjoint(lost):
        advice.append("Packets are lost: jumbo frames, cable, switch, receive buffer.")
    if not {Validity.UNPAIRED, Validity.STALE}.isdisjoint(lost):
        advice.append(
            "Images come late, or by another trigger: a loaded computer or network, the trigger's cable."
        )
    return " ".join(advice)


def picture_diagnostics(
    subject: str,
    stereo: StereoPair,
    pairs: int,
    tries: int,
    judge: Callable[[StereoReading], Iterator[Diagnostic]],
) -> Iterator[Diagnostic]:
    """Take `pairs` image pairs with configured cameras and report whether enough arrive complete.

    A case repeats a lost pair, up to `tries` times in all. `judge` reports on the last pair. Nothing moves.
    """
    arrived: Counter[Validity] = Counter()
    last: StereoReading | None = None
    found: tuple[Diagnostic, ...] = ()
    try:
        with stereo.active():
            for _ in range(pairs):
                last = stereo.grab_pair()
                arrived[last.validity] += 1
            if isinstance(stereo, TellsReadiness):
                found = tuple(fact_diagnostics(subject, stereo))  # about these images
    except RonnaError as error:
        yield refusal(f"{subject}pictures", error)
        return
    complete_pairs = arrived.pop(Validity.OK, 0)
    others = "".join(f", {count} {validity}" for validity, count in arrived.items())
    expected_failures = PAIRS_OF_A_CASE * (1.0 - complete_pairs / pairs) ** tries
    yield Diagnostic(
        f"{subject}pictures",
        expected_failures <= MOST_FAILED_PAIRS,
        f"{complete_pairs} of {pairs} pairs arrived complete{others}",
        _advise_on_lost_pairs(arrived) if arrived else "",
    )
    yield from found
    if last is not None:
        yield from judge(last)
