"""NDI Polaris units (Spectra, Vicra and compatible) as an `OpticalTracker`, over serial or TCP."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from drivers.ndi_polaris.command_link import CommandLink
from drivers.ndi_polaris.discovery import find_unit, initialise, raise_baud
from drivers.ndi_polaris.errors import (
    WRONG_UNIT,
    HardwareFailure,
    LinkLost,
    SensorBumped,
    TemperatureHold,
    UnitRestarted,
)
from drivers.ndi_polaris.measuring_volume import MeasuringVolume, choose_volume, find_published_volume
from drivers.ndi_polaris.options import read_options
from drivers.ndi_polaris.tool_comparison import find_alike
from drivers.ndi_polaris.tool_definition import encode_definition
from drivers.ndi_polaris.tool_loading import LoadedTool, free_handle, load_tools
from drivers.ndi_polaris.tracking import Tracking, TrackingStatistics, stop_tracking
from drivers.ndi_polaris.transport import RecordedTransport, Transport, open_transport
from drivers.ndi_polaris.unit import (
    check_identity,
    clear_bump,
    read_identity,
    read_time_limits,
    refuse_pending_alerts,
    set_illuminator_rate,
)
from ronna_hw.arguments import require_time_s
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink, report_count
from ronna_hw.devices.lifecycle import (
    RUNNING,
    GuardedDevice,
    Identity,
    LastKnown,
    Lifecycle,
    LifecycleGuard,
    require_person,
)
from ronna_hw.devices.reading_stream import ReadingStream, Turn
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.devices.sensors import VolumeSections, read_new_frame
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import Vector3
from ronna_hw.wire.polaris import COMM_DEFAULT_ARGUMENT

CLOSE_LIMIT_S = 1.5  # for all closing commands together, whether the unit replies or not

_FAULTS = (HardwareFailure, LinkLost, SensorBumped, UnitRestarted)  # latched; cleared only by `recover`

T = TypeVar("T")
OpenTransport = Callable[[Endpoint, float], Transport]


class PolarisTracker(GuardedDevice):
    """Polaris tracker with synchronous calls; not thread-safe.

    Time limits are host seconds.
    """

    wire_protocol = "ndi-polaris"  # which byte-level conformance cases apply

    def __init__(
        self,
        name: str,
        config: DeviceConfig,
        clock: Clock,
        *,
        transport: OpenTransport = open_transport,
        monotonic: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Check options and tool definitions without opening a connection.

        Raises NDI-010 to NDI-013, and CFG-001 or CFG-002 for the endpoint.
        """
        super().__init__(name, LifecycleGuard(name))
        self._clock = clock
        self._endpoint = config.address().require("serial", "tcp")
        self._options = read_options(config)
        self._definitions = self._options.definitions(config.folder)
        self._open_transport = transport
        self._monotonic = monotonic
        self._pause = pause
        self._sink: ByteSink | None = None
        self._turn = Turn(name)
        self._open_link: CommandLink | None = None
        self._identity: Identity | None = None
        self._loaded: tuple[LoadedTool, ...] = ()
        self._volume: MeasuringVolume | None = None
        self._tracking: Tracking | None = None
        self._last_frame: TrackerFrame | None = None
        self._notices: list[str] = []
        self._bump_reported = False

    @staticmethod
    def conformance_options() -> dict[str, Any]:
        """Return the options for a conformance run on an unknown unit."""
        return {"tools": [{"name": "robot_frame", "rom": "robot_frame.rom"}]}

    @property
    def tools(self) -> tuple[str, ...]:
        return tuple(self._definitions)

    @property
    def markers_mm(self) -> dict[str, tuple[Vector3, ...]]:
        return {name: tool.markers_mm for name, tool in self._definitions.items()}

    @property
    def definition_blocks(self) -> dict[str, bytes]:
        """Tool definitions by tool name, as sent to the unit."""
        return {name: encode_definition(tool) for name, tool in self._definitions.items()}

    @property
    def identity(self) -> Identity | None:
        """Identity of the unit, once connected."""
        return self._identity

    @property
    def baud(self) -> int | None:
        """Current baud rate, or None over TCP or while not connected."""
        return self._open_link.transport.baud if self._open_link else None

    @property
    def volume(self) -> MeasuringVolume | None:
        """Measuring volume in use, or None before `configure` or if the unit does not report it."""
        return self._volume

    @property
    def volume_sections_mm(self) -> VolumeSections:
        """Cross-sections of the measuring volume; see `BoundedTracker`."""
        published = find_published_volume(self._identity, self._options.expected_model)
        known = (one.sections_mm for one in (self._volume, published) if one is not None)
        return next(filter(None, known), ())

    @property
    def replies_s(self) -> tuple[float, ...]:
        """Recent reply times; see `TimedTracker`."""
        return self._tracking.replies_s if self._tracking else ()

    @property
    def notices(self) -> tuple[str, ...]:
        """Messages from `configure` that are not errors but concern the operator."""
        return tuple(self._notices)

    @property
    def statistics(self) -> TrackingStatistics:
        """Frame statistics of the current or last tracking run."""
        return self._tracking.statistics if self._tracking else TrackingStatistics()

    def observe(self) -> LastKnown[TrackerFrame]:
        facts = report_count("disturbed replies", self.statistics.disturbed)
        return self._guard.last_known(self._last_frame, facts)

    def record_bytes(self, sink: ByteSink | None) -> None:
        self._sink = sink

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Find the unit at any baud rate, initialise it and check its identity.

        Raises NDI-001 to NDI-004 (no port, no reply, wrong device) and the errors of the link.
        """
        self._guard.require("connect", {Lifecycle.DISCONNECTED})
        self._identity = self._open_unit(self._monotonic() + timeout_s)
        self._guard.enter(Lifecycle.CONNECTED, endpoint=str(self._endpoint), identity=self._identity)
        return self._identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Set baud rate, volume and illuminators; load and enable all tools.

        Raises NDI-030 to NDI-037 when the unit refuses a tool or an option, NDI-013 when it holds another
        tool, the errors of the link, and, with FAULT latched, NDI-020 or NDI-021 for an earlier fault or
        bump.
        """
        self._turn.require("configure")
        self._guard.require("configure", {Lifecycle.CONNECTED})
        self._run_guarded(self._set_up_unit, timeout_s)
        self._guard.enter(
            Lifecycle.CONFIGURED, baud=self.baud, tools=self.tools, volume=self._volume, notices=self.notices
        )

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start tracking; frame numbers restart from 0."""
        self._turn.require("activate")
        self._guard.require("activate", {Lifecycle.CONFIGURED})
        self._run_guarded(self._tracking_run.start, timeout_s)
        self._guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop tracking but keep the tools loaded; ends a stream."""
        self._guard.require("deactivate", RUNNING)
        self._turn.end_stream()
        self._run_guarded(lambda: stop_tracking(self._link), timeout_s)
        self._guard.enter(Lifecycle.CONFIGURED, frames=self.statistics, link=self._link.statistics)

    def stream(self, *, every: bool = False, timeout_s: float = 1.0) -> ReadingStream[TrackerFrame]:
        """Stream new measurements. Until the stream ends, other readers are refused with DEV-014."""
        read = partial(read_new_frame, self)
        return ReadingStream(read, every=every, timeout_s=timeout_s, turn=self._turn)

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        """Read the next frame by one request to the unit, or two if the first reply was disturbed.

        Raises NDI-005 to NDI-007 for a lost reading (the next call resynchronises first), NDI-022 while the
        unit withholds poses because of its temperature (state HOLD, which ends by itself), DEV-014 while a
        stream or another thread reads the unit, and, with FAULT latched, NDI-008 (link lost), NDI-009
        (restarted), NDI-020 (hardware), NDI-021 (bumped).
        """
        self._guard.require("read_frame", RUNNING)
        require_time_s(timeout_s, "timeout_s of read_frame")
        try:
            with self._turn.call("read_frame"):
                frame = self._run_guarded(self._tracking_run.read, timeout_s)
        except TemperatureHold:
            self._guard.enter(Lifecycle.HOLD)
            raise
        if self._guard.state is Lifecycle.HOLD:
            self._guard.enter(Lifecycle.ACTIVE)
        self._last_frame = frame
        return frame

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Return from FAULT to CONFIGURED by reconnecting to the same unit; clears an acknowledged bump.

        Raises NDI-004 for another unit, NDI-020 while a hardware fault persists, NDI-021 when the unit was
        bumped besides the acknowledged fault. FAULT then stays latched.
        """
        self._guard.require("recover", {Lifecycle.FAULT})
        require_person(acknowledged_by)
        deadline_s = self._monotonic() + timeout_s
        before, cause = self._identity, self._guard.fault
        self._drop_link()
        identity = self._open_unit(deadline_s)
        if before is not None and identity.serial != before.serial:
            self._drop_link()
            raise WRONG_UNIT("a different unit from before", expected=before.serial, got=identity.serial)
        if isinstance(cause, SensorBumped) or self._bump_reported:
            clear_bump(self._link)
            self._bump_reported = False
        try:
            self._set_up_unit()
        except SensorBumped:  # the operator acknowledged another fault: the next recovery clears this one
            self._bump_reported = True
            raise
        self._identity = identity
        self._guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        """Stop tracking, free the tools and restore the default baud rate within 3 s; never raises."""
        if self._guard.state is Lifecycle.CLOSED:
            return
        self._turn.end_stream()
        if self._open_link is not None:
            # a unit that is gone needs no closing commands
            self._open_link.deadline_s = self._monotonic() + CLOSE_LIMIT_S
            with contextlib.suppress(RonnaError, OSError):
                self._release_unit(self._open_link)
            self._drop_link()
        self._guard.enter(Lifecycle.CLOSED)

    @property
    def _link(self) -> CommandLink:
        assert self._open_link is not None, "the lifecycle allows this call only while connected"
        return self._open_link

    @property
    def _tracking_run(self) -> Tracking:
        assert self._tracking is not None, "the lifecycle allows this call only when configured"
        return self._tracking

    def _run_guarded(self, work: Callable[[], T], timeout_s: float) -> T:
        """Run an operation within the time limit; latches faults that only `recover` may clear."""
        self._link.deadline_s = self._monotonic() + timeout_s
        try:
            return work()
        except _FAULTS as fault:
            self._guard.latch(fault)
            raise

    def _open_unit(self, deadline_s: float) -> Identity:
        transport = self._open_transport(self._endpoint, max(0.1, deadline_s - self._monotonic()))
        if self._sink is not None:
            transport = RecordedTransport(transport, self._name, self._sink)
        link = CommandLink(transport, limits_s=self._options.limits_s(), monotonic=self._monotonic)
        link.deadline_s = deadline_s
        try:
            find_unit(link)
            initialise(link)
            identity = read_identity(link)
            check_identity(identity, self._options.expected_model, self._options.expected_serial)
        except BaseException:  # including interruptions: the serial port is released
            transport.close()
            raise
        self._open_link = link
        return identity

    def _set_up_unit(self) -> None:
        link = self._link
        self._notices[:] = [
            str(pair) for name, tool in self._definitions.items() for pair in find_alike({name: tool})
        ]
        raise_baud(link, self._options.maximum_baud, self._pause)
        link.adopt_limits({**read_time_limits(link), **self._options.time_limits_s})
        refuse_pending_alerts(link)
        wanted_hz = self._options.illuminator_rate_hz
        if (rate_hz := set_illuminator_rate(link, wanted_hz)) != wanted_hz:
            self._notices.append(f"the illuminators stay at {rate_hz} Hz instead of {wanted_hz} Hz")
        self._volume = choose_volume(link, self._options.volume)
        if self._volume is None:
            self._notices.append(
                "the unit does not report its volume: strays rely on its own out-of-volume bits"
            )
        chosen_tools = ((tool, self._definitions[tool.name]) for tool in self._options.tools)
        self._loaded = load_tools(link, chosen_tools, self._notices.append)
        self._tracking = Tracking(link, self._loaded, self._volume, rate_hz, self._options, self._clock)

    def _release_unit(self, link: CommandLink) -> None:
        if isinstance(self._guard.fault, LinkLost):
            return
        if self._guard.state in RUNNING | {Lifecycle.FAULT}:
            stop_tracking(link)
        for tool in self._loaded:
            free_handle(link, tool.handle)
        if link.transport.baud is not None:
            link.ask("COMM", COMM_DEFAULT_ARGUMENT, retry=False)

    def _drop_link(self) -> None:
        if self._open_link is not None:
            self._open_link.transport.close()
        self._open_link = None
        self._loaded = ()
