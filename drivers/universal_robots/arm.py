"""Universal Robots arm as a `RobotArm`."""

from __future__ import annotations

import contextlib
import time

from drivers.universal_robots.connections import Connections, remaining_s
from drivers.universal_robots.faults import stream_faults
from drivers.universal_robots.options import planning_limits, read_options
from drivers.universal_robots.primary.client import ControllerState
from drivers.universal_robots.readings import (
    ArmReadings,
    controller_facts,
    read_tool_number,
    readiness_facts,
)
from drivers.universal_robots.watch import UrWatch
from ronna_hw.arm.universal_robots import UniversalRobot
from ronna_hw.arm_stream.hand_guided import HandGuidedArm
from ronna_hw.arm_stream.motion import MotionFollower, MotionPlanner
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink, Fact
from ronna_hw.devices.contact import ToolLoad
from ronna_hw.devices.lifecycle import (
    READABLE,
    RUNNING,
    Identity,
    LastKnown,
    Lifecycle,
    LifecycleGuard,
    require_person,
)
from ronna_hw.devices.readings import ArmReading, ToolIdentity
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.wire.universal_robots import SafetyMode

REPLY_LIMIT_S = 0.5  # host time: connections silent for longer are reopened in a recovery
LIVE_HEARTBEAT_S = 0.2  # largest age of the real-time process' last heartbeat for it to be worth contacting
NEEDS_PERSON = (SafetyMode.PROTECTIVE_STOP, SafetyMode.VIOLATION, SafetyMode.FAULT)


