"""The unit: mode, settings, loaded tools and the current frame."""

from __future__ import annotations

from dataclasses import replace

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import ILLUMINATOR_RATES_HZ, SystemStatus
from sim.polaris.line.line_settings import DEFAULT_LINE
from sim.polaris.measurement.frame import DEVICE, Frame, Measurer
from sim.polaris.optics.measuring_volume import Volume
from sim.polaris.tools.ports import Port, PortTable
from sim.polaris.tools.wired_tools import WiredPorts
from sim.polaris.unit.alerts import Alerts
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.frame_counter import FrameCounter
from sim.polaris.unit.mode import Mode
from sim.polaris.unit.model import SPECTRA, UnitModel
from sim.polaris.unit.refusal import Refusal
from sim.polaris.unit.user_parameter_table import WATCH_DOG
from sim.polaris.unit.user_parameters import UserParameters
from sim.world.faults import FaultBoard
from sim.world.world import World


class Unit:
    """A Polaris unit in a scene."""

    def __init__(
        self,
        world: World,
        model: UnitModel = SPECTRA,
        behaviour: UnitBehaviour | None = None,
        wired: WiredPorts | None = None,
    ) -> None:
        self.model = model
        self.behaviour = behaviour or UnitBehaviour()
        self.clock = world.clock
        self.seed = world.scene.seed
        self.faults = FaultBoard(world, DEVICE)
        self.mode = Mode.NOT_INITIALISED
        self.line = DEFAULT_LINE
        self.ports = PortTable(model.handles)
        self.wired = wired or WiredPorts(0)
        self.measurer = Measurer(world, model.volumes)
        self.frames = FrameCounter(world.clock)
        self.alerts = Alerts()
        self.port_changes = SystemStatus(0)  # wired tools plugged in or out
        self.infrared_checked = False
        self.beeps_until_s = 0.0
        self._frame: Frame | None = None
        self._frame_was_lost = False  # lost on its way to the host, which will request it again
        self.user_parameters = UserParameters(model, self.wired.count, self.alerts, lambda: self.mode.value)
        rate = min(self.behaviour.saved_illuminator_rate, max(model.illuminator_rates))
        self.user_parameters.save_value(wire.PARAMETER_ILLUMINATOR_RATE, str(rate))

    def loaded_tools(self) -> list[str]:
        """Part numbers of the tools that the host has loaded or plugged in."""
        return [port.definition.part_number for port in self.ports if port.definition is not None]

    def initialise(self) -> None:
        """INIT: to setup mode; passive handles are freed, plugged-in tools get theirs."""
        self.frames.stop()
        self.mode = Mode.SETUP
        self.infrared_checked = False
        if self.behaviour.init_forgets_handles:
            self.ports.free_all()
        for number in sorted(self.wired.plugged):
            self._give_handle(number)

    def reset(self) -> None:
        """Power-up or break: saved settings, default line, not initialised."""
        self.mode = Mode.NOT_INITIALISED
        self.line = DEFAULT_LINE
        self.frames.stop()
        self.frames = FrameCounter(self.clock)
        self.ports.free_all()
        self.alerts.reset()
        self.user_parameters.reset()
        self.port_changes = SystemStatus(0)
        self.infrared_checked = False

    def restore_line(self) -> None:
        """Back to 9600 8N1."""
        self.line = DEFAULT_LINE

    def start_tracking(self, *, restart: bool) -> None:
        """To tracking mode; with `restart` the frame number starts at zero."""
        self._begin(restart=restart)
        self.measurer.begin_tracking()
        self.mode = Mode.TRACKING

    def start_diagnostic(self) -> None:
        """To diagnostic mode."""
        self._begin(restart=False)
        self.mode = Mode.DIAGNOSTIC

    def stop(self) -> None:
        """From tracking or diagnostic mode back to setup mode; handles stay as they are."""
        self.frames.stop()
        self.mode = Mode.SETUP

    def take_time(self, duration_s: float) -> None:
        """Delay the current command by this much theatre time."""
        self.clock.sleep(duration_s)

    def plug(self, number: int) -> None:
        """Plug in a wired tool; an initialised unit gives it a handle."""
        if number in self.wired.plugged or number not in self.wired.tools:
            return
        self.wired.plugged.add(number)
        if self.mode is not Mode.NOT_INITIALISED:
            self._give_handle(number)
            self._port_changed(SystemStatus.PORT_OCCUPIED)

    def unplug(self, number: int) -> None:
        """Unplug a wired tool."""
        if number not in self.wired.plugged:
            return
        self.wired.plugged.discard(number)
        self.ports.unplug(number)
        self._port_changed(SystemStatus.PORT_UNOCCUPIED)

    @property
    def volume(self) -> Volume:
        """The selected volume."""
        return self.model.volumes[self.user_parameters.number(wire.PARAMETER_SELECTED_VOLUME)]

    @property
    def watch_dog_s(self) -> int:
        """Seconds without a command after which the watchdog trips; 0 for never."""
        return self.user_parameters.number(WATCH_DOG)

    def frame(self) -> Frame:
        """The current frame, measured once however often it is requested."""
        faulty = self.frames.missed or not self.faults.empty
        if faulty and self._frame is not None and self._holds_frame():
            return self._frame
        number = self._next_number()
        status = self.alerts.system_status | self.port_changes | self.measurer.light
        kept = self._frame
        if kept is None or kept.number != number or kept.system_status != status:
            kept = self._frame = self._measured(number, status, self.ports.enabled())
        if self.port_changes and self.behaviour.port_change_until == "reply":
            self.port_changes = SystemStatus(0)
        return kept

    def get_in_step(self) -> None:
        """The host resynchronises after a disturbance of the line."""
        self._frame_was_lost = True

    def diagnostic_frame(self, port: Port) -> Frame:
        """One tool, enabled or not, and everything else in view, in diagnostic mode."""
        self.measurer.forget_tools()  # the previous one may have been of another tool
        return self._measured(self.frames.number(), self.alerts.system_status, (port,))

    def _measured(self, number: int, status: SystemStatus, ports: tuple[Port, ...]) -> Frame:
        seen = tuple(port for port in ports if port.occupied)
        since_start = self.frames.since_start(number)
        frame = self.measurer.frame(number, since_start, seen, self.volume, status)
        if frame.strays and not any(port.reflects for port in seen):
            frame = replace(frame, strays=())  # only enabled passive handles make the illuminators fire
        listed = [port for port in self.ports if port in ports or self.behaviour.lists_disabled_handles]
        if len(listed) > len(seen):
            found = {port.handle: tracked for port, tracked in frame.tools}
            frame = replace(frame, tools=tuple((port, found.get(port.handle)) for port in listed))
        return frame

    def _next_number(self) -> int:
        """Number of the frame that a request gets.

        If each request gets exactly one frame, one that was lost on the line is sent again: otherwise all
        later ones would differ, with other noise.
        """
        lost, self._frame_was_lost = self._frame_was_lost, False
        again = lost and self._frame is not None and self.frames.last_is_newest
        return self.frames.last if again else self.frames.number()

    def _holds_frame(self) -> bool:
        """True while a fault blocks new measurements; another fault makes the unit skip frames."""
        self.frames.missed = sum(int(fault.argument) for fault in self.faults.active("skip_frames"))
        if not self.faults.active("repeat_frames"):
            return False
        self.frames.pass_one()
        return True

    def _begin(self, *, restart: bool) -> None:
        rate = self.user_parameters.number(wire.PARAMETER_ILLUMINATOR_RATE)
        self.frames.start(restart=restart, rate_hz=ILLUMINATOR_RATES_HZ[rate])
        self.measurer.forget_tools()
        self._frame = None

    def _give_handle(self, number: int) -> None:
        tool = self.wired.tool(number)
        if tool is not None and self.ports.of_socket(number) is None:
            try:
                self.ports.request_wired(number, tool)
            except Refusal:  # no handle left: the tool waits for one
                return

    def _port_changed(self, what: SystemStatus) -> None:
        self.port_changes |= what
        self._frame = None
