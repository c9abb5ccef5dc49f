"""A device that answers what it answered in the run; the driver object behind it is never opened."""

from __future__ import annotations

from collections.abc import Callable, Collection
from contextlib import AbstractContextManager
from typing import cast

from procedures.engine.errors import NotRecorded
from procedures.engine.replay.recorded_answers import RecordedAnswers
from ronna_hw.devices.capabilities import ByteSink
from ronna_hw.devices.lifecycle import Device, LastKnown, Lifecycle, activated
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.recording.reading_coding import ANSWERS, LOOKS, PROPERTIES, answers_of

KNOWN_UNOPENED = ("name", "wire_protocol", "kinematics", "tools", "markers_mm")  # by the configuration alone
KEPT = {*ANSWERS, *LOOKS, *PROPERTIES, *KNOWN_UNOPENED}
READINGS = ("read_frame", "grab_pair", "read_state", "move_joints", "move_linear")


def replayed(device: Device, answers: RecordedAnswers) -> Device:
    """Stands for a device that was made and is not opened: has its public names, and its recorded answers."""
    own = vars(_Replayed)
    names = [name for name in dir(device) if not name.startswith("_") and name not in own]
    calls = answers_of(device)
    members = {name: _member(name, calls) for name in names if name in KEPT or not _is_property(device, name)}
    return cast("Device", type("Replayed", (_Replayed,), members)(device, answers))


class _Replayed:
    """State and newest reading follow the answers."""

    def __init__(self, device: Device, answers: RecordedAnswers) -> None:
        self._device = device
        self._answers = answers
        self.last_properties: dict[str, object] = {
            "serials": ("", ""),
            "notices": (),
            "operating_mode": OperatingMode.AUTOMATIC,
        }
        self._known: LastKnown[object] = LastKnown(Lifecycle.DISCONNECTED, None, None)

    @property
    def state(self) -> Lifecycle:
        return self._known.state

    @property
    def fault(self) -> RonnaError | None:
        return self._known.fault

    def observe(self) -> LastKnown[object]:
        return self._known

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Device]:
        return activated(cast("Device", self), timeout_s)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        self._known = LastKnown(Lifecycle.CONFIGURED, None, self._known.reading)

    def stop(self, *_how: object) -> None:
        """Nothing moves."""

    def close(self) -> None:
        """Nothing is open."""

    def record_bytes(self, sink: ByteSink | None) -> None:
        """Nothing passes."""

    def answer(self, call: str) -> object:
        """The next recorded answer to that call; raises what the run met."""
        given = self._answers.next(self._device.name, call, answers_of(self._device)[call])
        if self._answers.peeks and given.error is None:
            return given.value
        fault = given.error if given.state is Lifecycle.FAULT else None
        newest = given.value if call in READINGS and given.error is None else self._known.reading
        self._known = LastKnown(given.state, fault, newest)
        self.last_properties.update(given.properties)
        if given.error is not None:
            raise given.error
        return given.value


def _member(name: str, calls: Collection[str]) -> object:
    if name in calls:
        return _call(name)
    if name in PROPERTIES:
        return property(lambda self: self.last_properties[name])
    if name in KNOWN_UNOPENED:
        return property(lambda self: getattr(self._device, name))
    if name in LOOKS:
        return property(lambda self: self._answers.look(self._device.name, name))
    return _refusal(name)


def _is_property(device: Device, name: str) -> bool:
    return isinstance(getattr(type(device), name, None), property)


def _call(name: str) -> Callable[..., object]:
    def answered(self: _Replayed, *_arguments: object, **_more: object) -> object:
        return self.answer(name)

    return answered


def _refusal(name: str) -> Callable[..., object]:
    def refuse(self: _Replayed, *_arguments: object, **_more: object) -> object:
        raise NotRecorded(f"{self._device.name}.{name} is not recorded")

    return refuse
