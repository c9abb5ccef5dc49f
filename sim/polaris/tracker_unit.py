"""Tracker unit: mode, settings, tools and current frame.

Frame numbers count 60 per second of theatre time, whatever the illuminator rate. On a clock that follows the
host, a request gets the latest frame, or the same one again if it comes too soon. On a clock that its users
advance, each request waits for the next frame, so it gets exactly one; from the first request to the end of
tracking, robot cycles do not pass a frame before it is requested.
"""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum

from ronna_hw.clock import SharedClock
from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import FRAME_RATE_HZ, ILLUMINATOR_RATES_HZ, SystemStatus
from sim.polaris.measurement.frame import DEVICE, MeasuredFrame, Measurer
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.framing import DEFAULT_LINE
from sim.polaris.unit.model import SPECTRA, UnitModel, UnitVolume
from sim.polaris.unit.ports import Port, PortTable, WiredPorts
from sim.polaris.unit.refusal import CommandRefusal
from sim.polaris.unit.user_parameters import WATCH_DOG, Alerts, UserParameters
from sim.world.faults import FaultBoard
from sim.world.world import World

NANOSECONDS_PER_SECOND = 1_000_000_000
COUNTS_PER_SECOND = int(FRAME_RATE_HZ)


class UnitMode(StrEnum):
    """Operating modes, with values as in `Info.Status.System Mode`."""

    NOT_INITIALISED = "Booted"
    SETUP = "Initialized"
    TRACKING = "Tracking"
    DIAGNOSTIC = "Diagnostic"


class SimulatedUnit:
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
        self.mode = UnitMode.NOT_INITIALISED
        self.line = DEFAULT_LINE
        self.ports = PortTable(model.handles)
        self.wired = wired or WiredPorts(0)
        self.measurer = Measurer(world, model.volumes)
        self.frames = FrameCounter(world.clock)
        self.alerts = Alerts()
        self.port_changes = SystemStatus(0)  # wired tools plugged or unplugged
        self.infrared_checked = False
        self.beeps_until_s = 0.0
        self._frame: MeasuredFrame | None = None
        self._frame_was_lost = False  # on the line; the host will request it again
        self.user_parameters = UserParameters(model, self.wired.count, self.alerts, lambda: self.mode.value)
        rate = min(self.behaviour.saved_illuminator_rate, max(model.illuminator_rates))
        self.user_parameters.save_value(wire.PARAMETER_ILLUMINATOR_RATE, str(rate))

    def list_loaded_tools(self) -> list[str]:
        """Return the part numbers of tools that the host has loaded or plugged in."""
        return [port.definition.part_number for port in self.ports if port.definition is not None]

    def initialise(self) -> None:
        """Enter setup mode (INIT), freeing passive handles and assigning handles to plugged-in tools."""
        self.frames.stop()
        self.mode = UnitMode.SETUP
        self.infrared_checked = False
        if self.behaviour.init_forgets_handles:
            self.ports.free_all()
        for number in sorted(self.wired.plugged):
            self._give_handle(number)

    def reset(self) -> None:
        """Reset as at power-up or after a break: saved settings, default line settings, not initialised."""
        self.mode = UnitMode.NOT_INITIALISED
        self.line = DEFAULT_LINE
        self.frames.stop()
        self.frames = FrameCounter(self.clock)
        self.ports.free_all()
        self.alerts.reset()
        self.user_parameters.reset()
        self.port_changes = SystemStatus(0)
        self.infrared_checked = False

    def start_tracking(self, *, restart: bool) -> None:
        """Enter tracking mode, restarting the frame number at zero if `restart` is set."""
        self._begin(restart=restart)
        self.measurer.begin_tracking()
        self.mode = UnitMode.TRACKING

    def start_diagnostic(self) -> None:
        """Enter diagnostic mode."""
        self._begin(restart=False)
        self.mode = UnitMode.DIAGNOSTIC

    def stop(self) -> None:
        """Return from tracking or diagnostic mode to setup mode, keeping all handles."""
        self.frames.stop()
        self.mode = UnitMode.SETUP

    def plug(self, number: int) -> None:
        """Plug in a wired tool, which gets a handle immediately if the unit is initialised."""
        if number in self.wired.plugged or number not in self.wired.tools:
            return
        self.wired.plugged.add(number)
        if self.mode is not UnitMode.NOT_INITIALISED:
            self._give_handle(number)
            self._report_port_change(SystemStatus.PORT_OCCUPIED)

    def unplug(self, number: int) -> None:
        """Unplug a wired tool."""
        if number not in self.wired.plugged:
            return
        self.wired.plugged.discard(number)
        self.ports.unplug(number)
        self._report_port_change(SystemStatus.PORT_UNOCCUPIED)

    @property
    def volume(self) -> UnitVolume:
        """Selected measuring volume."""
        return self.model.volumes[self.user_parameters.number(wire.PARAMETER_SELECTED_VOLUME)]

    @property
    def watch_dog_s(self) -> int:
        """Watchdog limit in seconds without a command, or 0 if disabled."""
        return self.user_parameters.number(WATCH_DOG)

    def frame(self) -> MeasuredFrame:
        """Return the current frame without remeasuring it on repeated requests."""
        faulty = self.frames.missed or not self.faults.empty
        if faulty and self._frame is not None and self._repeats_frame():
            return self._frame
        number = self._next_number()
        status = self.alerts.system_status
        for more in (self.port_changes, self.measurer.light):
            if more:  # joining flags takes as long as comparing all of them
                status |= more
        kept = self._frame
        if kept is None or kept.number != number or kept.system_status != status:
            kept = self._frame = self._measure(number, status, self.ports.enabled())
        if self.port_changes and self.behaviour.port_change_until == "reply":
            self.port_changes = SystemStatus(0)
        return kept

    def resend_frame(self) -> None:
        """Resend the last frame to a host that resynchronises after a line disturbance."""
        self._frame_was_lost = True

    def diagnostic_frame(self, port: Port) -> MeasuredFrame:
        """In diagnostic mode, measure one tool, enabled or not, and everything else in view."""
        self.measurer.forget_tools()  # the previous frame may have shown another tool
        return self._measure(self.frames.number(), self.alerts.system_status, (port,))

    def _measure(self, number: int, status: SystemStatus, ports: tuple[Port, ...]) -> MeasuredFrame:
        seen = tuple(port for port in ports if port.occupied)
        since_start = self.frames.since_start(number)
        frame = self.measurer.frame(number, since_start, seen, self.volume, status)
        if frame.strays and not any(port.reflects for port in seen):
            frame = replace(frame, strays=())  # illuminators fire for enabled passive handles only
        listed = [port for port in self.ports if port in ports or self.behaviour.lists_disabled_handles]
        if len(listed) > len(seen):
            found = {port.handle: tracked for port, tracked in frame.tools}
            frame = replace(frame, tools=tuple((port, found.get(port.handle)) for port in listed))
        return frame

    def _next_number(self) -> int:
        """Return the frame number for the next request.

        If each request gets exactly one frame, a lost one is sent again; otherwise all later frames would
        have other noise.
        """
        lost, self._frame_was_lost = self._frame_was_lost, False
        again = lost and self._frame is not None and self.frames.last_is_newest
        return self.frames.last if again else self.frames.number()

    def _repeats_frame(self) -> bool:
        """Apply the frame faults: skip frames, or return True to repeat the last frame."""
        self.frames.missed = sum(int(fault.argument) for fault in self.faults.active("skip_frames"))
        if not self.faults.active("repeat_frames"):
            return False
        self.frames.pass_frame()
        return True

    def _begin(self, *, restart: bool) -> None:
        rate = self.user_parameters.number(wire.PARAMETER_ILLUMINATOR_RATE)
        self.frames.start(restart=restart, rate_hz=ILLUMINATOR_RATES_HZ[rate])
        self.measurer.forget_tools()
        self._frame = None

    def _give_handle(self, number: int) -> None:
        tool = self.wired.tool(number)
        if tool is not None and self.ports.find_by_socket(number) is None:
            try:
                self.ports.request_wired(number, tool)
            except CommandRefusal:  # no handle left: the tool waits
                return

    def _report_port_change(self, change: SystemStatus) -> None:
        self.port_changes |= change
        self._frame = None


