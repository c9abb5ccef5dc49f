"""Checks shared by all suites: interface, lifecycle, refusals, closing."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from conformance.case import check, refused
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import ConfigurationError, ConnectError, StateError

if TYPE_CHECKING:
    from conformance.device_under_test import DeviceUnderTest
    from ronna_hw.devices.lifecycle import Device, Identity

SLACK_S = 1.5  # on top of a time limit, for a busy computer


@contextmanager
def ends_within(limit_s: float) -> Iterator[None]:
    """The block must end within `limit_s` of host time."""
    began_s = time.monotonic()
    yield
    elapsed_s = time.monotonic() - began_s
    check(elapsed_s < limit_s, f"an end within {limit_s:g} s", f"{elapsed_s:.1f} s")


def offers(dut: DeviceUnderTest, interface: type[Any]) -> None:
    """A new driver has all calls of its interface and the given name, and is not connected."""
    device = dut.make()
    check(isinstance(device, interface), f"all calls of {interface.__name__}", type(device).__name__)
    check(device.state is Lifecycle.DISCONNECTED, "state disconnected", device.state)
    check(device.name == dut.name, f"the name {dut.name}", device.name)


def identifies_device(dut: DeviceUnderTest) -> tuple[Any, Identity]:
    """The connected device and its identity, which must name vendor and model."""
    device = dut.make()
    identity: Identity = device.connect()
    check(bool(identity.vendor and identity.model), "vendor and model", identity)
    check(device.state is Lifecycle.CONNECTED, "state connected", device.state)
    return device, identity


def refuses_early(dut: DeviceUnderTest, disconnected: Sequence[str], connected: Sequence[str]) -> Any:
    """Calls are refused while disconnected and while connected. Returns the connected device."""
    device = dut.make()
    for call in disconnected:
        refused(getattr(device, call), StateError, f"{call} while disconnected")
    device.connect()
    for call in connected:
        refused(getattr(device, call), StateError, f"{call} while connected")
    return device


def closes(device: Device, limit_s: float) -> None:
    """Closing takes bounded time, is final, and may be repeated."""
    with ends_within(limit_s):
        device.close()
    check(device.state is Lifecycle.CLOSED, "state closed", device.state)
    device.close()
    refused(device.connect, StateError, "connect after close")


def fails_to_connect(device: Device, limit_s: float) -> None:
    """Without a device at the endpoint, connecting fails in time with a code and advice."""
    try:
        with ends_within(limit_s + SLACK_S):
            error = refused(lambda: device.connect(limit_s), ConnectError, "connecting without a device")
    finally:
        device.close()
    check(bool(error.code and error.advice), "an error with code and advice", error)


def refuses_unknown_options(dut: DeviceUnderTest) -> None:
    """An unknown option is refused by the constructor."""
    options = {**dut.config.options, "no_such_option": 1}
    refused(lambda: dut.make(options=options), ConfigurationError, "an unknown option")