class UniversalRobotsArm(HandGuidedArm):
    """Arm driven through the endpoints `rtde`, `dashboard` and `primary`, all tcp://."""

    wire_protocol = "ur-rtde"
    _kinematics: UniversalRobot
    _readings: ArmReadings

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check the configuration without connecting; raises CFG-001, CFG-002 or URD-001."""
        self._name = name
        self._options = options = read_options(name, config.options)
        self._guard = LifecycleGuard(name)
        self._streams = self.connections = Connections(name, config, options, clock)
        self._kinematics = self.connections.kinematics
        self._planner = MotionPlanner(name, self._kinematics, planning_limits(options))
        faults = stream_faults(name, self._kinematics, options)
        self._watching = self._watch = UrWatch(self._guard, self.connections, faults, options)
        self._follower = MotionFollower(faults, self.connections, self._watch, options.cycle_s)
        self._readings = ArmReadings(self.connections, clock, options.silence_limit_s)

    @property
    def kinematics(self) -> UniversalRobot:
        """Kinematics of this individual arm once connected, nominal before."""
        return self._kinematics

    @property
    def operating_mode(self) -> OperatingMode:
        state = None if self._guard.state in RUNNING else self.connections.reported
        if state is None:
            return self._watch.mode
        is_reduced = state.safety_mode == SafetyMode.REDUCED
        return OperatingMode.REDUCED_SPEED if is_reduced else OperatingMode.AUTOMATIC

    def observe(self) -> LastKnown[ArmReading]:
        streaming = self._guard.state in RUNNING  # unlike `state`, this does not check for new faults
        facts = tuple(controller_facts(self.connections.reported))
        return self._guard.last_known(self._readings.newest(streaming=streaming), facts)

    def record_bytes(self, sink: ByteSink | None) -> None:
        self.connections.recorder.sink = sink

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Open dashboard and primary interface, and check arm, version and factory calibration.

        Raises URD-002 when nothing answers, URD-003 to URD-005 and ARM-010 for another arm or set-up.
        """
        self._guard.require("connect", (Lifecycle.DISCONNECTED,))
        identity = self.connections.find_controller(timeout_s, self._watch)
        self._use_kinematics()
        self._guard.enter(Lifecycle.CONNECTED, identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Start the real-time process; raises URD-020."""
        self._guard.require("configure", (Lifecycle.CONNECTED,))
        self.connections.start_link(timeout_s)
        self._guard.enter(Lifecycle.CONFIGURED)

    def readiness(self, timeout_s: float = 1.0) -> tuple[Fact, ...]:
        """Report every condition that `activate` checks, with the controller's current values."""
        connections = self.connections
        return tuple(
            readiness_facts(
                self._request_state(timeout_s),
                remote=connections.is_remote(timeout_s),
                running=connections.dashboard.is_program_running(timeout_s),
                registers="" if self._guard.state in RUNNING else connections.registers_taken(timeout_s),
            )
        )

    def activate(self, timeout_s: float = 10.0) -> None:
        """Switch the arm on if need be, start our script, and return once it uses our set-points.

        Switching on may take up to 30 s beyond `timeout_s`, and joints move a little when brakes are
        released. Raises URD-006 to URD-013 when the controller is not ready, URD-018 when the script does not
        start. Errors after the start are latched; `recover` clears them. A stop during the start leaves the
        arm in HOLD.
        """
        self._guard.require("activate", (Lifecycle.CONFIGURED,))
        stop_count = self.connections.link.stop_number
        try:
            self._watch.mode = self.connections.start_stream(timeout_s, self._planner.limits)
        except RonnaError as error:
            self._watch.latch(error)
            raise
        self._enter_active(stop_count, mode=self._watch.mode)

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Return from FAULT to CONFIGURED: end the stream, release a protective stop, check the controller.

        Moves nothing. The person named has found the cause at the arm. Broken connections are reopened, with
        retries until the time limit. While CONNECTED a protective stop of an earlier run is released, and the
        state stays CONNECTED. Raises what prevents it, such as URD-007, or URD-042 for another arm
        than `connect` found; a fault then stays latched.
        """
        self._watch.check()
        person = require_person(acknowledged_by)
        deadline = time.monotonic() + timeout_s
        connections = self.connections
        reported = connections.reported
        is_stopped = reported is not None and reported.safety_mode in NEEDS_PERSON
        if self._guard.state is Lifecycle.CONNECTED and is_stopped:
            connections.acknowledge(person, deadline)
            return
        self._guard.require("recover", (Lifecycle.FAULT,))
        if not connections.is_answering(REPLY_LIMIT_S):
            connections.find_controller(remaining_s(deadline), self._watch, retry=True)
            self._use_kinematics()
        link = connections.open_link
        if link is not None:
            if link.alive and link.stalled_s < LIVE_HEARTBEAT_S:
                with contextlib.suppress(RonnaError):
                    connections.end_stream(time.monotonic() + 0.5 * remaining_s(deadline))
            connections.close_link()
        connections.acknowledge(person, deadline)
        connections.start_link(max(remaining_s(deadline), REPLY_LIMIT_S))
        self._guard.enter(Lifecycle.CONFIGURED)

    def read_state(self, timeout_s: float = 1.0) -> ArmReading:
        """Read the measured joint angles, from a running stream or otherwise by the primary interface."""
        self._watch.raise_new()
        self._guard.require("read_state", READABLE)
        if self._guard.state in RUNNING:
            return self._readings.from_stream(self.connections.link.state)
        return self._readings.from_controller(self._request_state(timeout_s))

    def read_tool_identity(self, timeout_s: float = 1.0) -> ToolIdentity:
        """Read the tool number from the controller's digital inputs; 0 means no tool."""
        self._watch.raise_new()
        self._guard.require("read_tool_identity", READABLE)
        inputs = self._request_state(timeout_s).digital_inputs
        return ToolIdentity(self._readings.stamp(), read_tool_number(inputs, self._options.tool_inputs))

    def set_tool_load(self, load: ToolLoad, timeout_s: float = 2.0) -> ToolLoad:
        """Set mass and tool centre point, now and at later starts; raises URD-040 unless they are read back.

        Refused in remote control's absence (URD-006), and for a load that the arm cannot carry (URD-041).
        """
        self._watch.raise_new()
        self._guard.require("set_tool_load", READABLE)
        return self.connections.set_load(load, timeout_s)

    def read_tool_load(self, timeout_s: float = 2.0) -> ToolLoad:
        """Read the load that the controller presently assumes."""
        self._watch.raise_new()
        self._guard.require("read_tool_load", READABLE)
        return self.connections.read_load(timeout_s)

    def _stream_mode(self) -> OperatingMode:
        return self._watch.mode

    def _switch_drives_off(self, timeout_s: float) -> None:
        self.connections.switch_off(timeout_s)

    def _use_kinematics(self) -> None:
        """Plan and check with the kinematics of the arm that has been identified."""
        self._kinematics = arm = self.connections.kinematics
        faults = stream_faults(self._name, arm, self._options)
        self._planner.kinematics = arm
        self._watch.use(faults)
        self._follower.use(faults)

    def _request_state(self, timeout_s: float) -> ControllerState:
        try:
            return self.connections.read_state(timeout_s)
        except RonnaError:
            self._watch.check()
            raise
