"""Activates a device for the length of a block, whatever happens in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeVar

from ronna_hw.devices.lifecycle import RUNNING, Device, Lifecycle
from ronna_hw.host.interruption import interruption_deferred

D = TypeVar("D", bound=Device)


@contextmanager
def activated(device: D, timeout_s: float = 10.0) -> Iterator[D]:
    """Connect and configure as needed, activate, and deactivate on leaving the block.

    `timeout_s` limits each of these calls. A device in HOLD is restarted; one that is already active is
    used as it is, and left active. Errors from the block are never masked: a failure to deactivate is
    added to them as a note. Raises the errors of `connect`, `configure` and `activate`, and DEV-001 for a
    device in FAULT or CLOSED.
    """
    if device.state is Lifecycle.ACTIVE:  # activated by someone else, who also deactivates it
        yield device
        return
    _activate(device, timeout_s)
    try:
        yield device
    except BaseException as problem:  # including interruptions: the device stops whatever ended the block
        with interruption_deferred():
            try:
                _deactivate(device, timeout_s)
            except Exception as error:
                problem.add_note(f"{device.name} could not be deactivated: {error}")
        raise
    with interruption_deferred():
        _deactivate(device, timeout_s)


def _activate(device: Device, timeout_s: float) -> None:
    if device.state is Lifecycle.HOLD:
        device.deactivate(timeout_s)
    if device.state is Lifecycle.DISCONNECTED:
        device.connect(timeout_s)
    if device.state is Lifecycle.CONNECTED:
        device.configure(timeout_s)
    device.activate(timeout_s)


def _deactivate(device: Device, timeout_s: float) -> None:
    """Deactivate, unless the device is in FAULT: it has stopped, and only `recover` clears that."""
    if device.state in RUNNING:
        device.deactivate(timeout_s)
