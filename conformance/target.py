"""Selection and opening of the device under test."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from conformance.case import DESTRUCTIVE, HOST_TIME, LINE_FAULTS, MOTION, OUTPUT, Suite
from conformance.device_under_test import DeviceUnderTest
from conformance.errors import DEVICE_NOT_IN_FILE, NO_DEVICE_CHOSEN, NO_SIMULATOR
from conformance.protocol import ProtocolCases, compose_suite, load_driver_protocol
from ronna_hw.clock import Clock, open_clock
from ronna_hw.config import DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.devices.errors import UNKNOWN_DRIVER
from ronna_hw.devices.probing import ONLY, Option, Search
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.mistakes import suggest_keys
from ronna_hw.registry import list_driver_names, load_driver, load_finders

SIMULATOR_MODULE = "sim.cli"  # started as a command, never imported
PERMISSIONS = (MOTION.name, DESTRUCTIVE.name, OUTPUT.name)


@dataclass(frozen=True)
class DeviceChoice:
    """Command-line selection of a device: one of `sim`, `config` and `endpoints`, with its options."""

    sim: bool = False
    config: Path | None = None  # a theatre file
    endpoints: tuple[str, ...] = ()  # URI, or NAME=URI for each of several
    driver: str | None = None  # instead of the suite's
    device: str | None = None  # which robot of the theatre file
    allow: tuple[str, ...] = ()  # from PERMISSIONS; our own simulator allows everything

    def check(self) -> None:
        """Raise CNF-001 unless exactly one device is selected and every permission is known."""
        given = {"--sim": self.sim, "--config": self.config is not None, "--endpoint": bool(self.endpoints)}
        named = [option for option, is_given in given.items() if is_given]
        if len(named) != 1:
            raise NO_DEVICE_CHOSEN(
                "no single device is named",
                expected="exactly one of --sim, --config and --endpoint",
                got=" and ".join(named) or "none",
            )
        if unknown := sorted(set(self.allow) - set(PERMISSIONS)):
            raise NO_DEVICE_CHOSEN(
                f"--allow does not accept {', '.join(unknown)}",
                expected=" or ".join(PERMISSIONS),
                action="Correct it.",
            )


@dataclass(frozen=True)
class SuiteTarget:
    """Resolved device to test; `config` is None for our own simulator, whose endpoint is not yet known."""

    suite: Suite  # the generic cases, then those of the driver's wire protocol
    protocol: ProtocolCases
    name: str
    driver: str
    config: DeviceConfig | None
    clock: str  # endpoint
    clock_known: bool
    allowed: frozenset[str]


@runtime_checkable
class HasConformanceOptions(Protocol):
    """Driver class that can be tested without a theatre file."""

    @staticmethod
    def conformance_options() -> dict[str, Any]:
        """Return the driver options for a conformance run."""
        ...


def load_suite(kind: str) -> Suite:
    suite: Suite = importlib.import_module(f"conformance.{kind}").SUITE
    return suite


def resolve_target(kind: str, choice: DeviceChoice) -> SuiteTarget:
    """Resolve a command-line choice; raises CNF-001, CNF-002, CNF-006, CFG-00x, DEV-002."""
    choice.check()
    suite = load_suite(kind)
    name, clock, config = kind, "host:", None
    driver = choice.driver or suite.driver
    _require_driver(driver)
    if choice.config is not None:
        theatre = read_theatre_file(choice.config)
        name, config = _find_in_file(theatre, kind, choice.device)
        clock, driver = theatre.clock.endpoint, choice.driver or config.driver
        config = config.model_copy(update={"driver": driver})
    elif choice.endpoints:
        addresses = _parse_endpoints(choice.endpoints)
        _require_roles(kind, driver, addresses, assumed=choice.driver is None)
        config = config_for_suite(driver, addresses)
    protocol = load_driver_protocol(driver)
    if choice.sim and protocol.simulator is None:
        raise NO_SIMULATOR(f"there is no simulator for the wire protocol of {driver}")
    return SuiteTarget(
        suite=compose_suite(suite, protocol),
        protocol=protocol,
        name=name,
        driver=driver,
        config=config,
        clock=clock,
        clock_known=choice.sim or choice.config is not None,
        allowed=frozenset(PERMISSIONS if choice.sim else choice.allow),
    )


def config_for_suite(driver: str, addresses: Mapping[str | None, str]) -> DeviceConfig:
    """Build a driver configuration from its endpoints, with the key None for a single endpoint."""
    factory = load_driver(driver)
    options = factory.conformance_options() if isinstance(factory, HasConformanceOptions) else {}
    for address in addresses.values():
        parse_endpoint(address)
    if None in addresses:
        return DeviceConfig(driver=driver, endpoint=addresses[None], options=options)
    named = {name: address for name, address in addresses.items() if name is not None}
    return DeviceConfig(driver=driver, endpoints=named, options=options)


def _parse_endpoints(endpoints: Sequence[str]) -> dict[str | None, str]:
    named = []
    for text in endpoints:
        name, separator, address = text.partition("=")
        named.append((name, address) if separator and "://" not in name else (None, text))
    names = [name for name, _ in named]
    if len(named) > 1 and (None in names or len(set(names)) < len(names)):
        raise NO_DEVICE_CHOSEN("each of several endpoints needs a name", action="Write NAME=URI for each.")
    return dict(named)


def _require_driver(name: str) -> None:
    """Raise DEV-002 for an unknown driver, naming that of which it is a model."""
    known = list_driver_names()
    if name in known:
        return
    action = "Correct --driver, or install the package that provides it."
    for driver, finder in load_finders().items():
        for option in finder.example(Search()).options:
            if name in _list_choices(option):
                action = f"{name} is a {option.key} of {driver}: --driver {driver}"
                if name != option.value:
                    action += f', and --config with a theatre file whose options say {option.key} = "{name}"'
                action += "."
    raise UNKNOWN_DRIVER(
        f"no driver {name!r} is installed", expected="one of " + ", ".join(known), action=action
    )


def _list_choices(option: Option) -> list[str]:
    schema = {} if option.model is None else option.model.model_json_schema()["properties"][option.key]
    return list(schema.get("enum", []))


def _require_roles(kind: str, driver: str, addresses: Mapping[str | None, str], *, assumed: bool) -> None:
    """Raise CNF-001, with an example, unless the endpoint names match the driver's, given or `assumed`."""
    finder = load_finders().get(driver)
    wanted = {} if finder is None else finder.example(Search()).endpoints
    if not wanted or {name or ONLY for name in addresses} == set(wanted):
        return
    missing = [name for name in wanted if (name or None) not in addresses]
    unknown = [name for name in addresses if name is not None and name not in wanted]
    example = f"Example: {_format_given(wanted)}."
    raise NO_DEVICE_CHOSEN(
        f"the endpoints do not match {driver}"
        + (", which is assumed without --driver" if assumed else "")
        + "".join(f"; endpoint {name} is unknown{suggest_keys(name, missing)}" for name in unknown),
        expected=", ".join(name or "one without a name" for name in wanted),
        got=", ".join(name or "one without a name" for name in addresses),
        action=_advise_other_driver(kind, driver, addresses)
        or example + (" For another make, name its --driver." if assumed else ""),
    )


