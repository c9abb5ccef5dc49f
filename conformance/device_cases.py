"""Cases that every device must pass, and checks shared by the suites.

The cases: activation for a block, observation from outside, a probe. The checks: interface, lifecycle,
refusals, closing.
"""

from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from conformance.case import Nonconformity, SuiteCase, check, refused
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.devices.lifecycle import Device, Identity, LastKnown, Lifecycle
from ronna_hw.errors import ConfigurationError, ConnectError, StateError
from ronna_hw.registry import load_probe

SLACK_S = 1.5  # on top of a time limit, for a busy computer


@contextmanager
def ends_within(limit_s: float) -> Iterator[None]:
    """Require the block to end within `limit_s` of host time."""
    began_s = time.monotonic()
    yield
    elapsed_s = time.monotonic() - began_s
    check(elapsed_s < limit_s, f"an end within {limit_s:g} s", f"{elapsed_s:.1f} s")


def check_interface(dut: DeviceUnderTest, interface: type[Any]) -> None:
    """Check that a new driver implements the full interface, has its given name and is not connected."""
    device = dut.make()
    check(isinstance(device, interface), f"all calls of {interface.__name__}", type(device).__name__)
    check(device.state is Lifecycle.DISCONNECTED, "state disconnected", device.state)
    check(device.name == dut.name, f"the name {dut.name}", device.name)


def check_identity(dut: DeviceUnderTest) -> tuple[Any, Identity]:
    """Connect a new device and check that its identity includes vendor and model; returns both."""
    device = dut.make()
    identity: Identity = device.connect()
    check(bool(identity.vendor and identity.model), "vendor and model", identity)
    check(device.state is Lifecycle.CONNECTED, "state connected", device.state)
    return device, identity


def check_early_calls(dut: DeviceUnderTest, disconnected: Sequence[str], connected: Sequence[str]) -> Any:
    """Check that premature calls are refused; returns the connected device."""
    device = dut.make()
    for call in disconnected:
        refused(getattr(device, call), StateError, f"{call} while disconnected")
    device.connect()
    for call in connected:
        refused(getattr(device, call), StateError, f"{call} while connected")
    return device


def check_closing(device: Device, limit_s: float) -> None:
    with ends_within(limit_s):
        device.close()
    check(device.state is Lifecycle.CLOSED, "state closed", device.state)
    device.close()
    refused(device.connect, StateError, "connect after close")


def check_connect_failure(device: Device, limit_s: float) -> None:
    """Check that connecting without a device at the endpoint fails in time, with code and advice."""
    try:
        with ends_within(limit_s + SLACK_S):
            error = refused(lambda: device.connect(limit_s), ConnectError, "connecting without a device")
    finally:
        device.close()
    check(bool(error.code and error.advice), "an error with code and advice", error)


