"""A device whose answers are recorded on a tape."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from typing import Any, cast

from ronna_hw.devices.activation import activated
from ronna_hw.devices.lifecycle import Device
from ronna_hw.errors import RonnaError
from ronna_hw.recording.device_calls import LOOKS, PROPERTIES, TELLING, answers_of
from ronna_hw.recording.reading_tape import ReadingTape


def taped(device: Device, tape: ReadingTape) -> Device:
    """The same device for its callers: it has exactly the public names of the device."""
    names = [name for name in dir(device) if not name.startswith("_") and name != "active"]
    calls = answers_of(device)
    members = {name: _member(name, calls) for name in names}
    return cast("Device", type("Taped", (_Taped,), members)(device, tape))


class _Taped:
    """Members are those of the wrapped device."""

    def __init__(self, device: Device, tape: ReadingTape) -> None:
        self._device = device
        self._tape = tape

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Any]:
        return activated(cast("Device", self), timeout_s)


def _member(name: str, calls: Collection[str]) -> Any:
    if name in calls:
        return _taped_call(name)
    if name in LOOKS:
        return property(lambda self: _asked(self, name, lambda: getattr(self._device, name)))
    return property(lambda self: getattr(self._device, name))


def _taped_call(name: str) -> Callable[..., Any]:
    def call(self: _Taped, *arguments: Any, **more: Any) -> Any:
        return _asked(self, name, lambda: getattr(self._device, name)(*arguments, **more))

    return call


def _asked(self: _Taped, name: str, ask: Callable[[], Any]) -> Any:
    device, tape = self._device, self._tape
    if not tape.listening:
        return ask()
    try:
        value = ask()
    except RonnaError as error:
        tape.keep(device.name, name, device.observe().state, None, error)
        raise
    kept = PROPERTIES if name in TELLING else ()
    properties = {each: getattr(device, each) for each in kept if hasattr(device, each)}
    tape.keep(device.name, name, device.observe().state, value, properties=properties)
    return value
