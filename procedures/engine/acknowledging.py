"""Recovers devices from what a person has acknowledged. Nothing here can move the arm."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.lifecycle import Device, Lifecycle

EARLIER = "a message from before this session"  # drivers do not say which


def acknowledged(devices: Mapping[str, Device], recover: Callable[[str], None]) -> Iterator[tuple[str, str]]:
    """Recover each device that is in fault or, only connected yet, holds a message of an earlier session.

    Yields its role, and what was acknowledged. Raises what `recover` raises, which is called with the role.
    """
    for role, device in devices.items():
        seen = device.observe()
        if seen.state is Lifecycle.FAULT:
            recover(role)
            yield role, str(seen.fault)
        elif seen.state is Lifecycle.CONNECTED:
            try:
                recover(role)
            except WrongState:  # it holds none
                continue
            yield role, EARLIER
