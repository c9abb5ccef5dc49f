"""Tracking from TSTART to TSTOP, with one request per reading."""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from statistics import median

from drivers.ndi_polaris.command_link import CommandLink
from drivers.ndi_polaris.errors import HandleRefused, UnitError, UnitRestarted, WrongMode
from drivers.ndi_polaris.measuring_volume import MeasuringVolume
from drivers.ndi_polaris.options import PolarisOptions
from drivers.ndi_polaris.replies import (
    FRAME_OPTIONS,
    TrackingReply,
    assemble_frame,
    decode_bx,
    decode_tx,
    frame_number,
)
from drivers.ndi_polaris.tool_loading import LoadedTool
from drivers.ndi_polaris.unit import ALARMING_STATUS, find_alarm
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import Stamp, TrackerFrame
from ronna_hw.wire import polaris as ndi

FRAME_NUMBERS = 16**ndi.TX_FRAME_DIGITS  # the number wraps after 2.3 years
NOMINAL_PERIOD_S = 1.0 / ndi.FRAME_RATE_HZ
WINDOW_FRAMES = 60  # one second: long enough to contain a reply with hardly any delay
WINDOWS_KEPT = 60  # a minute; the drift of a quartz is steady for longer
LEAST_WINDOWS = 10  # with fewer the jitter dominates the slope
LARGEST_DRIFT = 1e-3  # a quartz is within 1e-4; beyond this the nominal rate is the better estimate
JUMP_S = 1.0  # a reply this early means that another client has reset the counter
BYTES_PER_HANDLE = 102  # of TX, the longer form
BYTES_PER_STRAY = 21
LONGEST_WITHOUT_TOOLS_BYTES = ndi.BX_HEADER_BYTES + ndi.BX_CRC_BYTES + ndi.MAXIMUM_STRAYS * BYTES_PER_STRAY
REPLIES_KEPT = 10  # of which the times are reported
_OPTIONS_TEXT = f"{FRAME_OPTIONS.value:04X}"


@dataclass
class TrackingStatistics:
    """Frame statistics of a tracking run, from the unit's frame numbers."""

    frames: int = 0
    repeated: int = 0
    disturbed: int = 0  # replies that had to be requested again
    missed: int = 0  # measurements made between two of our requests


