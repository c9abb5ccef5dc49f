"""Watch of an arm whose real-time process and controller are what a test says, without any connection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, cast

from drivers.kuka_rsi.connections import Connections as KukaConnections
from drivers.kuka_rsi.errors import STREAM_ERRORS as RSI_ERRORS
from drivers.kuka_rsi.fault_errors import RsiFaults
from drivers.kuka_rsi.fault_watch import FaultWatch
from drivers.kuka_rsi.options import KukaOptions
from drivers.universal_robots.connections import Connections as UrConnections
from drivers.universal_robots.errors import STREAM_ERRORS as UR_ERRORS
from drivers.universal_robots.faults import UrFaults
from drivers.universal_robots.options import UrOptions
from drivers.universal_robots.watch import UrWatch
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm_stream.connections import StreamConnections
from ronna_hw.arm_stream.faults import StreamFaults
from ronna_hw.arm_stream.records import (
    NO_STATE,
    NOTHING_AROUND,
    LinkState,
    RecordedCycle,
    StopOrder,
    StreamPhase,
)
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Lifecycle, LifecycleGuard
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_context import load_context

MOVING = replace(NO_STATE, phase=StreamPhase.RUNNING, moving=True)
HERE = "127.0.0.1:1"


def kuka_faults(**options: Any) -> RsiFaults:
    read = KukaOptions.model_validate(options)
    return RsiFaults("robot.master", kr6_r900(read.variant), RSI_ERRORS, read)


def ur_faults(**options: Any) -> UrFaults:
    read = UrOptions.model_validate(options)
    return UrFaults("robot.master", universal_robot(read.model), UR_ERRORS, read)


@dataclass
class Link:
    """Real-time process as the driver sees it; `coming` are its next states."""

    faults: StreamFaults
    state: LinkState = field(default_factory=lambda: replace(MOVING))
    alive: bool = True
    stalled_s: float = 0.0
    surroundings: Surroundings = NOTHING_AROUND
    stop_number: int = 0
    stops: list[StopOrder] = field(default_factory=list)
    coming: list[LinkState] = field(default_factory=list)

    def command(self, *_command: object, **_more: object) -> int:
        return 1

    def stop(self, kind: StopOrder) -> int:
        self.stops.append(kind)
        self.stop_number += 1
        return self.stop_number

    def wait(self, condition: Callable[[LinkState], bool], _timeout_s: float) -> LinkState | None:
        while not condition(self.state):
            if not self.coming:
                return None
            self.state = self.coming.pop(0)
        return self.state

    def recorded_cycles(self) -> tuple[RecordedCycle, ...]:
        return ()

    def death_error(self) -> RonnaError:
        return self.faults.errors.died("the real-time process ended: killed by SIGKILL")


@dataclass
class Control:
    """Control channel as the driver sees it."""

    where: str = "tcp://127.0.0.1:1"
    silent_s: float = 0.0
    failure: RonnaError | None = None
    latest: Any = None


class Watched:
    """Active arm of either driver, watched."""

    def __init__(
        self, connections: StreamConnections[Any, Any], watch: type[Any], control: Control | None = None
    ) -> None:
        self.connections = connections
        self.link, self.control = Link(connections.faults), control or Control()
        connections.open_link, connections.open_control = cast(Any, self.link), self.control
        self.guard = LifecycleGuard("robot.master")
        for state in (Lifecycle.CONNECTED, Lifecycle.CONFIGURED, Lifecycle.ACTIVE):
            self.guard.enter(state)
        self.watch = watch(self.guard, connections)

    @property
    def outcome(self) -> tuple[str, list[StopOrder]]:
        """The code of the fault, and the stops that were ordered."""
        return (self.guard.fault.code if self.guard.fault else "", self.link.stops)


def watched_kuka(control: Control | None = None, **options: Any) -> Watched:
    endpoints = {"rsi": f"udp://{HERE}", "eki_project": f"tcp://{HERE}"}
    config = DeviceConfig(driver="kuka_rsi", endpoints=endpoints)
    connections = KukaConnections(kuka_faults(**options), config, load_context(), HostClock())
    return Watched(connections, FaultWatch, control)


def watched_ur(**options: Any) -> Watched:
    endpoints = {role: f"tcp://{HERE}" for role in ("rtde", "dashboard", "primary")}
    config = DeviceConfig(driver="universal_robots", endpoints=endpoints)
    return Watched(UrConnections(ur_faults(**options), config, HostClock()), UrWatch)
