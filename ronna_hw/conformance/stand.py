"""Set up what is tested: a simulator of ours, a device of a theatre file, or whatever answers somewhere."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig, TheatreFile, read_theatre_file
from ronna_hw.conformance.case import Suite
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.conformance.errors import DeviceNotInFile, NoDeviceChosen
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.registry import load_driver

PERMISSIONS = ("motion", "destructive")
SIMULATOR_MODULE = "sim.cli"  # started as a command, never imported


def load_suite(kind: str) -> Suite:
    """The suite of a kind of device: tracker, robot or stereo."""
    suite: Suite = importlib.import_module(f"ronna_hw.conformance.{kind}").SUITE
    return suite


@dataclass(frozen=True)
class Choice:
    """What the command line names: exactly one of `sim`, `config` and `endpoints`, and what goes with it."""

    sim: bool = False
    config: Path | None = None  # a theatre file
    endpoints: tuple[str, ...] = ()  # URI, or NAME=URI for each of several
    driver: str | None = None  # instead of the usual one
    device: str | None = None  # which robot of the theatre file
    allow: tuple[str, ...] = ()  # of PERMISSIONS; on a simulator of ours everything is allowed
    control: str | None = None  # control port of a simulator that was started elsewhere

    def check(self) -> None:
        """Raise CNF-001 when nothing or too much is chosen, or something unknown allowed."""
        if (self.sim, self.config is not None, bool(self.endpoints)).count(True) != 1:
            raise NoDeviceChosen("what to test is not said, or said twice")
        if unknown := sorted(set(self.allow) - set(PERMISSIONS)):
            raise NoDeviceChosen(
                f"--allow knows no {', '.join(unknown)}",
                expected=" or ".join(PERMISSIONS),
                action="Correct it.",
            )


@contextmanager
def stand(suite: Suite, choice: Choice) -> Iterator[DeviceUnderTest]:
    """The device under test as chosen; whatever was started for it is ended afterwards.

    Raises CNF-001, CNF-002, CFG-00x, DEV-002, PRC-001.
    """
    choice.check()
    with ExitStack() as stack:
        name, clock = suite.kind, "host:"
        allowed = frozenset(PERMISSIONS if choice.sim else choice.allow)
        driver, control = choice.driver or suite.driver, choice.control
        if choice.config is not None:
            theatre = read_theatre_file(choice.config)
            name, chosen = _from_file(theatre, suite.kind, choice.device)
            clock = theatre.clock.endpoint
            if choice.driver is not None:
                chosen = chosen.model_copy(update={"driver": driver})
        elif choice.sim:
            child = stack.enter_context(
                ChildProcess(f"ronna-sim {suite.simulator[0]}", command(SIMULATOR_MODULE, *suite.simulator))
            )
            control = child.ready.get("control")
            addresses = child.ready.get("endpoints") or {None: child.ready["endpoint"]}
            chosen = _device(driver, addresses)
        else:
            chosen = _device(driver, _by_name(choice.endpoints))
        theatre_clock = open_clock(clock)
        known = choice.sim or choice.config is not None
        dut = DeviceUnderTest(name, chosen, theatre_clock, allowed, clock_known=known, control=control)
        stack.callback(dut.release)
        yield dut


def _device(driver: str, addresses: dict[str | None, str]) -> DeviceConfig:
    offer = getattr(load_driver(driver), "conformance_options", None)
    options: dict[str, Any] = offer() if offer is not None else {}
    for address in addresses.values():
        parse_endpoint(address)
    if None in addresses:
        return DeviceConfig(driver=driver, endpoint=addresses[None], options=options)
    named = {name: address for name, address in addresses.items() if name is not None}
    return DeviceConfig(driver=driver, endpoints=named, options=options)


def _by_name(endpoints: Sequence[str]) -> dict[str | None, str]:
    named = [_named(text) for text in endpoints]
    names = [name for name, _ in named]
    if len(named) > 1 and (None in names or len(set(names)) < len(names)):
        raise NoDeviceChosen("several endpoints need a name each", action="Write NAME=URI for each.")
    return dict(named)


def _named(text: str) -> tuple[str | None, str]:
    name, separator, address = text.partition("=")
    return (name, address) if separator and "://" not in name else (None, text)


def _from_file(theatre: TheatreFile, kind: str, device: str | None) -> tuple[str, DeviceConfig]:
    if kind == "robot":
        name = device or (next(iter(theatre.robot)) if len(theatre.robot) == 1 else None)
        if name is None or name not in theatre.robot:
            raise DeviceNotInFile(
                f"the theatre file has no robot {name or 'that is the only one'}",
                expected=", ".join(theatre.robot) or "a robot",
            )
        return f"robot.{name}", theatre.robot[name]
    chosen: DeviceConfig | None = getattr(theatre, kind)
    if chosen is None:
        raise DeviceNotInFile(f"the theatre file has no {kind}")
    return kind, chosen
