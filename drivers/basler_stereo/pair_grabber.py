"""Grabbing of image pairs: start both streams, trigger, collect both frames, check that they match."""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace

from drivers.basler_stereo.camera import Camera
from drivers.basler_stereo.control_channel import require_control, send_together
from drivers.basler_stereo.errors import CommandRefused, ControlLost, NoReply, TriggerMissed
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.readings import PairClock, camera_image, stereo_reading
from drivers.basler_stereo.stream.frame_assembler import ReceivedImage
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import StereoReading, Validity
from ronna_hw.errors import RonnaError
from ronna_hw.wire.gige_vision import GevStatus

ALIVE_LIMIT_S = 0.5  # to check whether a camera that sent nothing still replies
RECHECK_PAUSE_S = 0.1  # between two such checks: the heartbeat shares the channel
PARTNER_LIMIT_S = 2.0  # for the second image of a pair after the first
FIRST_TRY_SHARE = 0.6  # of the time limit, for the first of two triggers
SHORTEST_LIMIT_FOR_TWO_S = 1.0  # below this only one trigger is sent
BUSY_ADVICE = "Reconnect to reset their triggers; if they are still busy then, grab less often."
NO_PULSE_ADVICE = "Check the source of the trigger pulse and its wiring to input Line1 of both cameras."

Frames = tuple[ReceivedImage | None, ReceivedImage | None]


