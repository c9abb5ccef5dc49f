"""The device under test: makes drivers for the cases, shares one session among those that only read."""

from __future__ import annotations

from typing import Any

from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.conformance.disturbed_line import DisturbedLine
from ronna_hw.conformance.polaris.tap import PolarisTap
from ronna_hw.devices.lifecycle import Device, Lifecycle
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import ConfigurationError
from ronna_hw.host.control_port import ask_control_port
from ronna_hw.registry import load_driver, make_device

CHECKED_PROTOCOLS = frozenset({"ndi-polaris"})  # their replies carry checksums
_ON_THE_WAY = (Lifecycle.DISCONNECTED, Lifecycle.CONNECTED, Lifecycle.CONFIGURED, Lifecycle.ACTIVE)


class DeviceUnderTest:
    """One device configuration under test. `offers` is what the cases may rely on.

    `clock_known` is False where the host's clock was taken because nobody said which clock the device has.
    `control` is the endpoint by which the device can be made to fail, where there is one.
    """

    def __init__(
        self,
        name: str,
        config: DeviceConfig,
        clock: Clock,
        allowed: frozenset[str] = frozenset(),
        *,
        clock_known: bool = True,
        control: str | None = None,
    ) -> None:
        self.name = name
        self.config = config
        self.clock = clock
        self.clock_known = clock_known
        self._control = control
        self._shared: Device | None = None
        self._made: list[Device] = []
        self.offers = allowed | self._capabilities()

    def make(self, *, endpoint: str | None = None, options: dict[str, Any] | None = None) -> Any:
        """A new driver object, not connected, perhaps on another endpoint; ends every other session first."""
        self.release()
        changes: dict[str, Any] = {}
        if endpoint is not None:
            changes |= {"endpoint": endpoint, "endpoints": {}}
        if options is not None:
            changes["options"] = options
        device: Device = make_device(self.name, self.config.model_copy(update=changes), self.clock)
        self._made.append(device)
        return device

    def at(self, state: Lifecycle) -> Any:
        """The shared device, brought to CONNECTED, CONFIGURED or ACTIVE; made anew when it is beyond use."""
        device = self._shared
        if device is None or device.state not in _ON_THE_WAY:
            device = self._shared = self.make()
        if state is not Lifecycle.ACTIVE and device.state is Lifecycle.ACTIVE:
            device.deactivate()
        if state is Lifecycle.CONNECTED and device.state is Lifecycle.CONFIGURED:
            device = self._shared = self.make()
        steps = (device.connect, device.configure, device.activate)
        for step in steps[_ON_THE_WAY.index(device.state) : _ON_THE_WAY.index(state)]:
            step()
        return device

    def brought_to(self, state: Lifecycle, device: Any) -> Any:
        """A device of `make`, brought from where it is to `state`."""
        steps = (device.connect, device.configure, device.activate)
        for step in steps[_ON_THE_WAY.index(device.state) : _ON_THE_WAY.index(state)]:
            step()
        return device

    def release(self) -> None:
        """End every session, so that the endpoint is free."""
        for device in self._made:
            device.close()
        self._made.clear()
        self._shared = None

    def disturbed_line(self) -> DisturbedLine:
        """A line of ours between driver and device; give its endpoint to `make`."""
        self.release()
        assert self.config.endpoint is not None, "line faults are offered only for one endpoint"
        return DisturbedLine(parse_endpoint(self.config.endpoint))

    def polaris_tap(self) -> PolarisTap:
        """A line of ours that understands commands and replies of the Polaris protocol."""
        self.release()
        assert self.config.endpoint is not None, "line faults are offered only for one endpoint"
        return PolarisTap(parse_endpoint(self.config.endpoint))

    def fault(self, line: str) -> None:
        """Make the device fail, by one line of the language of faults. Raises CTL-001 or CTL-002."""
        ask_control_port(self._control_port, "fault", line=line)

    def clear_faults(self) -> None:
        """End every fault."""
        ask_control_port(self._control_port, "clear_faults")

    @property
    def _control_port(self) -> str:
        assert self._control is not None, "faults are offered only with a control port"
        return self._control

    def _capabilities(self) -> frozenset[str]:
        found = set()
        driver = load_driver(self.config.driver)
        protocol = getattr(driver, "wire_protocol", None)
        if protocol in CHECKED_PROTOCOLS:
            found.add("checked replies")
        if protocol == "ndi-polaris" and self.config.endpoint is not None:
            found.add("polaris bytes")
            if parse_endpoint(self.config.endpoint).scheme == "serial":
                found.add("serial line")
        if self._control is not None:
            found.add("live faults")
        if self.clock.paced:
            found.add("host time")
        if self._can_be_disturbed():
            found.add("line faults")
        if getattr(self.make(), "definition_blocks", None):
            found.add("tool definition")
        return frozenset(found)

    def _can_be_disturbed(self) -> bool:
        if self.config.endpoint is None:
            return False
        if parse_endpoint(self.config.endpoint).scheme not in ("tcp", "serial"):
            return False
        try:
            self.make(endpoint="tcp://127.0.0.1:1")
        except ConfigurationError:  # this driver does not take TCP
            return False
        return True