class FrameCounter:
    """Counter of frames since power-up or the last restart at zero."""

    def __init__(self, clock: SharedClock) -> None:
        self._clock = clock
        self._epoch_ns = clock.now_ns()
        self._begin = 0
        self.last = 0  # number of the frame last requested
        self.missed = 0  # frames that a fault skips after each one
        self._counts_per_frame = 1

    def start(self, *, restart: bool, rate_hz: int) -> None:
        """Start tracking, restarting the frame number at zero if `restart` is set."""
        now_ns = self._clock.now_ns()
        if restart:
            self._epoch_ns = now_ns
        self.missed = 0
        self._counts_per_frame = COUNTS_PER_SECOND // rate_hz
        self._begin = self.last = self._count_at(now_ns)

    def number(self) -> int:
        """Return the requested frame's number, waiting for the next frame if the clock can be advanced."""
        if self._clock.paced:
            self.last = self._measured_count(self._count_at(self._clock.now_ns()))
            return self.last
        latest = self._measured_count(max(self.last, self._count_at(self._clock.now_ns())))
        self.last = latest + self._step
        self._clock.wait_until_ns(self.moment_ns(self.last))
        self._clock.expect_reader(self.moment_ns(self.last + self._step))
        return self.last

    def stop(self) -> None:
        """End tracking, so that the clock no longer waits for frames to be read."""
        self._clock.expect_reader(0)

    def pass_frame(self) -> None:
        """Skip one frame after repeating the last one, on a clock advanced by its users."""
        if not self._clock.paced:
            self._clock.wait_until_ns(self._clock.now_ns() + NANOSECONDS_PER_SECOND // COUNTS_PER_SECOND)

    @property
    def repeats(self) -> bool:
        """Whether two requests may receive the same frame."""
        return self._clock.paced

    @property
    def last_is_newest(self) -> bool:
        """Whether a clock advanced by its users has produced no newer frame."""
        return not self._clock.paced and self._count_at(self._clock.now_ns()) <= self.last

    def since_start(self, frame: int) -> int:
        """Return the number of frames since tracking began, used as the noise counter."""
        return frame - self._begin

    def moment_ns(self, count: int) -> int:
        """Return the theatre time of a frame."""
        return self._epoch_ns - (-count * NANOSECONDS_PER_SECOND // COUNTS_PER_SECOND)

    def _measured_count(self, count: int) -> int:
        return count - (count - self._begin) % self._step

    @property
    def _step(self) -> int:
        return self._counts_per_frame * (1 + self.missed)

    def _count_at(self, moment_ns: int) -> int:
        return (moment_ns - self._epoch_ns) * COUNTS_PER_SECOND // NANOSECONDS_PER_SECOND