def check_connect_nowhere(dut: DeviceUnderTest, limit_s: float) -> None:
    """Check that connecting fails properly when every driver address points nowhere."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        nowhere = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    endpoint = dut.config.endpoint
    if endpoint is not None:
        changes: dict[str, Any] = {
            "endpoint": "serial:///dev/no-such-port" if endpoint.startswith("serial:") else nowhere
        }
    else:
        changes = {
            "endpoints": {
                name: nowhere if address.startswith("tcp:") else address
                for name, address in dut.config.endpoints.items()
            }
        }
    check_connect_failure(dut.make(**changes), limit_s)


def check_unknown_option(dut: DeviceUnderTest) -> None:
    options = {**dut.config.options, "no_such_option": 1}
    refused(lambda: dut.make(options=options), ConfigurationError, "an unknown option")


OBSERVE_LIMIT_S = 1.0  # observing takes microseconds; the rest is for a busy computer
READINGS = 3


class Interruption(Exception):
    """Exception raised by a case to interrupt a block."""


@dataclass(frozen=True)
class DeviceCases:
    """Generic cases for one kind of device: `read` takes a reading, `limit_s` limits the stopping time."""

    read: Callable[[Any], object]
    limit_s: float

    def build_cases(self, letter: str, first: int) -> list[SuiteCase]:
        """Build the cases, numbered consecutively from `first`."""
        runs = (
            ("a block makes a disconnected device active and leaves it configured", self.active_block),
            (
                "a block left by an exception deactivates the device and lets the exception through",
                self.interruption,
            ),
            ("observing works in every state, from any thread, and changes nothing", self.observation),
            ("the driver's probe recognizes the device and disconnects", self.probe),
        )
        return [
            SuiteCase(f"{letter}{number:02d}", statement, (), run)
            for number, (statement, run) in enumerate(runs, first)
        ]

    def active_block(self, dut: DeviceUnderTest) -> None:
        device = dut.make()
        for _ in range(2):  # from disconnected, then from configured
            with device.active() as same:
                check(same is device, "the device itself", same)
                check(device.state is Lifecycle.ACTIVE, "state active inside the block", device.state)
                self.read(device)
            check(device.state is Lifecycle.CONFIGURED, "state configured after the block", device.state)

    def interruption(self, dut: DeviceUnderTest) -> None:
        device = dut.make()
        raised_at_s = math.inf
        try:
            with device.active():
                self.read(device)
                raised_at_s = time.monotonic()
                raise Interruption
        except Interruption:
            took_s = time.monotonic() - raised_at_s
        else:
            raise Nonconformity("expected the exception raised in the block, got none: it was swallowed")
        check(took_s < self.limit_s, f"an end within {self.limit_s:g} s", f"{took_s:.1f} s")
        check(device.state is Lifecycle.CONFIGURED, "state configured after the exception", device.state)

    def observation(self, dut: DeviceUnderTest) -> None:
        device = dut.make()
        observe(device, Lifecycle.DISCONNECTED)
        for call, state in (
            (device.connect, Lifecycle.CONNECTED),
            (device.configure, Lifecycle.CONFIGURED),
            (device.activate, Lifecycle.ACTIVE),
        ):
            call()
            observe(device, state)
        for _ in range(READINGS):
            self.read(device)
            newest = observe(device, Lifecycle.ACTIVE).reading
            check(newest is not None, "the newest reading", newest)
        device.deactivate()
        observe(device, Lifecycle.CONFIGURED)
        device.close()
        observe(device, Lifecycle.CLOSED)

    def probe(self, dut: DeviceUnderTest) -> None:
        identity = dut.make().connect()
        dut.release()
        shares: list[float] = []
        diagnostics = load_probe(dut.config.driver)(dut.name, dut.config, shares.append)
        for diagnostic in diagnostics:
            check(bool(diagnostic.subject and diagnostic.seen), "a subject and what was seen", diagnostic)
            check(diagnostic.well or bool(diagnostic.advice), "advice for what is not OK", diagnostic)
        recognized = [
            f for f in diagnostics if f.well and (identity.model in f.seen or identity.serial in f.seen)
        ]
        check(bool(recognized), f"a diagnostic that names {identity.model} {identity.serial}", diagnostics)
        check(all(0 <= share <= 1 for share in shares), "progress between 0 and 1", shares)
        again = dut.make().connect()
        check(again == identity, "a device that the probe has released", again)


def observe(device: Device, state: Lifecycle) -> LastKnown[object]:
    """Observe a device from another thread, which must be immediate and change nothing."""
    fault, seen = device.fault, list[LastKnown[object]]()
    observer = threading.Thread(target=lambda: seen.append(device.observe()), daemon=True)
    observer.start()
    observer.join(OBSERVE_LIMIT_S)
    check(bool(seen), f"an observation within {OBSERVE_LIMIT_S:g} s while {state}", "none")
    check(seen[0].state is state, f"state {state} observed", seen[0].state)
    check(seen[0].fault is fault, "the device's own fault observed", seen[0].fault)
    check(device.state is state and device.fault is fault, f"a device that stays {state}", device.state)
    return seen[0]
