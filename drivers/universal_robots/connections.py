"""Connections to the controller: dashboard, primary interface and the RTDE stream.

`Connections` opens and closes each; starting and ending the stream involves all. Every stream has an RTDE
connection, recipes, a script and a session number of its own.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import socket
import time
from collections.abc import Callable
from typing import TypeVar

from drivers.universal_robots.controller.script import render_script, render_secondary
from drivers.universal_robots.dashboard import DashboardClient
from drivers.universal_robots.errors import (
    STREAM_ERRORS,
    AnotherProgramRuns,
    ControllerExchanged,
    ControllerLost,
    ControllerNotFound,
    FactoryCalibrationDiffers,
    LinkNotStarted,
    LoadNotTaken,
    LocalMode,
    NoAnswer,
    NotPowered,
    ProtectivelyStopped,
    RegistersInUse,
    ScriptNotStarted,
    SpeedAtZero,
    WrongArm,
    WrongVersion,
)
from drivers.universal_robots.faults import fault_error, stream_faults
from drivers.universal_robots.loads import LOAD_FIELDS, has_load, load_commands, to_load
from drivers.universal_robots.options import ROLES, UrOptions, script_settings
from drivers.universal_robots.primary.client import ControllerState, PrimaryClient
from drivers.universal_robots.primary.packages import KinematicsInfo, MessageKind
from drivers.universal_robots.realtime.loop import Handover
from drivers.universal_robots.realtime.packages import ControllerWord
from drivers.universal_robots.realtime.settings import LinkSettings
from drivers.universal_robots.rtde import RtdeSetup, Version
from drivers.universal_robots.safety import NORMAL_MODES, RESTART_MODES, safety_refusal
from drivers.universal_robots.watch import UrWatch
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.universal_robots import UniversalRobot, UrModel, universal_robot
from ronna_hw.arm.universal_robots.calibrated import CalibratedUniversalRobot
from ronna_hw.arm.universal_robots.factory_calibration import FactoryCalibration
from ronna_hw.arm_stream.client import LinkClient, StartRefused, TrafficHandler, pass_traffic
from ronna_hw.arm_stream.records import CommandKind, Fault, Phase
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink, Direction
from ronna_hw.devices.contact import ToolLoad
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.wire.universal_robots import RobotMode, SafetyMode, ScriptState

PROCESS = "drivers.universal_robots.realtime.process"
ARM_TYPE = "UR5"  # as the dashboard calls both generations
MAJOR_VERSION = {UrModel.UR5: 3, UrModel.UR5E: 5}
GENERATIONS = {UrModel.UR5: "a CB3 controller", UrModel.UR5E: "an e-Series controller"}
LEAST_MINOR = {UrModel.UR5: 9, UrModel.UR5E: 6}  # registers 24 to 47; remote control
FIRST_PAUSE_S = 0.1  # between attempts to reopen the connections; doubled each time
LONGEST_PAUSE_S = 2.0
SHORTEST_TRY_S = 0.2
POLL_S = 0.05  # host time between two looks at the controller's modes
STATE_PERIOD_S = 0.1  # of the primary interface
PASSING_SHARE = 10.0  # of theatre time that may pass meanwhile, where it runs freely
POWER_LIMIT_S = 30.0  # host time for power and brakes (U: 5 s each and more)
END_LIMIT_S = 1.0  # host time for the script to end on our order
UNLOCK_PAUSE_S = 0.25
ASK_LIMIT_S = 1.0
T = TypeVar("T")


class Connections:
    """Connections of one arm; accessing a closed one raises."""

    def __init__(self, name: str, config: DeviceConfig, options: UrOptions, clock: Clock) -> None:
        """Check the endpoints without connecting; raises CFG-001 or CFG-002."""
        self._name = name
        addresses = config.require_addresses(ROLES)
        self._rtde = addresses["rtde"]
        self._dashboard_address, self._primary_address = addresses["dashboard"], addresses["primary"]
        self._options = options
        self._clock = clock
        self.open_dashboard: DashboardClient | None = None
        self.open_primary: PrimaryClient | None = None
        self.open_link: LinkClient | None = None
        self.recorder = LinkRecorder(name)
        self.kinematics: UniversalRobot = universal_robot(options.model)
        self._calibration: tuple[float, ...] = ()
        self._identity: Identity | None = None  # found first: another one is refused
        self._load: ToolLoad | None = None  # set by a caller, and sent again with each script
        self._channel: socket.socket | None = None  # over which connections are handed to the process

    @property
    def reported(self) -> ControllerState | None:
        """Controller state received last."""
        return None if self.open_primary is None else self.open_primary.latest

    @property
    def dashboard(self) -> DashboardClient:
        """Open dashboard connection; raises URD-002 if not connected."""
        if self.open_dashboard is None:
            raise ControllerNotFound(f"{self._name}: no dashboard connection is open")
        return self.open_dashboard

    @property
    def primary(self) -> PrimaryClient:
        """Open primary connection; raises URD-002 if not connected."""
        if self.open_primary is None:
            raise ControllerNotFound(f"{self._name}: no connection to the primary interface is open")
        return self.open_primary

    @property
    def link(self) -> LinkClient:
        """Client of the real-time process; raises URD-020 if the process has not been started."""
        if self.open_link is None:
            raise LinkNotStarted(f"{self._name}: no real-time process is running")
        return self.open_link

    def is_remote(self, timeout_s: float) -> bool | None:
        """Return whether the controller is in remote control; None for CB3, which has no such mode."""
        return None if self._options.model is UrModel.UR5 else self.dashboard.is_remote(timeout_s)

    def is_answering(self, limit_s: float) -> bool:
        """Return whether dashboard and primary interface still work."""
        if self.open_dashboard is None or self.open_primary is None or self.open_primary.failure is not None:
            return False
        try:
            self.open_dashboard.robot_mode(limit_s)
        except RonnaError:
            return False
        return True

    def read_state(self, timeout_s: float) -> ControllerState:
        """Return a state that arrived after this call; lets no more theatre time pass than it needs."""
        self._clock.let_pass(STATE_PERIOD_S)
        try:
            return self.primary.await_state(timeout_s, newer_than_s=time.monotonic())
        finally:
            self._clock.hold_back()

    def registers_taken(self, timeout_s: float) -> str:
        """Return who has the registers of our script, with the code of the error; empty if nobody has."""
        rtde = RtdeSetup(self._rtde.host, self._rtde.port, timeout_s)
        try:
            rtde.set_up_inputs()
        except RegistersInUse as error:
            return f"{error.code} {error.summary}"
        finally:
            rtde.close()  # frees them
        return ""

    def find_controller(self, timeout_s: float, listener: UrWatch, *, retry: bool = False) -> Identity:
        """Open dashboard and primary interface, and identify arm and controller.

        With `retry`, try until the time limit at growing pauses. Raises URD-002 when nothing answers, URD-003
        to URD-005 for another arm, version or calibration, URD-042 for another than at the first call.
        """
        self.close_control()
        deadline, pause_s = time.monotonic() + timeout_s, FIRST_PAUSE_S
        limit_s = max(timeout_s, SHORTEST_TRY_S) if retry else timeout_s
        while True:
            try:
                identity = self._identify(limit_s)
                break
            except (ControllerNotFound, ControllerLost):
                self.close_control()
                if not retry or remaining_s(deadline) <= pause_s:
                    raise
            except RonnaError:
                self.close_control()
                raise
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            limit_s = max(remaining_s(deadline), SHORTEST_TRY_S)
        self.primary.listen(listener)
        return identity

    def start_link(self, timeout_s: float) -> None:
        """Start the real-time process; raises URD-020."""
        self.close_link()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        options = self._options
        settings = LinkSettings(
            parent_pid=os.getpid(),
            silence_limit_s=options.silence_limit_s,
            heartbeat_limit_s=options.heartbeat_limit_s,
            settle_tolerance_deg=options.settle_tolerance_deg,
            real_time_priority=options.real_time_priority,
            rehearsal_lead_us=options.rehearsal_lead_us,
            force_filter_s=options.force_filter_s,
            force_at_rest_N=options.force_at_rest_N,
            handover_fd=theirs.fileno(),
            model=options.model.value,
            cycle_s=options.cycle_s,
            starved_cycles=script_settings(options).STARVED_CYCLES,
            calibration=self._calibration,
        )
        with theirs:
            try:
                self.open_link = LinkClient(
                    settings,
                    PROCESS,
                    STREAM_ERRORS,
                    timeout_s,
                    self.recorder.rtde_sink,
                    self._clock,
                    inherited=(theirs.fileno(),),
                )
            except BaseException as error:
                ours.close()
                if isinstance(error, StartRefused):
                    raise LinkNotStarted(f"the real-time process: {os.strerror(error.errno)}") from None
                raise
        self._channel = ours

    def start_stream(
        self, timeout_s: float, limits: Callable[[OperatingMode], MotionLimits]
    ) -> OperatingMode:
        """Switch the arm on, send recipes and script, and wait until the script uses our set-points.

        Nothing moves: the first set-point is where the controller holds the arm. Switching on may take longer
        than `timeout_s`. Returns the operating mode, to whose limits process and monitor keep.
        """
        self._require_ready()
        self._switch_on()
        deadline = time.monotonic() + timeout_s
        link, name = self.link, self._name
        mode = self._operating_mode(self.dashboard.safety_mode(ASK_LIMIT_S))
        run = 1 + secrets.randbits(30)
        is_reduced = mode is OperatingMode.REDUCED_SPEED
        safety = SafetyMode.REDUCED if is_reduced else SafetyMode.NORMAL
        self._hand_over(run, safety, remaining_s(deadline))
        number = link.command(CommandKind.OPEN, limits=limits(mode))
        opened = link.wait(
            lambda s: s.command_number >= number and (s.device_clock > 0 or s.phase is not Phase.ARMED),
            remaining_s(deadline),
        )
        if opened is None or opened.phase is not Phase.ARMED:
            raise self._start_error("the controller sends no packages", timeout_s)
        self.primary.messages.clear()
        settings = script_settings(self._options)
        load = load_commands(self._load, self._options.payload_kg)
        self.primary.send_script(render_script(settings, load))
        started = link.wait(lambda s: s.phase is not Phase.ARMED, remaining_s(deadline))
        if started is None:
            raise self._start_error("the script does not start", timeout_s)
        fault = fault_error(
            stream_faults(name, self.kinematics, self._options), self._options, link.state, mode
        )
        if fault is not None:
            raise fault
        if load:
            self._require_load(max(remaining_s(deadline), ASK_LIMIT_S))
        return mode

    def set_load(self, load: ToolLoad, timeout_s: float) -> ToolLoad:
        """Tell the controller the load, also at later starts, and return it as read back; raises URD-040."""
        self._load = load
        self._require_remote()
        self.primary.send_script(render_secondary(load_commands(load)))
        return self._require_load(timeout_s)

    def read_load(self, timeout_s: float, accept: Callable[[ToolLoad], bool] = lambda _: True) -> ToolLoad:
        """Read the load that the controller assumes, until it is as wanted or the time is over."""
        rtde = RtdeSetup(self._rtde.host, self._rtde.port, timeout_s)
        self._clock.let_pass(timeout_s)
        try:
            values = rtde.read_outputs(LOAD_FIELDS, lambda values: accept(to_load(values)))
        finally:
            self._clock.hold_back()
            rtde.close()
        return to_load(values)

    def _require_load(self, timeout_s: float) -> ToolLoad:
        wanted, mass_kg = self._load, self._options.payload_kg
        found = self.read_load(timeout_s, lambda load: has_load(load, wanted, mass_kg))
        if not has_load(found, wanted, mass_kg):
            raise LoadNotTaken(
                f"{self._name}: the controller does not use the load that was set",
                expected=f"{(wanted.mass_kg if wanted else mass_kg):g} kg",
                got=f"{found.mass_kg:g} kg, centre {found.centre_mm} mm, tip {found.tip_mm} mm",
            )
        return found

    def end_stream(self, deadline: float) -> None:
        """End the script by its order, or by the dashboard if that fails, and close the RTDE connection."""
        link = self.link
        number = link.command(CommandKind.END)
        state = link.wait(lambda s: s.command_number >= number, remaining_s(deadline))
        ended = None
        if state is not None and state.phase is Phase.ENDING and state.fault is not Fault.SILENCE:
            ended = link.wait(
                lambda s: ControllerWord.from_number(s.controller_word).script_state == ScriptState.ENDED,
                min(remaining_s(deadline) / 2, END_LIMIT_S),
            )
        if ended is None:
            self.dashboard.require("stop", "Stopped", max(remaining_s(deadline), SHORTEST_TRY_S))
        number = link.command(CommandKind.CLOSE)
        link.wait(lambda s: s.command_number >= number, remaining_s(deadline))
        self._await(lambda: not self.dashboard.is_program_running(ASK_LIMIT_S) or None, deadline)

    def acknowledge(self, person: str, deadline: float) -> None:
        """End any program and release what a person has to release; moves nothing.

        Raises URD-006, URD-007, URD-009 or URD-010 for what remains.
        """
        dashboard = self.dashboard
        self._require_remote()
        dashboard.require("stop", "Stopped", ASK_LIMIT_S)
        safety = dashboard.safety_mode(ASK_LIMIT_S)
        if safety is SafetyMode.PROTECTIVE_STOP:
            self._unlock(person, deadline)
        elif safety in RESTART_MODES:
            dashboard.ask("close safety popup", ASK_LIMIT_S)
            dashboard.require("restart safety", "Restarting safety", ASK_LIMIT_S)
        if safety in (SafetyMode.PROTECTIVE_STOP, *RESTART_MODES):
            self._await(lambda: dashboard.safety_mode(ASK_LIMIT_S) in NORMAL_MODES or None, deadline)
        self._require_safe()

    def switch_off(self, timeout_s: float) -> None:
        """Switch the arm off."""
        self.dashboard.require("power off", "Powering off", timeout_s)

    def close_control(self) -> None:
        """Close dashboard and primary interface, if open."""
        for connection in (self.open_primary, self.open_dashboard):
            if connection is not None:
                connection.close()
        self.open_primary = self.open_dashboard = None

    def close_link(self) -> None:
        """Stop the real-time process, if running."""
        if self.open_link is not None:
            self.open_link.close()
            self.open_link = None
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def _identify(self, timeout_s: float) -> Identity:
        """Connect and check the arm; raises URD-002 to URD-005, ARM-010."""
        options, deadline = self._options, time.monotonic() + timeout_s
        address, recorder = self._dashboard_address, self.recorder
        self.open_dashboard = dashboard = DashboardClient(
            address.host, address.port, timeout_s, recorder.sink_of("dashboard")
        )
        model = dashboard.ask("get robot model", remaining_s(deadline))
        serial = dashboard.ask("get serial number", remaining_s(deadline))
        version = self._read_version(remaining_s(deadline))
        self._require_arm(model, serial, version)
        address = self._primary_address
        self.open_primary = PrimaryClient(
            address.host, address.port, remaining_s(deadline), recorder.sink_of("primary")
        )
        self._clock.let_pass(timeout_s)
        try:
            info = self.open_primary.await_kinematics(remaining_s(deadline))
            self.open_primary.await_state(remaining_s(deadline))
        finally:
            self._clock.hold_back()
        details = (("calibration", info.fingerprint), ("cycle_ms", f"{options.cycle_s * 1e3:g}"))
        model_name = universal_robot(options.model).name
        identity = Identity("Universal Robots", model_name, serial, str(version), details)
        if self._identity is not None and self._identity != identity:
            raise ControllerExchanged(
                f"{self._name}: another arm or controller answers than at the start",
                expected=_describe(self._identity),
                got=_describe(identity),
            )
        self._use_calibration(info)
        self._identity = identity
        return identity

    def _read_version(self, timeout_s: float) -> Version:
        """Read the controller's version by RTDE, and check that it has the fields of our stream."""
        rtde = RtdeSetup(self._rtde.host, self._rtde.port, timeout_s)
        try:
            version = rtde.read_version()
            major, least = MAJOR_VERSION[self._options.model], LEAST_MINOR[self._options.model]
            if version.major == major and version.minor < least:
                raise WrongVersion(
                    f"{self._name}: the controller's software is too old",
                    expected=f"{major}.{least} or newer",
                    got=str(version),
                )
            rtde.set_up_outputs(1.0)
            return version
        finally:
            rtde.close()

    def _require_arm(self, model: str, serial: str, version: Version) -> None:
        options = self._options
        if model != ARM_TYPE or version.major != MAJOR_VERSION[options.model]:
            raise WrongArm(
                f"{self._name}: the controller drives another arm",
                expected=f"option model, {options.model}",
                got=_arm_text(model, version),
            )
        if options.serial and serial != options.serial:
            raise WrongArm(
                f"{self._name}: the arm has another serial number",
                expected=f"option serial, {options.serial}",
                got=serial,
            )

    def _use_calibration(self, info: KinematicsInfo) -> None:
        options = self._options
        if options.calibration and info.fingerprint != options.calibration:
            raise FactoryCalibrationDiffers(
                f"{self._name}: the controller has the factory calibration of another arm",
                expected=f"option calibration, {options.calibration}",
                got=info.fingerprint,
            )
        if not options.factory_calibration:
            return
        nominal = universal_robot(options.model).dimensions
        calibration = FactoryCalibration.from_parameters(
            nominal, info.theta_rad, info.a_mm, info.d_mm, info.alpha_rad
        )
        self.kinematics = CalibratedUniversalRobot(nominal, calibration)
        self._calibration = (
            *calibration.theta_rad,
            *calibration.a_mm,
            *calibration.d_mm,
            *calibration.alpha_rad,
        )

    def _require_ready(self) -> None:
        """Raise what prevents a start before anything is switched on or sent."""
        dashboard, name = self.dashboard, self._name
        self._require_remote()
        self._require_safe()
        if dashboard.is_program_running(ASK_LIMIT_S):
            raise AnotherProgramRuns(f"{name}: the controller is running another program")
        reported = self.reported
        if reported is not None and not reported.mode.speed_fraction > 0.0:
            raise SpeedAtZero(f"{name}: the speed slider is at {reported.mode.speed_fraction:.0%}")

    def _switch_on(self) -> None:
        """Switch power on and release the brakes; raises URD-008 if that takes too long."""
        dashboard, deadline = self.dashboard, time.monotonic() + POWER_LIMIT_S
        mode = dashboard.robot_mode(ASK_LIMIT_S)
        if mode is RobotMode.RUNNING:
            return
        if mode not in (RobotMode.IDLE, RobotMode.BACKDRIVE):
            dashboard.require("power on", "Powering on", ASK_LIMIT_S)
            self._await_mode((RobotMode.IDLE, RobotMode.RUNNING), deadline)
        dashboard.require("brake release", "Brake releasing", ASK_LIMIT_S)
        self._await_mode((RobotMode.RUNNING,), deadline)

    def _await_mode(self, modes: tuple[RobotMode, ...], deadline: float) -> None:
        def reached() -> bool | None:
            return self.dashboard.robot_mode(ASK_LIMIT_S) in modes or None

        if self._await(reached, deadline) is None:
            raise NotPowered(
                f"{self._name}: the arm was not switched on",
                expected=RobotMode.RUNNING.name,
                limit=f"{POWER_LIMIT_S:g} s",
                got=self.dashboard.robot_mode(ASK_LIMIT_S).name,
            )

    def _hand_over(self, run: int, safety: SafetyMode, timeout_s: float) -> None:
        """Open a new RTDE connection with our recipes, and give it to the real-time process."""
        rtde = RtdeSetup(self._rtde.host, self._rtde.port, timeout_s)
        try:
            outputs = rtde.set_up_outputs(round(1.0 / self._options.cycle_s))
            inputs = rtde.set_up_inputs()
            if self._channel is None:
                raise LinkNotStarted(f"{self._name}: no real-time process is running")
            Handover(outputs, inputs, run, safety).give(self._channel, rtde.socket)
        finally:
            rtde.close()  # the process has its own descriptor

    def _start_error(self, what: str, timeout_s: float) -> RonnaError:
        """Build the error for a stream that does not start, with what the controller says about it."""
        try:
            self._require_remote()
            self._require_safe()
        except RonnaError as error:
            return error
        texts = [m.text for m in self.primary.messages if m.kind == MessageKind.RUNTIME_EXCEPTION and m.text]
        word = ControllerWord.from_number(self.link.state.controller_word)
        return ScriptNotStarted(
            f"{self._name}: {what}" + "".join(f"; the controller says: {text}" for text in texts[-1:]),
            limit=f"{timeout_s:g} s",
            got=word.text,
        )

    def _require_remote(self) -> None:
        if self.is_remote(ASK_LIMIT_S) is False:
            raise LocalMode(f"{self._name}: the controller is in local control", expected="remote control")

    def _require_safe(self) -> None:
        refusal = safety_refusal(self._name, self.dashboard.safety_mode(ASK_LIMIT_S))
        if refusal is not None:
            raise refusal

    def _unlock(self, person: str, deadline: float) -> None:
        """Release a protective stop in the name of a person, as soon as the controller permits it."""
        dashboard = self.dashboard
        with contextlib.suppress(NoAnswer):
            dashboard.ask(f"addToLog protective stop released by {_ascii(person)}", ASK_LIMIT_S)
        dashboard.ask("close safety popup", ASK_LIMIT_S)
        while True:
            answer = dashboard.ask("unlock protective stop", ASK_LIMIT_S)
            if answer.lower().startswith("protective stop releasing"):
                return
            if remaining_s(deadline) <= UNLOCK_PAUSE_S:
                raise ProtectivelyStopped(f"{self._name}: the protective stop remains", got=answer)
            self._pause(UNLOCK_PAUSE_S)

    def _await(self, find: Callable[[], T | None], deadline: float) -> T | None:
        """Poll until a host time; returns None if nothing was found by then."""
        while (found := find()) is None:
            if remaining_s(deadline) <= 0.0:
                return None
            self._pause(POLL_S)
        return found

    def _pause(self, host_s: float) -> None:
        """Wait, and let theatre time pass: the controller may need it."""
        self._clock.let_pass(PASSING_SHARE * host_s)
        try:
            time.sleep(host_s)
        finally:
            self._clock.hold_back()

    def _operating_mode(self, safety: SafetyMode) -> OperatingMode:
        return OperatingMode.REDUCED_SPEED if safety is SafetyMode.REDUCED else OperatingMode.AUTOMATIC


