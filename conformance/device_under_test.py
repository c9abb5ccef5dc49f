"""Device under test: creates drivers for the cases and shares one connection among read-only cases."""

from __future__ import annotations

from typing import Any

from conformance.disturbed_line import DisturbedLine
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Device, Lifecycle
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConfigurationError
from ronna_hw.registry import make_device

_STATE_ORDER = (Lifecycle.DISCONNECTED, Lifecycle.CONNECTED, Lifecycle.CONFIGURED, Lifecycle.ACTIVE)


class DeviceUnderTest:
    """Driver with its configuration; `offers` lists the case requirements that it meets.

    `clock_known` is False if the host's clock is merely assumed.
    """

    def __init__(self, name: str, config: DeviceConfig, clock: Clock, *, clock_known: bool = True) -> None:
        self.name = name
        self.config = config
        self.clock = clock
        self.clock_known = clock_known
        self.offers: set[str] = set()
        self.tool_in_view: str | None = None  # of a tracker, once looked for; '' if none was seen
        self._shared: Device | None = None
        self._made: list[Device] = []

    def make(self, **changes: Any) -> Any:
        """Create an unconnected driver with a changed configuration, after closing every other connection."""
        self.release()
        device: Device = self.make_beside(**changes)
        self._made.append(device)
        return device

    def make_beside(self, **changes: Any) -> Any:
        """Create an additional driver with a changed configuration; the caller closes it."""
        if "endpoint" in changes:
            changes["endpoints"] = {}
        return make_device(self.name, self.config.model_copy(update=changes), self.clock)

    def at(self, state: Lifecycle) -> Any:
        """Return the shared device in the given state, replaced if it has failed."""
        device = self._shared
        if device is None or device.state not in _STATE_ORDER:
            device = self._shared = self.make()
        if state is not Lifecycle.ACTIVE and device.state is Lifecycle.ACTIVE:
            device.deactivate()
        if state is Lifecycle.CONNECTED and device.state is Lifecycle.CONFIGURED:
            device = self._shared = self.make()
        return self.bring_to(state, device)

    def bring_to(self, state: Lifecycle, device: Any) -> Any:
        """Advance a device from its current state to `state`."""
        steps = (device.connect, device.configure, device.activate)
        for step in steps[_STATE_ORDER.index(device.state) : _STATE_ORDER.index(state)]:
            step()
        return device

    def release(self) -> None:
        """Close every connection to free the endpoint."""
        for device in self._made:
            device.close()
        self._made.clear()
        self._shared = None

    @property
    def endpoint(self) -> Endpoint:
        """Only endpoint of the driver, as the case's requirements guarantee."""
        assert self.config.endpoint is not None, "the case needs a single endpoint"
        return parse_endpoint(self.config.endpoint)

    def disturbed_line(self) -> DisturbedLine:
        """Create a disturbable line between driver and device; pass its endpoint to `make`."""
        self.release()
        return DisturbedLine(self.endpoint)

    def is_disturbable(self) -> bool:
        """Return whether a disturbable line can be inserted between driver and endpoint."""
        if self.config.endpoint is None:
            return False
        if parse_endpoint(self.config.endpoint).scheme not in ("tcp", "igtl", "serial"):
            return False
        try:
            self.make(endpoint="tcp://127.0.0.1:1")
        except ConfigurationError:  # this driver does not support TCP
            return False
        return True
