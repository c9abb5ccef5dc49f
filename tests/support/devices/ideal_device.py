"""What devices that exist only in the tests have in common: a lifecycle without any wire."""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, Self

from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle, LifecycleGuard, hold_active
from ronna_hw.errors import ConfigurationError, RonnaError


class IdealDevice:
    """Goes from state to state as it is told; a subclass takes the readings and keeps the `newest`."""

    wire_protocol = ""
    notices: tuple[str, ...] = ()

    def __init__(self, name: str, config: DeviceConfig, clock: Clock, *, known: set[str]) -> None:
        if set(config.options) - known:
            raise ConfigurationError("an option is unknown")
        self.name, self.config, self.clock = name, config, clock
        self.guard = LifecycleGuard(name)
        self.newest: Any = None

    @property
    def state(self) -> Lifecycle:
        return self.guard.state

    @property
    def fault(self) -> RonnaError | None:
        return self.guard.fault

    def observe(self) -> LastKnown[Any]:
        return self.guard.last_known(self.newest)

    def active(self, timeout_s: float = 10.0) -> AbstractContextManager[Self]:
        return hold_active(self, timeout_s)

    def configure(self, timeout_s: float = 10.0) -> None:
        self.guard.require("configure", {Lifecycle.CONNECTED})
        self.guard.enter(Lifecycle.CONFIGURED)

    def activate(self, timeout_s: float = 10.0) -> None:
        self.guard.require("activate", {Lifecycle.CONFIGURED})
        self.guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        self.guard.require("deactivate", {Lifecycle.ACTIVE})
        self.guard.enter(Lifecycle.CONFIGURED)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        self.guard.require("recover", {Lifecycle.FAULT})

    def close(self) -> None:
        self.guard.enter(Lifecycle.CLOSED)
