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
from contextlib import AbstractContextManager
from dataclasses import replace
from itertools import chain

from drivers.universal_robots.controller.script import render_script, render_secondary
from drivers.universal_robots.dashboard import DashboardClient
from drivers.universal_robots.errors import (
    ANOTHER_PROGRAM_RUNS,
    LOAD_NOT_TAKEN,
    SCRIPT_NOT_STARTED,
    SPEED_AT_ZERO,
    STREAM_ERRORS,
    RegistersInUse,
)
from drivers.universal_robots.faults import UrFaults
from drivers.universal_robots.identification import (
    identity_of,
    require_arm,
    require_calibration,
    require_same,
    require_version,
)
from drivers.universal_robots.loads import LOAD_FIELDS, has_load, load_commands, to_load
from drivers.universal_robots.options import ROLES, link_settings, script_settings
from drivers.universal_robots.power import ASK_LIMIT_S, PowerAndSafety
from drivers.universal_robots.primary.client import ControllerState, PrimaryClient
from drivers.universal_robots.realtime.loop import Handover
from drivers.universal_robots.realtime.packages import ControllerWord
from drivers.universal_robots.realtime.settings import build_kinematics
from drivers.universal_robots.rtde import RtdeSetup, Version
from drivers.universal_robots.services import require_own_services
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm_stream.client import LinkClient, StartRefused
from ronna_hw.arm_stream.connections import StreamConnections, remaining_s
from ronna_hw.arm_stream.records import LinkState, OpenStream, StreamPhase
from ronna_hw.clock import Clock, passing
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.contact import ToolLoad
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.robot import OperatingMode
from ronna_hw.errors import RonnaError
from ronna_hw.wire.universal_robots import SafetyMode, ScriptState
from ronna_hw.wire.universal_robots_services import DashboardOrder, MessageKind, Query

PROCESS = "drivers.universal_robots.realtime.process"
STATE_PERIOD_S = 0.1  # of the primary interface