class PairGrabber:
    """Stream control and frame pairing for two cameras; deadlines are host monotonic time.

    Use from one thread at a time.
    """

    def __init__(
        self, cameras: tuple[Camera, Camera], serials: tuple[str, str], clock: Clock, options: BaslerOptions
    ) -> None:
        self._cameras = cameras
        self._serials = serials
        self._clock = clock
        self._options = options
        self._pair_clock = PairClock((None, None), 0.0)
        self._must_restart = False
        self.block_ids: tuple[int | None, int | None] = (None, None)

    def start_streams(self, deadline_s: float) -> None:
        """Start both streams; block ids restart."""
        left, right = self._cameras
        left.start(deadline_s)
        try:
            right.start(deadline_s)
            self._tie_clocks(deadline_s)
        except BaseException:  # including interruptions: a single camera must not keep streaming
            for camera in self._cameras:
                with contextlib.suppress(RonnaError, OSError):
                    camera.stop(deadline_s)
            raise
        self._must_restart = False

    def stop_streams(self, deadline_s: float) -> None:
        """Stop both streams; the next grab after a failure restarts them."""
        self._must_restart = True
        for camera in self._cameras:
            camera.stop(deadline_s)

    def grab(self, sequence: int, deadline_s: float) -> StereoReading:
        """Trigger once and return the resulting pair.

        Triggers a second time if neither camera sent an image, or if the images come from different triggers,
        such as when the computer stalls between the two commands. After an incomplete pair the streams
        restart, so that a late image is never attributed to the next trigger. Raises GEV-007, GEV-013 to
        GEV-015, GEV-017.
        """
        limit_s = deadline_s - time.monotonic()
        may_retry = limit_s >= SHORTEST_LIMIT_FOR_TWO_S and self._options.trigger != "line1"
        if may_retry:
            try:
                reading = self._grab(sequence, time.monotonic() + FIRST_TRY_SHARE * limit_s)
                if reading.validity not in (Validity.UNPAIRED, Validity.STALE):
                    return reading
            except TriggerMissed:
                pass  # the command or all packets were lost, or the camera was busy
        return self._grab(sequence, deadline_s)

    def await_replies(self, deadline_s: float) -> None:
        """Wait until both cameras reply again.

        The heartbeat decides whether one is lost: raises GEV-014, GEV-015; GEV-007 at the deadline.
        """
        for camera in self._cameras:
            while True:
                if camera.lost is not None:
                    raise camera.lost
                try:
                    require_control(camera.control, min(deadline_s, time.monotonic() + ALIVE_LIMIT_S))
                    break
                except NoReply:
                    if time.monotonic() >= deadline_s:
                        raise
                time.sleep(RECHECK_PAUSE_S)

    def _grab(self, sequence: int, deadline_s: float) -> StereoReading:
        if self._must_restart:
            self.stop_streams(deadline_s)
            self.start_streams(deadline_s)
        for camera in self._cameras:
            camera.expect_next()
        triggered_s = self._clock.now_s()  # before the trigger: an image is never older than its stamp
        self._must_restart = True  # until the outcome of the trigger is known
        self._trigger(deadline_s)
        frames = self._collect(deadline_s)
        self.block_ids = tuple(frame.block_id if frame else None for frame in frames)  # type: ignore[assignment]
        self._must_restart = self._needs_restart(frames)
        if None in frames:
            self._raise_for_missing(frames)
        return self._make_reading(frames, sequence, triggered_s)

    def _needs_restart(self, frames: Frames) -> bool:
        """Return whether an incomplete pair requires a stream restart before the next trigger."""
        if self._options.trigger == "line1":  # a restart could miss the next pulse
            return None in frames and frames != (None, None)
        return any(frame is None or frame.missing_packets for frame in frames)

    def _tie_clocks(self, deadline_s: float) -> None:
        """Relate the tick counts of both cameras to theatre time."""
        left, right = (camera.tie(self._clock, deadline_s) for camera in self._cameras)
        self._pair_clock = PairClock((left, right), self._options.pair_skew_ms / 1000.0)

    def _trigger(self, deadline_s: float) -> None:
        commands = [
            (camera.control, camera.trigger_command)
            for camera in self._cameras
            if camera.trigger_command is not None
        ]
        results = send_together(commands, deadline_s, "the trigger")
        for camera, result in zip(self._cameras, results, strict=False):
            if isinstance(result, CommandRefused) and result.status == GevStatus.ACCESS_DENIED:
                raise ControlLost(f"the {camera.side} camera rejects our trigger") from result
            if result is not None:
                raise result

    def _collect(self, deadline_s: float) -> Frames:
        """Collect a frame from each camera, with less time for the second."""

        def is_any_lost() -> bool:
            return any(camera.lost is not None for camera in self._cameras)

        left, right = self._cameras
        if (first := left.take(deadline_s, is_any_lost)) is not None:
            deadline_s = min(deadline_s, time.monotonic() + PARTNER_LIMIT_S)
        return first, right.take(deadline_s, is_any_lost)

    def _raise_for_missing(self, frames: Frames) -> None:
        """Raise the error that explains a missing frame.

        GEV-007, GEV-014 or GEV-015 for its camera, GEV-013 for both.
        """
        for camera, frame in zip(self._cameras, frames, strict=True):
            if frame is not None:
                continue
            if camera.lost is not None:
                raise camera.lost
            require_control(camera.control, time.monotonic() + ALIVE_LIMIT_S)
        if frames == (None, None):
            raise self._trigger_missed_error()

    def _trigger_missed_error(self) -> TriggerMissed:
        """Build the error for a trigger that produced no image, with the probable reason."""
        expected = "an image from either camera"
        if self._options.trigger == "line1":
            what = "no pulse arrived on the trigger line"
            return TriggerMissed(what, expected=expected, action=NO_PULSE_ADVICE)
        what, got, action = "no image after a trigger", "no packets", TriggerMissed.action
        if any(camera.receiver.has_begun for camera in self._cameras):
            what, got = "no complete image after a trigger", "some of its packets"
        elif any(camera.receiver.counters.refusals for camera in self._cameras):
            got, action = "'no image' from both cameras", BUSY_ADVICE
        return TriggerMissed(what, expected=expected, got=got, action=action)

    def _make_reading(self, frames: Frames, sequence: int, triggered_s: float) -> StereoReading:
        match, moments_s = self._match(frames, triggered_s)
        left, right = (
            camera_image(
                frame, serial, camera.area, self._options.pixel_format_code, sequence, triggered_s, moment_s
            )
            if frame is not None
            else None
            for camera, frame, serial, moment_s in zip(
                self._cameras, frames, self._serials, moments_s, strict=True
            )
        )
        if match is Validity.STALE:
            left, right = (image and replace(image, validity=Validity.STALE) for image in (left, right))
        return stereo_reading(left, right, sequence, triggered_s, match)

    def _match(
        self, frames: Frames, triggered_s: float
    ) -> tuple[Validity, tuple[float | None, float | None]]:
        left, right = (frame.leader if frame else None for frame in frames)
        if left is None or right is None:
            return Validity.OK, (None, None)  # the missing side is reported anyway
        ticks = (left.ticks, right.ticks)
        if not self._pair_clock.is_tied and all(camera.tick_frequency_hz for camera in self._cameras):
            # a counter at zero at the start of the stream looked like a stopped one
            self._tie_clocks(time.monotonic() + ALIVE_LIMIT_S)
        now_s = self._clock.now_s()
        moments_s = self._pair_clock.moments_s(ticks)
        frequencies_hz = (self._cameras[0].tick_frequency_hz, self._cameras[1].tick_frequency_hz)
        match = self._pair_clock.judge_pair(ticks, frequencies_hz, triggered_s, now_s)
        self._must_restart |= match is not Validity.OK
        return match, moments_s