def _advise_other_driver(kind: str, driver: str, addresses: Mapping[str | None, str]) -> str:
    """Name another driver that has endpoints of these names, or one of these ports, if there is one."""
    given = [parse_endpoint(address) for address in addresses.values()]
    names = {name or ONLY for name in addresses}
    for other, finder in load_finders().items():
        examples = {role: parse_endpoint(one) for role, one in finder.example(Search()).endpoints.items()}
        services = {(one.scheme, one.port) for one in examples.values() if one.port}
        alike = any((one.scheme, one.port) in services for one in given) or names == set(examples)
        if other == driver or finder.table != kind or not alike:
            continue
        if len({one.host for one in examples.values()}) == 1:  # of one machine, which has been named
            examples = {role: replace(one, host=given[0].host) for role, one in examples.items()}
        write = _format_given({role: str(one) for role, one in examples.items()})
        return f"They look like those of {other}: --driver {other} {write}."
    return ""


def _format_given(endpoints: Mapping[str, str]) -> str:
    return " ".join(
        f"--endpoint {name}={address}" if name else f"--endpoint {address}"
        for name, address in endpoints.items()
    )


def _find_in_file(theatre: TheatreFile, kind: str, device: str | None) -> tuple[str, DeviceConfig]:
    if kind == "robot":
        name = device or (next(iter(theatre.robot)) if len(theatre.robot) == 1 else None)
        if name is None or name not in theatre.robot:
            found = (
                "several robots" if theatre.robot and not name else " ".join(("no robot", name or "")).strip()
            )
            raise DEVICE_NOT_IN_FILE(
                f"the theatre file has {found}",
                expected=", ".join(theatre.robot) or "a table such as [robot.master]",
            )
        return f"robot.{name}", theatre.robot[name]
    chosen = theatre.devices.get(kind)
    if chosen is None or device is not None:
        raise DEVICE_NOT_IN_FILE(f"the theatre file has no {' '.join(filter(None, (kind, device)))}")
    return kind, chosen


def build_device_under_test(
    name: str,
    config: DeviceConfig,
    clock: Clock,
    allowed: frozenset[str] = frozenset(),
    *,
    protocol: ProtocolCases | None = None,
    clock_known: bool = True,
) -> DeviceUnderTest:
    """Build a device under test with the allowed permissions and all other requirements that it meets."""
    dut = DeviceUnderTest(name, config, clock, clock_known=clock_known)
    dut.offers |= allowed
    if clock.paced:
        dut.offers.add(HOST_TIME.name)
    if dut.is_disturbable():
        dut.offers.add(LINE_FAULTS.name)
    if protocol is not None:
        dut.offers |= protocol.offers(dut)
    return dut


@contextmanager
def device_under_test(target: SuiteTarget) -> Iterator[DeviceUnderTest]:
    """Open the device under test for the block, starting its simulator if needed; raises PRC-001."""
    with ExitStack() as stack:
        config = target.config
        if config is None:
            assert target.protocol.simulator is not None, "resolve has checked that there is a simulator"
            arguments = target.protocol.simulator()
            child = stack.enter_context(
                ChildProcess(f"ronna-sim {arguments[0]}", command(SIMULATOR_MODULE, *arguments))
            )
            config = config_for_suite(
                target.driver, child.ready.get("endpoints") or {None: child.ready["endpoint"]}
            )
        dut = build_device_under_test(
            target.name,
            config,
            open_clock(target.clock),
            target.allowed,
            protocol=target.protocol,
            clock_known=target.clock_known,
        )
        stack.callback(dut.release)
        yield dut