class LinkRecorder:
    """Optional traffic recorder for all connections; takes effect when a connection is opened."""

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self.sink: ByteSink | None = None

    def sink_of(self, interface: str) -> Callable[[Direction, bytes], None] | None:
        """Recorder callback for an interface, or None without a recorder."""
        sink, link = self.sink, f"{self._arm}.{interface}"
        if sink is None:
            return None
        return lambda direction, data: sink.on_bytes(link, direction, data)

    @property
    def rtde_sink(self) -> TrafficHandler | None:
        """Recorder callback for RTDE traffic, or None without a recorder."""
        return None if self.sink is None else pass_traffic(self.sink, f"{self._arm}.rtde")


def _describe(identity: Identity) -> str:
    calibration = dict(identity.details)["calibration"]
    return f"{identity.serial}, software {identity.firmware}, calibration {calibration}"


def _arm_text(model: str, version: Version) -> str:
    """Say which arm the controller drives, and how that is known."""
    found = next((m for m, major in MAJOR_VERSION.items() if major == version.major), None)
    if model != ARM_TYPE or found is None:
        return f"{model}, software {version}"
    return (
        f"{found}: the dashboard calls both generations {ARM_TYPE}, and software {version} is that of "
        f"{GENERATIONS[found]}"
    )


def _ascii(name: str) -> str:
    return name.encode("ascii", "replace").decode()


def remaining_s(deadline: float) -> float:
    """Return the time remaining until a deadline on the host's monotonic clock, at least 0."""
    return max(deadline - time.monotonic(), 0.0)
