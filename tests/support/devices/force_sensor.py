"""A device of a kind that nothing else here knows, as a package of its own would bring it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint
from typing import Any, ClassVar, Protocol, runtime_checkable

import pytest
from ideal_device import IdealDevice

from ronna_hw import registry
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Device, LastKnown, Lifecycle
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import ConnectError

DECLARED = '[device.force]\ndriver = "force"\nendpoint = "tcp://127.0.0.1:1"\noptions = { scale = 2.0 }\n'
UNSCALED_N = 1.5


@runtime_checkable
class ForceSensor(Device, Protocol):
    """Measures the force along the needle."""

    def read_force_N(self, timeout_s: float = 1.0) -> float:
        """Present force; allowed in ACTIVE."""
        ...


class ScaledForceSensor(IdealDevice):
    """Always the same, times option `scale`."""

    plugged_in = True
    serial = "7"
    recorded_calls: ClassVar[Mapping[str, Any]] = {"read_force_N": float}

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, known={"scale"})
        self._force_N = UNSCALED_N * float(config.options.get("scale", 1.0))

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.guard.require("connect", {Lifecycle.DISCONNECTED})
        if not self.plugged_in:
            raise ConnectError("no reply", action="Switch it on.")
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Lab", "F1", self.serial, "1.0")

    def read_force_N(self, timeout_s: float = 1.0) -> float:
        self.guard.require("read_force_N", {Lifecycle.ACTIVE})
        return self._force_N

    def observe(self) -> LastKnown[float]:
        return self.guard.last_known(self._force_N)


def install(
    monkeypatch: pytest.MonkeyPatch, probes: Mapping[str, object] | None = None, **drivers: type
) -> None:
    """Register drivers by entry point, as installing their package does; without any, the force sensor."""
    groups: dict[str, Mapping[str, object]] = {
        registry.GROUP: drivers or {"force": ScaledForceSensor},
        registry.PROBE_GROUP: probes or {},
    }

    def entry_points(*, group: str) -> list[EntryPoint]:
        return [EntryPoint(name, f"{__name__}:{name}", group) for name in groups[group]]

    monkeypatch.setattr(registry, "entry_points", entry_points)
    monkeypatch.setattr(EntryPoint, "load", lambda point: groups[point.group][point.name])