class Connections(StreamConnections[ControllerState, PrimaryClient]):
    """Connections of one arm; the control channel is the primary interface."""

    faults: UrFaults

    def __init__(self, faults: UrFaults, config: DeviceConfig, clock: Clock) -> None:
        """Check the endpoints without connecting; raises CFG-001 or CFG-002."""
        super().__init__(faults, clock)
        addresses = config.require_addresses(ROLES, faults.name)
        require_own_services(faults.name, addresses)
        self._rtde = addresses["rtde"]
        self._dashboard_address, self._primary_address = addresses["dashboard"], addresses["primary"]
        self._name, self._options = faults.name, faults.options
        self.open_dashboard: DashboardClient | None = None
        self.calibration: tuple[float, ...] = ()  # columns of the factory calibration, one after the other
        self._identity: Identity | None = None  # found first: another one is refused
        self._load: ToolLoad | None = None  # set by a caller, and sent again with each script
        self.power = PowerAndSafety(faults.name, faults.options.model, clock, lambda: self.dashboard)
        self._channel: socket.socket | None = None  # over which connections are handed to the process

    @property
    def dashboard(self) -> DashboardClient:
        """Open dashboard connection; raises URD-002 if not connected."""
        if self.open_dashboard is None:
            raise STREAM_ERRORS.not_found(f"{self._name}: no dashboard connection is open")
        return self.open_dashboard

    def request_state(self, timeout_s: float) -> ControllerState:
        """Return a state that arrived after this call; raises URD-002, URD-014 or URD-015.

        No more theatre time passes than that takes.
        """
        with passing(self.clock, STATE_PERIOD_S):
            return self.control.await_new_state(timeout_s)

    def registers_taken(self, timeout_s: float) -> str:
        """Return who has the registers of our script, with the code of the error; empty if nobody has."""
        try:
            with self._open_rtde(timeout_s) as rtde:  # frees them when it is closed
                rtde.set_up_inputs()
        except RegistersInUse as error:
            return f"{error.code} {error.summary}"
        return ""

    def start_link(self, timeout_s: float) -> None:
        """Start the real-time process; raises URD-020."""
        self.close_link()
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        options = self._options
        settings = link_settings(options, theirs.fileno(), self.calibration)
        with theirs:
            try:
                self.open_link = LinkClient(
                    settings,
                    PROCESS,
                    STREAM_ERRORS,
                    timeout_s,
                    self._traffic_of("rtde"),
                    self.clock,
                    inherited=(theirs.fileno(),),
                )
            except BaseException as error:
                ours.close()
                if isinstance(error, StartRefused):
                    raise STREAM_ERRORS.not_started(
                        f"the real-time process: {os.strerror(error.errno)}"
                    ) from None
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
        self.power.switch_on()
        deadline = time.monotonic() + timeout_s
        link = self.link
        is_reduced = self.dashboard.safety_mode(ASK_LIMIT_S) is SafetyMode.REDUCED
        safety = SafetyMode.REDUCED if is_reduced else SafetyMode.NORMAL
        mode = OperatingMode.REDUCED_SPEED if is_reduced else OperatingMode.AUTOMATIC
        run = 1 + secrets.randbits(30)
        self._hand_over(run, safety, remaining_s(deadline))
        number = link.command(OpenStream(limits(mode)))
        opened = link.wait(
            lambda s: s.command_number >= number and (s.device_clock > 0 or s.phase is not StreamPhase.ARMED),
            remaining_s(deadline),
        )
        if opened is None or opened.phase is not StreamPhase.ARMED:
            raise self._start_error("the controller sends no packages", timeout_s)
        self.control.messages.clear()
        settings = script_settings(self._options)
        load = load_commands(self._load, self._options.payload_kg)
        self.control.send_script(render_script(settings, load))
        started = link.wait(
            lambda s: s.phase is not StreamPhase.ARMED or self.control.failure is not None,
            remaining_s(deadline),
        )
        if started is None or started.phase is StreamPhase.ARMED:
            raise self._start_error("the script does not start", timeout_s)
        if (fault := self.faults.error(link.state, mode)) is not None:
            raise fault
        if load:
            self._require_load(max(remaining_s(deadline), ASK_LIMIT_S))
        self.power.require_not_switching_off()
        return mode

    def set_load(self, load: ToolLoad, timeout_s: float) -> ToolLoad:
        """Tell the controller the load, also at later starts, and return it as read back; raises URD-040."""
        self._load = load
        self.power.require_remote()
        self.control.send_script(render_secondary(load_commands(load)))
        return self._require_load(timeout_s)

    def read_load(self, timeout_s: float, accept: Callable[[ToolLoad], bool] = lambda _: True) -> ToolLoad:
        """Read the load that the controller assumes, until it is as wanted or the time is over."""
        with self._open_rtde(timeout_s) as rtde, passing(self.clock, timeout_s):
            return to_load(rtde.read_outputs(LOAD_FIELDS, lambda values: accept(to_load(values))))

    def _require_load(self, timeout_s: float) -> ToolLoad:
        wanted, mass_kg = self._load, self._options.payload_kg
        found = self.read_load(timeout_s, lambda load: has_load(load, wanted, mass_kg))
        if not has_load(found, wanted, mass_kg):
            raise LOAD_NOT_TAKEN(
                f"{self._name}: the controller does not use the load that was set",
                expected=f"{(wanted.mass_kg if wanted else mass_kg):g} kg",
                got=f"{found.mass_kg:g} kg, centre {found.centre_mm} mm, tip {found.tip_mm} mm",
            )
        return found

    def end_stream(self, deadline: float) -> None:
        """End the script by its order, or by the dashboard if that fails, and close the RTDE connection."""
        super().end_stream(deadline)
        self.power.await_condition(lambda: not self.dashboard.is_program_running(ASK_LIMIT_S), deadline)

    def stop_program(self, timeout_s: float) -> None:
        """Stop whatever program runs, by a new connection if the dashboard's has been closed."""
        try:
            self.dashboard.ask(DashboardOrder.STOP, timeout_s)
        except RonnaError:
            address = self._dashboard_address
            with contextlib.closing(DashboardClient(address.host, address.port, timeout_s)) as anew:
                anew.ask(DashboardOrder.STOP, timeout_s)

    def acknowledge(self, person: str, deadline: float) -> None:
        """End any program and release what a person has to release; moves nothing.

        Raises URD-006, URD-007, URD-009 or URD-010 for what remains.
        """
        self.power.acknowledge(person, deadline)

    def close_control(self) -> None:
        """Close dashboard and primary interface, if open."""
        super().close_control()
        if self.open_dashboard is not None:
            self.open_dashboard.close()
            self.open_dashboard = None

    def close_link(self) -> None:
        """Stop the real-time process, if running."""
        super().close_link()
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def _ask(self, timeout_s: float) -> None:
        """Ask the dashboard and await a state: a change of the control mode closes the primary interface."""
        self.dashboard.robot_mode(timeout_s)
        self.request_state(timeout_s)

    def _await_program_end(self, timeout_s: float) -> bool:
        def has_ended(state: LinkState) -> bool:
            return ControllerWord.from_number(state.controller_word).script_state == ScriptState.ENDED

        return self.link.wait(has_ended, timeout_s) is not None

    def _end_program(self, timeout_s: float) -> None:
        self.dashboard.require(DashboardOrder.STOP, timeout_s)

    def _identify(self, timeout_s: float) -> Identity:
        """Connect and check the arm; raises URD-002 to URD-005, ARM-010."""
        options, deadline = self._options, time.monotonic() + timeout_s
        address = self._dashboard_address
        self.open_dashboard = dashboard = DashboardClient(
            address.host, address.port, timeout_s, self._bytes_of("dashboard")
        )
        model = dashboard.ask(Query.ROBOT_MODEL, remaining_s(deadline))
        serial = dashboard.ask(Query.SERIAL_NUMBER, remaining_s(deadline))
        version = self._read_version(remaining_s(deadline))
        require_arm(self._name, options, model, serial, version)
        address = self._primary_address
        self.open_control = primary = PrimaryClient(
            address.host, address.port, remaining_s(deadline), self._bytes_of("primary")
        )
        with passing(self.clock, timeout_s):
            info = primary.await_kinematics(remaining_s(deadline))
            primary.await_state(remaining_s(deadline))
        identity = identity_of(options, serial, version, info)
        require_same(self._name, self._identity, identity)
        if (calibration := require_calibration(self._name, options, info)) is not None:
            columns = (calibration.theta_rad, calibration.a_mm, calibration.d_mm, calibration.alpha_rad)
            self.adopt_calibration(tuple(chain.from_iterable(columns)))
        self._identity = identity
        return identity

    def adopt_calibration(self, columns: tuple[float, ...]) -> None:
        """Compute the arm by this factory calibration from now on; raises ARM-010."""
        self.calibration = columns
        self.faults = replace(self.faults, arm=build_kinematics(self._options.model, columns))

    def _read_version(self, timeout_s: float) -> Version:
        """Read the controller's version by RTDE, and check that it has the fields of our stream."""
        with self._open_rtde(timeout_s) as rtde:
            version = rtde.read_version()
            require_version(self._name, self._options, version)
            rtde.set_up_outputs(1.0)
            return version

    def _require_ready(self) -> None:
        """Raise what prevents a start before anything is switched on or sent."""
        dashboard, name = self.dashboard, self._name
        self.power.require_remote()
        if self.control.failure is not None:  # a script would be sent to nobody
            raise self.control.failure
        self.power.require_safe()
        if dashboard.is_program_running(ASK_LIMIT_S):
            raise ANOTHER_PROGRAM_RUNS(f"{name}: the controller is running another program")
        if (reported := self.reported) is not None and not reported.mode.speed_fraction > 0.0:
            raise SPEED_AT_ZERO(f"{name}: the speed slider is at {reported.mode.speed_fraction:.0%}")

    def _hand_over(self, run: int, safety: SafetyMode, timeout_s: float) -> None:
        """Open a new RTDE connection with our recipes, and give it to the real-time process."""
        with self._open_rtde(timeout_s) as rtde:  # when it is closed, the process has its own descriptor
            outputs = rtde.set_up_outputs(round(1.0 / self._options.cycle_s))
            inputs = rtde.set_up_inputs()
            if self._channel is None:
                raise STREAM_ERRORS.not_started(f"{self._name}: no real-time process is running")
            Handover(outputs, inputs, run, safety).give(self._channel, rtde.socket)

    def _open_rtde(self, timeout_s: float) -> AbstractContextManager[RtdeSetup]:
        return contextlib.closing(RtdeSetup(self._rtde.host, self._rtde.port, timeout_s))

    def _start_error(self, what: str, timeout_s: float) -> RonnaError:
        """Build the error for a stream that does not start, with what the controller says about it."""
        try:
            self.power.require_remote()
            self.power.require_safe()
        except RonnaError as error:
            return error
        if self.control.failure is not None:  # with our script, perhaps: sending it tells nothing
            return STREAM_ERRORS.lost(
                f"{self._name}: {self.control.where} closed the connection before our script ran",
                expected="no change between local and remote control during a start",
            )
        texts = [m.text for m in self.control.messages if m.kind == MessageKind.RUNTIME_EXCEPTION and m.text]
        word = ControllerWord.from_number(self.link.state.controller_word)
        return SCRIPT_NOT_STARTED(
            f"{self._name}: {what}" + "".join(f"; the controller says: {text}" for text in texts[-1:]),
            limit=f"{timeout_s:g} s",
            got=word.text,
        )
