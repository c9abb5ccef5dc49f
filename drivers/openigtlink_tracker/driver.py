"""A tracker behind an OpenIGTLink server, such as PLUS, as an `OpticalTracker` that sees tools alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from drivers.openigtlink_tracker.connection import Connection
from drivers.openigtlink_tracker.errors import WRONG_FRAME, ServerLost, SharedName, StreamGarbled
from drivers.openigtlink_tracker.measurements import Measurement, StampClock, ToolReader
from drivers.openigtlink_tracker.options import read_options
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
from ronna_hw.devices.readings import Stamp, TrackerFrame, Validity
from ronna_hw.devices.sensors import read_new_frame
from ronna_hw.vectors import Vector3, vector3
from ronna_hw.wire.openigtlink import LONGEST_NAME_BYTES

LOOK_S = 0.5  # host time in `configure`, to learn what the server sends
DELAYS_KEPT = 10  # of frames, in `replies_s`
_FAULTS = (ServerLost, StreamGarbled, SharedName)  # latched; cleared only by `recover`

T = TypeVar("T")


class OpenIGTLinkTracker(GuardedDevice):
    """Tracker behind an OpenIGTLink server, with synchronous calls; not thread-safe.

    Time limits are host seconds. The protocol has no word for who or what measures: the identity only says
    that an OpenIGTLink server replies.
    """

    wire_protocol = "openigtlink"
    reports_strays = False  # see `StatesStrays`

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        """Check the options without opening a connection; raises IGT-003, CFG-001 or CFG-002."""
        super().__init__(name, LifecycleGuard(name))
        self._clock = clock
        self._endpoint = config.address().require("igtl", "tcp")
        self._options = read_options(config)
        self._sink: ByteSink | None = None
        self._turn = Turn(name)
        self._connection: Connection | None = None
        self._notices: tuple[str, ...] = ()
        self._last_frame: TrackerFrame | None = None
        self._last_number = 0  # of the measurement in the last frame
        self._sequence = 0
        self._disturbed = 0  # on earlier connections
        self._begin()

    @staticmethod
    def conformance_options() -> dict[str, Any]:
        """Return the options for a conformance run on an unknown server, whose tools nobody knows."""
        markers_mm = [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 70.0, 0.0]]
        return {"tools": [{"name": "robot_frame", "markers_mm": markers_mm}]}

    @property
    def tools(self) -> tuple[str, ...]:
        return tuple(self._options.sent_names)

    @property
    def markers_mm(self) -> dict[str, tuple[Vector3, ...]]:
        return {tool.name: tuple(map(vector3, tool.markers_mm)) for tool in self._options.tools}

    @property
    def replies_s(self) -> tuple[float, ...]:
        """Delays of recent frames beyond the least of a minute; see `TimedTracker`.

        Empty where theatre time does not follow the host's, and for a server that stamps no message.
        """
        return self._delays_s

    @property
    def notices(self) -> tuple[str, ...]:
        """Messages from `configure` that are not errors but concern the operator."""
        return self._notices

    def observe(self) -> LastKnown[TrackerFrame]:
        open_one = self._connection
        disturbed = self._disturbed + (open_one.disturbed if open_one else 0)
        return self._guard.last_known(self._last_frame, report_count("disturbed messages", disturbed))

    def record_bytes(self, sink: ByteSink | None) -> None:
        self._sink = sink

    def connect(self, timeout_s: float = 10.0) -> Identity:
        """Open the connection and wait for an OpenIGTLink message.

        Raises IGT-001 and IGT-002, and IGT-006 or IGT-007 for a connection that fails at once.
        """
        self._guard.require("connect", {Lifecycle.DISCONNECTED})
        self._open(timeout_s)
        identity = Identity("OpenIGTLink", "OpenIGTLink server", "", "")
        self._guard.enter(Lifecycle.CONNECTED, endpoint=str(self._endpoint), identity=identity)
        return identity

    def configure(self, timeout_s: float = 10.0) -> None:
        """Learn which tools the server sends; a missing one is a notice, as it may be hidden.

        Raises IGT-004 when a tool is sent in another frame, and, with FAULT latched, IGT-006 to IGT-008.
        """
        self._turn.require("configure")
        self._guard.require("configure", {Lifecycle.CONNECTED})
        self._run_guarded(lambda: self._look(timeout_s))
        self._guard.enter(Lifecycle.CONFIGURED, tools=self.tools, notices=self._notices)

    def activate(self, timeout_s: float = 10.0) -> None:
        """Start: frames are read of what the server sends from now on."""
        self._turn.require("activate")
        self._guard.require("activate", {Lifecycle.CONFIGURED})
        self._begin()
        self._last_number = self._link.count
        self._link.start()
        self._guard.enter(Lifecycle.ACTIVE)

    def deactivate(self, timeout_s: float = 10.0) -> None:
        """Stop; ends a stream. A server that sends TRANSFORM messages unasked goes on sending them."""
        self._guard.require("deactivate", RUNNING)
        self._turn.end_stream()
        self._link.stop()
        self._guard.enter(Lifecycle.CONFIGURED)

    def stream(self, *, every: bool = False, timeout_s: float = 1.0) -> ReadingStream[TrackerFrame]:
        """Stream new measurements. Until the stream ends, other readers are refused with DEV-014."""
        read = partial(read_new_frame, self)
        return ReadingStream(read, every=every, timeout_s=timeout_s, turn=self._turn)

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        """Return the newest measurement that has not been returned, waiting for one if needed.

        `stamp.device_clock` counts the measurements that have arrived, as the protocol numbers none. Raises
        IGT-005 when none comes in time, DEV-014 while a stream or another thread reads, and, with FAULT
        latched, IGT-006 (lost), IGT-007 (garbled) and IGT-008 (two tools under one name).
        """
        self._guard.require("read_frame", RUNNING)
        with self._turn.call("read_frame"):
            measurement = self._run_guarded(lambda: self._link.await_newer(self._last_number, timeout_s))
        self._last_number = measurement.number
        self._sequence += 1
        tools = tuple(
            reader.read(measurement.samples.get(self._options.sent_names[name]), measurement.began_s)
            for name, reader in self._readers.items()
        )
        frame = TrackerFrame(self._stamp(measurement), Validity.OK, tools, ())
        self._last_frame = frame
        return frame

    def recover(self, acknowledged_by: str, timeout_s: float = 10.0) -> None:
        """Return from FAULT to CONFIGURED by reconnecting; FAULT stays latched when that fails."""
        self._guard.require("recover", {Lifecycle.FAULT})
        require_person(acknowledged_by)
        deadline_s = time.monotonic() + timeout_s
        self._drop()
        self._open(timeout_s)
        self._look(max(0.0, deadline_s - time.monotonic()))
        self._guard.enter(Lifecycle.CONFIGURED)

    def close(self) -> None:
        """Close the connection in bounded time; never raises."""
        if self._guard.state is Lifecycle.CLOSED:
            return
        self._turn.end_stream()
        self._drop()
        self._guard.enter(Lifecycle.CLOSED)

    @property
    def _link(self) -> Connection:
        assert self._connection is not None, "the lifecycle allows this call only while connected"
        return self._connection

    def _begin(self) -> None:
        self._stamps = StampClock()
        self._delays_s: tuple[float, ...] = ()
        self._readers = {name: ToolReader(name, self._options.frozen_after_s) for name in self.tools}

    def _run_guarded(self, work: Callable[[], T]) -> T:
        try:
            return work()
        except _FAULTS as fault:
            self._guard.latch(fault)
            raise

    def _open(self, timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s
        opened = Connection(self._name, self._endpoint, self._options, self._clock, self._sink, timeout_s)
        try:
            opened.greet(max(0.0, deadline_s - time.monotonic()))
        except BaseException:  # including interruptions: the server may serve one client at a time
            opened.close()
            raise
        self._connection, self._last_number = opened, 0

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._disturbed += self._connection.disturbed
        self._connection = None

    def _look(self, timeout_s: float) -> None:
        """Read what the server sends for a moment; raises IGT-004 for a pose in another frame."""
        link = self._link
        link.start()
        wanted = {name[:LONGEST_NAME_BYTES] for name in self._options.sent_names.values()}
        have_all_come = link.await_names(wanted, min(LOOK_S, timeout_s))
        link.stop()
        self._notices = () if have_all_come else tuple(self._explain_missing(link.names))

    def _explain_missing(self, sent: set[str]) -> list[str]:
        cut = {name[:LONGEST_NAME_BYTES] for name in sent}
        notices = []
        for tool, name in self._options.sent_names.items():
            if name[:LONGEST_NAME_BYTES] in cut:
                continue
            beginning = name.removesuffix(self._options.frame)
            others = sorted(other for other in sent if other.startswith(beginning))
            if others:
                raise WRONG_FRAME(
                    f"{tool} is not sent in the frame {self._options.frame}",
                    expected=name,
                    got=", ".join(others),
                )
            notices.append(
                f"{tool} is not sent as {name}: it is hidden, or the server does not know it; it sends "
                + (", ".join(sorted(sent)) or "no transform")
            )
        return notices

    def _stamp(self, measurement: Measurement) -> Stamp:
        arrived_s, measured_s = measurement.arrived_s, None
        if measurement.stamp_ns:
            measured_s = self._stamps.place(measurement.stamp_ns, arrived_s)
            if self._clock.paced:
                self._delays_s = (*self._delays_s[1 - DELAYS_KEPT :], arrived_s - measured_s)
        return Stamp(self._sequence, measurement.number, arrived_s, measured_s)