class Tracking:
    """Tracking with a configured unit, from loaded tools and measuring volume to readings."""

    def __init__(
        self,
        link: CommandLink,
        tools: tuple[LoadedTool, ...],
        volume: MeasuringVolume | None,
        rate_hz: int,
        options: PolarisOptions,
        clock: Clock,
    ) -> None:
        self._link = link
        self._tools = tools
        self._volume = volume
        self._options = options
        self._clock = clock
        self._frames_per_measurement = round(ndi.FRAME_RATE_HZ / rate_hz)
        self._binary = options.reply != "TX"
        self._longest_reply_bytes = LONGEST_WITHOUT_TOOLS_BYTES + len(tools) * BYTES_PER_HANDLE
        self.replies_s: tuple[float, ...] = ()
        self._reset()

    def _reset(self) -> None:
        self._sequence = 0
        self._last_count: int | None = None
        self.statistics = TrackingStatistics()
        self.frame_clock = FrameClock()

    def start(self) -> None:
        """Start tracking with the frame counter reset to 0."""
        try:
            self._link.ask("TSTART", ndi.TSTART_RESET_FRAME_COUNTER, retry=False)
        except WrongMode:  # already tracking: the reply to an earlier TSTART was lost
            stop_tracking(self._link)
            self._link.ask("TSTART", ndi.TSTART_RESET_FRAME_COUNTER, retry=False)
        self._reset()

    def read(self) -> TrackerFrame:
        """Read the next frame; raises the errors of `PolarisTracker.read_frame`."""
        requested_s = self._clock.now_s()
        retries = self._link.statistics.retries
        reply, count = self._request_newest()
        self.statistics.disturbed += self._link.statistics.retries - retries
        arrived_s = self._clock.now_s()
        reply_s = min(self._link.waited_s, arrived_s - requested_s)
        self.replies_s = (*self.replies_s[1 - REPLIES_KEPT :], reply_s)
        alarming = reply.system_status & ALARMING_STATUS
        if alarming and (problem := find_alarm(reply.system_status, self._link)) is not None:
            raise problem
        repeated = count == self._last_count
        if repeated:
            self.statistics.repeated += 1
        elif self._last_count is not None:
            step = count - self._last_count
            self.statistics.missed += max(0, step // self._frames_per_measurement - 1)
        self._last_count = count
        self.statistics.frames += 1
        self._sequence += 1
        return assemble_frame(
            reply,
            self._tools,
            stamp=Stamp(self._sequence, count, arrived_s, self.frame_clock.add_reply(count, arrived_s)),
            repeated=repeated,
            volume=self._volume,
            stray_to_marker_mm=self._options.stray_to_marker_mm,
        )

    def _request_newest(self) -> tuple[TrackingReply, int]:
        """Request a reply and its frame count, repeating once if the reply is older than the last."""
        for _ in range(2):
            reply = self._request()
            count = unwrap_frame_number(frame_number(reply), self._last_count)
            if self._last_count is None or count >= self._last_count:
                return reply, count
            self._link.mark_unsettled()  # a late copy of another reply
        raise UnitRestarted("the frame number went backwards: another client has restarted tracking")

    def _request(self) -> TrackingReply:
        try:
            if self._binary:
                try:
                    body = self._link.ask_binary("BX", _OPTIONS_TEXT, reply_bytes=self._longest_reply_bytes)
                    return decode_bx(body, first_marker_first=self._options.first_marker_is_first_nibble)
                except UnitError as error:
                    if self._options.reply == "BX" or isinstance(error, WrongMode | HandleRefused):
                        raise
                    self._binary = False  # this unit has no BX
            text = self._link.ask("TX", _OPTIONS_TEXT, reply_bytes=self._longest_reply_bytes)
            return decode_tx(text, first_marker_first=self._options.first_marker_is_first_digit)
        except WrongMode as error:
            raise UnitRestarted("the unit is no longer tracking") from error


def stop_tracking(link: CommandLink) -> None:
    """Stop tracking; a unit that is not tracking is not an error."""
    with suppress(WrongMode):  # it had stopped on its own, or the reply to the first try was lost
        link.ask("TSTOP")


class FrameClock:
    """Linear fit of theatre time to the frame numbers of one tracking run.

    The delay of a reply is never negative, so the least delayed replies lie on the lower edge of time over
    frame number. The least delayed reply of each second is kept. The slope is the median over all pairs of
    these (Theil-Sen), the intercept that of the lowest line with no reply below it. The delay common to all
    replies, the unit's processing and the transfer, cannot be separated from it.
    """

    def __init__(self) -> None:
        self._reset()

    def _reset(self) -> None:
        self._window_edges: deque[tuple[int, float]] = deque(maxlen=WINDOWS_KEPT)
        self._window = 0
        self._earliest: tuple[int, float] | None = None  # of the current window
        self._earliest_origin_s = math.inf
        self._origin_s: float | None = None
        self.period_s = NOMINAL_PERIOD_S  # of a frame, in theatre time

    def add_reply(self, count: int, arrived_s: float) -> float:
        """Add a reply to the fit and return the fitted theatre time of its frame."""
        if self._origin_s is not None and arrived_s < self._origin_s + count * self.period_s - JUMP_S:
            self._reset()
        if (window := count // WINDOW_FRAMES) != self._window:
            self._window = window
            self._end_window()
        if (origin_s := arrived_s - count * self.period_s) < self._earliest_origin_s:
            self._earliest, self._earliest_origin_s = (count, arrived_s), origin_s
        if self._origin_s is None or origin_s < self._origin_s:
            self._origin_s = origin_s
        return self._origin_s + count * self.period_s

    def _end_window(self) -> None:
        if self._earliest is None:
            return
        self._window_edges.append(self._earliest)
        self._earliest, self._earliest_origin_s = None, math.inf
        if len(self._window_edges) >= LEAST_WINDOWS:
            slope_s = median((b[1] - a[1]) / (b[0] - a[0]) for a, b in combinations(self._window_edges, 2))
            drift = slope_s / NOMINAL_PERIOD_S - 1.0
            self.period_s = slope_s if abs(drift) <= LARGEST_DRIFT else NOMINAL_PERIOD_S
        self._origin_s = min(arrived - count * self.period_s for count, arrived in self._window_edges)


def unwrap_frame_number(number: int, last: int | None) -> int:
    """Unwrap a frame number to the count nearest `last` that is congruent to `number`.

    A result below `last` is an older frame.
    """
    if last is None:
        return number
    half = FRAME_NUMBERS // 2
    return last + (number - last + half) % FRAME_NUMBERS - half
