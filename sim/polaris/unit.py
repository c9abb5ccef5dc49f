"""The unit itself: its mode, its settings, what is loaded, and the frame it measures now."""

from __future__ import annotations

from enum import StrEnum

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import COMM_BAUD_CODES, DEFAULT_BAUD, ILLUMINATOR_RATES_HZ
from sim.polaris.alerts import Alerts
from sim.polaris.frame_counter import FrameCounter
from sim.polaris.measurement import Frame, Measurer
from sim.polaris.parameters import Parameters
from sim.polaris.ports import PortTable
from sim.polaris.profile import SPECTRA, Profile
from sim.polaris.volume import Volume
from sim.theatre.world import World


class Mode(StrEnum):
    """What the unit is doing, in the words of `Info.Status.System Mode`."""

    NOT_INITIALISED = "Booted"
    SETUP = "Initialized"
    TRACKING = "Tracking"


class Unit:
    """A Polaris in its room."""

    def __init__(self, world: World, profile: Profile = SPECTRA) -> None:
        self.profile = profile
        self.mode = Mode.NOT_INITIALISED
        self.baud = DEFAULT_BAUD
        self.ports = PortTable(profile.handles)
        self.measurer = Measurer(world)
        self.frames = FrameCounter(world.clock)
        self._frame: Frame | None = None
        self._restore_settings()

    def initialise(self) -> None:
        """Come to setup, with no handles."""
        self.mode = Mode.SETUP
        self.ports.free_all()

    def reset(self) -> None:
        """As after power-up or a break: settings as saved, default line, not initialised."""
        self.initialise()
        self.mode = Mode.NOT_INITIALISED
        self.baud = DEFAULT_BAUD
        self._restore_settings()

    def switch_baud(self, code: str) -> None:
        """Use another line rate from the next command on."""
        self.baud = COMM_BAUD_CODES[code]

    def start_tracking(self, *, restart: bool) -> None:
        """Begin to measure; with `restart` the frame number starts at zero."""
        rate = self.parameters.number(wire.PARAMETER_ILLUMINATOR_RATE)
        self.frames.start(restart=restart, rate_hz=ILLUMINATOR_RATES_HZ[rate])
        self.measurer.forget_tools()
        self._frame = None
        self.mode = Mode.TRACKING

    def stop_tracking(self) -> None:
        """Back to setup; handles stay as they are."""
        self.mode = Mode.SETUP

    @property
    def volume(self) -> Volume:
        """The selected volume."""
        return self.profile.volumes[self.parameters.number(wire.PARAMETER_SELECTED_VOLUME)]

    def frame(self) -> Frame:
        """The frame that a request gets now: measured once, however often it is asked for."""
        number = self.frames.number()
        status = self.alerts.system_status
        kept = self._frame
        if kept is None or kept.number != number or kept.system_status != status:
            kept = self._frame = self.measurer.frame(
                number, self.frames.since_start(number), self.ports.enabled(), self.volume, status
            )
        return kept

    def _restore_settings(self) -> None:
        self.alerts = Alerts()
        self.parameters = Parameters(self.profile, self.alerts, lambda: self.mode.value)
