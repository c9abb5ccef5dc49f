"""Universal Robots arm as a `RobotArm`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from drivers.theatre_options import naming_endpoints_too
from drivers.universal_robots.connections import Connections
from drivers.universal_robots.errors import STREAM_ERRORS
from drivers.universal_robots.faults import UrFaults
from drivers.universal_robots.options import ROLES, read_options
from drivers.universal_robots.primary.client import ControllerState
from drivers.universal_robots.readiness import controller_facts, read_tool_number, readiness_facts
from drivers.universal_robots.watch import UrWatch
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.arm_stream.hand_guided import HandGuidedArm
from ronna_hw.arm_stream.load_sums import LoadMeans
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.axis_loads import AxisLoads
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.contact import ToolLoad
from ronna_hw.devices.lifecycle import READABLE, RUNNING, LifecycleGuard
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.wire.universal_robots import SafetyMode

NEEDS_PERSON = (SafetyMode.PROTECTIVE_STOP, SafetyMode.VIOLATION, SafetyMode.FAULT)


class UniversalRobotsArm(HandGuidedArm[ControllerState]):
    """Arm driven through the endpoints `rtde`, `dashboard` and `primary`, all tcp://.

    `connect` raises URD-002 when nothing answers, URD-003 to URD-005 and ARM-010 for another arm or set-up;
    `configure` URD-020; `activate` URD-006 to URD-013 when the controller is not ready, URD-018 when the
    script does not start; `recover` URD-042 for another arm than `connect` found. `activate` switches the
    arm on if need be: that may take 30 s beyond its limit, and releasing the brakes moves joints a little.
    """

    wire_protocol = "ur-rtde"
    connections: Connections
    _watch: UrWatch

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check the configuration without connecting; raises CFG-001, CFG-002 or URD-001."""
        with naming_endpoints_too(name, config, ROLES):
            options = read_options(name, config.options)
        arm, guard = universal_robot(options.model), LifecycleGuard(name)
        connections = Connections(UrFaults(name, arm, STREAM_ERRORS, options), config, clock)
        limits = options.limits(arm, options.cycle_s)
        self.force_error_N = options.force_error_N
        super().__init__(guard, connections, UrWatch(guard, connections), limits)

    @property
    def stated_calibration(self) -> tuple[float, ...]:
        """Factory calibration that the controller has stated, column by column; empty if there is none."""
        return self.connections.calibration

    def adopt_calibration(self, stated: tuple[float, ...]) -> None:
        """Compute the arm as this controller stated it, without asking it; raises ARM-010."""
        self.connections.adopt_calibration(stated)

    def readiness(self, timeout_s: float = 1.0) -> tuple[Fact, ...]:
        """Report every condition that `activate` checks, with the controller's current values."""
        connections = self.connections
        return tuple(
            readiness_facts(
                self._request_state(timeout_s),
                remote=connections.power.is_remote(timeout_s),
                running=connections.dashboard.is_program_running(timeout_s),
                registers="" if self._guard.state in RUNNING else connections.registers_taken(timeout_s),
            )
        )

    def set_tool_load(self, load: ToolLoad, timeout_s: float = 2.0) -> ToolLoad:
        """Set mass and tool centre point, now and at later starts; raises URD-040 unless they are read back.

        Refused in remote control's absence (URD-006), and for a load that the arm cannot carry (URD-041).
        """
        self._require("set_tool_load", READABLE)
        return self.connections.set_load(load, timeout_s)

    def read_tool_load(self, timeout_s: float = 2.0) -> ToolLoad:
        """Read the load that the controller presently assumes."""
        self._require("read_tool_load", READABLE)
        return self.connections.read_load(timeout_s)

    def _start_stream(self, timeout_s: float) -> None:
        self._watch.mode = self.connections.start_stream(timeout_s, self._planner.limits)

    def _stream_mode(self) -> OperatingMode:
        return self._watch.mode

    def _reported_mode(self, state: ControllerState) -> OperatingMode:
        is_reduced = state.safety_mode == SafetyMode.REDUCED
        return OperatingMode.REDUCED_SPEED if is_reduced else OperatingMode.AUTOMATIC

    def _tool_number(self, state: ControllerState) -> int:
        return read_tool_number(state.digital_inputs, self.connections.faults.options.tool_inputs)

    def _name_loads(self, loads: AxisLoads, means: LoadMeans) -> AxisLoads:
        return replace(
            loads, current_A=means.currents, expected_current_A=means.expected_currents, force_N=means.force
        )

    def _controller_facts(self, state: ControllerState) -> Iterable[Fact]:
        return controller_facts(state)

    def _is_to_acknowledge(self, timeout_s: float) -> bool:
        reported = self.connections.reported
        return reported is not None and reported.safety_mode in NEEDS_PERSON

    def _switch_drives_off(self, timeout_s: float) -> None:
        self.connections.power.switch_off(timeout_s)
