"""What every device owes, of whatever kind: its interface, its life, and how it refuses and ends."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ronna_hw.conformance.case import check, refused
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import ConfigurationError, ConnectError, StateError

if TYPE_CHECKING:
    from ronna_hw.conformance.device_under_test import DeviceUnderTest
    from ronna_hw.devices.lifecycle import Device, Identity

SLACK_S = 1.5  # beyond a time limit, for a busy computer


@contextmanager
def ends_within(limit_s: float) -> Iterator[None]:
    """What is done inside must have ended within `limit_s` of host time."""
    began_s = time.monotonic()
    yield
    elapsed_s = time.monotonic() - began_s
    check(elapsed_s < limit_s, f"an end within {limit_s:g} s", f"{elapsed_s:.1f} s")


def offers(dut: DeviceUnderTest, interface: type[Any]) -> None:
    """A new driver has every call of its interface and the name it was given, and is not connected."""
    device = dut.make()
    check(isinstance(device, interface), f"all calls of {interface.__name__}", type(device).__name__)
    check(device.state is Lifecycle.DISCONNECTED, "state disconnected", device.state)
    check(device.name == dut.name, f"the name {dut.name}", device.name)


def tells_who_answers(dut: DeviceUnderTest) -> tuple[Any, Identity]:
    """The device and what it told of itself; it must name vendor and model."""
    device = dut.make()
    identity: Identity = device.connect()
    check(bool(identity.vendor and identity.model), "vendor and model", identity)
    check(device.state is Lifecycle.CONNECTED, "state connected", device.state)
    return device, identity


def refuses_early(dut: DeviceUnderTest, disconnected: Sequence[str], connected: Sequence[str]) -> Any:
    """Each call is refused in the state that its list is named after. Returns the connected device."""
    device = dut.make()
    for call in disconnected:
        refused(getattr(device, call), StateError, f"{call} while disconnected")
    device.connect()
    for call in connected:
        refused(getattr(device, call), StateError, f"{call} while connected")
    return device


def closes(device: Device, limit_s: float) -> None:
    """Closing is bounded, final, and may be repeated."""
    with ends_within(limit_s):
        device.close()
    check(device.state is Lifecycle.CLOSED, "state closed", device.state)
    device.close()
    refused(device.connect, StateError, "connect after close")


def finds_nobody(device: Device, limit_s: float) -> None:
    """Where nobody answers, connecting ends in time with a code and advice."""
    try:
        with ends_within(limit_s + SLACK_S):
            error = refused(lambda: device.connect(limit_s), ConnectError, "connect to nobody")
    finally:
        device.close()
    check(isinstance(error, ConnectError) and bool(error.code and error.advice), "a code and advice", error)


def refuses_unknown_options(dut: DeviceUnderTest) -> None:
    """An option that no driver knows is refused before anything is opened."""
    options = {**dut.config.options, "no_such_option": 1}
    refused(lambda: dut.make(options=options), ConfigurationError, "an unknown option")
