"""The device under test: creates drivers for the cases; cases that only read share one connection."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from conformance.case import HOST_TIME, LINE_FAULTS
from conformance.choice import Target, configured
from conformance.disturbed_line import DisturbedLine
from conformance.protocol import ProtocolCases
from ronna_hw.clock import Clock, open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Device, Lifecycle
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConfigurationError
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.registry import make_device

SIMULATOR_MODULE = "sim.cli"  # started as a command, never imported
_ON_THE_WAY = (Lifecycle.DISCONNECTED, Lifecycle.CONNECTED, Lifecycle.CONFIGURED, Lifecycle.ACTIVE)


class DeviceUnderTest:
    """One driver with one configuration. `offers` names the needs of cases that it meets.

    `clock_known` is False if the host's clock is merely assumed.
    """

    def __init__(
        self,
        name: str,
        config: DeviceConfig,
        clock: Clock,
        allowed: frozenset[str] = frozenset(),
        *,
        protocol: ProtocolCases | None = None,
        clock_known: bool = True,
    ) -> None:
        self.name = name
        self.config = config
        self.clock = clock
        self.clock_known = clock_known
        self._shared: Device | None = None
        self._made: list[Device] = []
        self.offers = allowed | self._capabilities()
        if protocol is not None:
            self.offers |= protocol.offers(self)

    def make(self, *, endpoint: str | None = None, options: dict[str, Any] | None = None) -> Any:
        """A new, unconnected driver object. Closes every other connection first."""
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
        """The shared device in CONNECTED, CONFIGURED or ACTIVE; a new one if the old one failed."""
        device = self._shared
        if device is None or device.state not in _ON_THE_WAY:
            device = self._shared = self.make()
        if state is not Lifecycle.ACTIVE and device.state is Lifecycle.ACTIVE:
            device.deactivate()
        if state is Lifecycle.CONNECTED and device.state is Lifecycle.CONFIGURED:
            device = self._shared = self.make()
        return self.brought_to(state, device)

    def brought_to(self, state: Lifecycle, device: Any) -> Any:
        """A device from `make`, brought from its present state to `state`."""
        steps = (device.connect, device.configure, device.activate)
        for step in steps[_ON_THE_WAY.index(device.state) : _ON_THE_WAY.index(state)]:
            step()
        return device

    def release(self) -> None:
        """Close every connection, so that the endpoint is free."""
        for device in self._made:
            device.close()
        self._made.clear()
        self._shared = None

    @property
    def endpoint(self) -> Endpoint:
        """The only endpoint, for cases whose needs imply that there is one."""
        assert self.config.endpoint is not None, "the case needs a single endpoint"
        return parse_endpoint(self.config.endpoint)

    def disturbed_line(self) -> DisturbedLine:
        """A line between driver and device that can misbehave; pass its endpoint to `make`."""
        self.release()
        return DisturbedLine(self.endpoint)

    def _capabilities(self) -> frozenset[str]:
        met = set()
        if self.clock.paced:
            met.add(HOST_TIME)
        if self._can_be_disturbed():
            met.add(LINE_FAULTS)
        return frozenset(need.name for need in met)

    def _can_be_disturbed(self) -> bool:
        if self.config.endpoint is None:
            return False
        if parse_endpoint(self.config.endpoint).scheme not in ("tcp", "serial"):
            return False
        try:
            self.make(endpoint="tcp://127.0.0.1:1")
        except ConfigurationError:  # this driver does not support TCP
            return False
        return True


@contextmanager
def device_under_test(target: Target) -> Iterator[DeviceUnderTest]:
    """The device under test; whatever was started for it is ended on leaving. Raises PRC-001."""
    with ExitStack() as stack:
        config = target.config
        if config is None:
            assert target.protocol.simulator is not None, "resolve has checked that there is a simulator"
            arguments = target.protocol.simulator()
            child = stack.enter_context(
                ChildProcess(f"ronna-sim {arguments[0]}", command(SIMULATOR_MODULE, *arguments))
            )
            config = configured(
                target.driver, child.ready.get("endpoints") or {None: child.ready["endpoint"]}
            )
        dut = DeviceUnderTest(
            target.name,
            config,
            open_clock(target.clock),
            target.allowed,
            protocol=target.protocol,
            clock_known=target.clock_known,
        )
        stack.callback(dut.release)
        yield dut
