"""A well-behaved tracker that exists only in the tests, and ways to spoil it."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, suppress
from typing import Any

import pytest
from ideal_device import IdealDevice

from conformance import device_under_test
from conformance.device_under_test import DeviceUnderTest
from conformance.protocol import ProtocolCases
from conformance.target import build_device_under_test
from ronna_hw import registry
from ronna_hw.clock import Clock, HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.devices.readings import Stamp, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import ConnectError


class GoodTracker(IdealDevice):
    """Does what the interface says, without any wire: `host:` is its endpoint."""

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, known={"tools"})
        self.tools: tuple[str, ...] = tuple(config.options.get("tools", ("probe",)))
        self.markers_mm = {tool: ((0.0, 0.0, 0.0),) for tool in self.tools}
        self.frame = 0

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.guard.require("connect", {Lifecycle.DISCONNECTED})
        if self.config.endpoint != "host:":
            error = ConnectError("nobody is there", action="Look for it.")
            error.code = "TST-001"  # type: ignore[misc]
            raise error
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Test", "Good", "1", "0")

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        self.guard.require("read_frame", {Lifecycle.ACTIVE})
        self.frame += 1
        self.newest = TrackerFrame(
            Stamp(self.frame, self.frame, self.clock.now_s()),
            Validity.OK,
            tuple(self.reading(tool) for tool in self.tools),
            (StrayReading((0.0, 0.0, -1000.0), Validity.OK),),
        )
        return self.newest

    def reading(self, tool: str) -> ToolReading:
        if self.frame % 3 == 0:
            return ToolReading(tool, Validity.MISSING, None, None, None)
        return ToolReading(tool, Validity.OK, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, -1500.0), 0.1)


class QuickClock(HostClock):
    """A clock on which a test does not wait."""

    def sleep(self, duration_s: float) -> None:
        return


@pytest.fixture
def serve() -> Iterator[Callable[[Callable[[bytes], Iterable[bytes]]], Endpoint]]:
    """Serve clients over TCP, one after another, by a function of the data read."""
    with ExitStack() as servers:

        def start(answer: Callable[[bytes], Iterable[bytes]]) -> Endpoint:
            server = socket.create_server(("127.0.0.1", 0))

            def run() -> None:
                with suppress(OSError):
                    while True:
                        peer, _ = server.accept()
                        with peer:
                            while data := peer.recv(4096):
                                for part in answer(data):
                                    peer.sendall(part)

            thread = threading.Thread(target=run, daemon=True)
            thread.start()
            servers.callback(thread.join)
            servers.callback(server.close)
            servers.callback(server.shutdown, socket.SHUT_RDWR)
            return Endpoint("tcp", host="127.0.0.1", port=server.getsockname()[1])

        yield start


@pytest.fixture
def good_tracker() -> type[GoodTracker]:
    return GoodTracker


@pytest.fixture
def make_dut(monkeypatch: pytest.MonkeyPatch) -> Callable[..., DeviceUnderTest]:
    """The device under test for a driver class, which need not be installed."""

    def make(
        driver: Any,
        *,
        endpoint: str = "host:",
        allowed: frozenset[str] = frozenset(),
        protocol: ProtocolCases | None = None,
    ) -> DeviceUnderTest:
        monkeypatch.setattr(device_under_test, "make_device", driver)
        monkeypatch.setattr(registry, "make_device", driver)  # for the default probe
        config = DeviceConfig(driver="test", endpoint=endpoint)
        return build_device_under_test("tracker", config, QuickClock(), allowed, protocol=protocol)

    return make
