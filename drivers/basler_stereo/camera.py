"""One camera of the pair, from discovery to release: connection, settings and stream."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import asdict

from drivers.basler_stereo import gvcp
from drivers.basler_stereo.control_channel import (
    CameraControl,
    Command,
    Heartbeat,
    register_write,
    take_control,
)
from drivers.basler_stereo.errors import CommandRefused, NoCamera
from drivers.basler_stereo.features import known_state, output_line
from drivers.basler_stereo.features.description import fetch_description, parse_description
from drivers.basler_stereo.features.feature_map import FeatureMap, RegisterMemory
from drivers.basler_stereo.identity import CameraIdentity, describe_cameras_near, identify
from drivers.basler_stereo.options import BaslerOptions
from drivers.basler_stereo.readings import Tie
from drivers.basler_stereo.stream.frame_assembler import ReceivedImage, StreamCounters, next_block_id
from drivers.basler_stereo.stream.receiver import (
    ReceiverProcess,
    StreamReceiver,
    choose_packet_bytes,
    open_stream_socket,
    point_stream_to,
)
from ronna_hw.clock import Clock
from ronna_hw.devices.capabilities import ByteSink, Direction
from ronna_hw.devices.readings import AreaOfInterest
from ronna_hw.errors import RonnaError
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap, GvcpCommand

KEEP_ALIVES_PER_TIMEOUT = 4  # from the receiver process
PATIENCE_S = 0.1  # after the exposure, before packets of an image not yet begun are requested


class Camera:
    """Left or right GigE Vision camera; deadlines are host monotonic time. Not thread-safe."""

    def __init__(
        self, side: str, address: str, options: BaslerOptions, recorder: LinkRecorder | None = None
    ) -> None:
        """Create an unconnected camera; `recorder` receives control traffic and a note for each image."""
        self.side = side
        self._recorder = recorder or LinkRecorder("", None)
        self._address = address
        self._options = options
        self._control: CameraControl | None = None
        self._memory: RegisterMemory | None = None
        self._features: FeatureMap | None = None
        self._heartbeat: Heartbeat | None = None
        self._receiver_process: ReceiverProcess | None = None
        self._keep_alive_number: int | None = None
        self._next_block: int | None = None
        self._receiver: StreamReceiver | None = None
        self._packet_bytes = 0
        self.trigger_command: Command | None = None  # for one frame; None with a trigger line
        self.area = AreaOfInterest(0, 0, 0, 0)
        self._exposure_us = options.exposure_us
        self.tick_frequency_hz = gev.TICK_FREQUENCY_HZ
        self.lost: RonnaError | None = None  # set by the heartbeat
        self.notices: list[str] = []

    @property
    def control(self) -> CameraControl:
        """Control channel; available only while connected."""
        assert self._control is not None, "the lifecycle allows this only while connected"
        return self._control

    @property
    def features(self) -> FeatureMap:
        """GenICam features of the camera; available only while controlled."""
        assert self._features is not None, "the lifecycle allows this only while controlled"
        return self._features

    @property
    def receiver(self) -> StreamReceiver:
        """Stream receiver; available only while streaming."""
        assert self._receiver is not None, "the lifecycle allows this only while streaming"
        return self._receiver

    @property
    def counters(self) -> StreamCounters | None:
        """Statistics of the current stream, or None while not streaming."""
        return self._receiver.counters if self._receiver else None

    def connect(self, deadline_s: float) -> CameraIdentity:
        """Connect and identify the camera without taking control; raises GEV-001, GEV-008.

        If no camera replies, the message names those found by broadcast discovery.
        """
        try:
            self._control = CameraControl(self._address, on_bytes=self._recorder.on_bytes)
        except OSError as error:
            raise NoCamera(f"no route to {self._address}", got=error.strerror) from error
        try:
            return identify(self._control, deadline_s)
        except NoCamera as error:
            wanted = self._options.left_serial, self._options.right_serial
            near = describe_cameras_near(self._control.peer_address, wanted)
            raise NoCamera(error.what, expected=error.expected, got=near) from error

    def configure(self, receiver_process: ReceiverProcess, deadline_s: float) -> None:
        """Take control, read the description, apply the known state and determine the packet size.

        Waits until the heartbeat of a dead controller times out. Raises GEV-005 when another application is
        in control; on any error control is released.
        """
        self._receiver_process = receiver_process
        try:
            self._take_control(deadline_s)
            nodes = parse_description(fetch_description(self.control, deadline_s))
            self._memory = RegisterMemory(self.control)
            self._features = FeatureMap(nodes, self._memory)
            self._memory.deadline_s = deadline_s
            known_state.apply_known_state(self._features, self._options, f"{self.side} camera")
            if (projector := self._options.projector_at(self.side)) is not None:
                output_line.prepare_projector(self._features, projector, f"{self.side} camera")
            self.area = known_state.full_area(self._features)
            known_state.set_area(self._features, self.area)
            self._choose_packet_size(deadline_s)
            frequency = Bootstrap.TICK_FREQUENCY_HIGH, Bootstrap.TICK_FREQUENCY_LOW
            self.tick_frequency_hz = self._read_both(*frequency, deadline_s)
        except BaseException:  # including interruptions: a camera that stays controlled refuses everyone else
            with contextlib.suppress(RonnaError, OSError):
                self.release(deadline_s)
            raise

    def set_area(self, area: AreaOfInterest, deadline_s: float) -> None:
        """Set the sensor area to read out, while not streaming; raises GEV-011."""
        self._set_deadline(deadline_s)
        known_state.set_area(self.features, area)
        self.area = area

    def set_exposure(self, exposure_us: float, gain_raw: int | None, deadline_s: float) -> None:
        """Set exposure and gain (None: the minimum), also while streaming; raises GEV-011."""
        self._set_deadline(deadline_s)
        known_state.set_exposure(self.features, exposure_us, gain_raw, f"{self.side} camera")
        self._exposure_us = exposure_us

    def switch_projector(self, on: bool, deadline_s: float) -> None:
        """Switch the projector on this camera's output line, if there is one; raises GEV-021."""
        if (projector := self._options.projector_at(self.side)) is not None:
            self._set_deadline(deadline_s)
            output_line.switch_projector(self.features, projector, f"{self.side} camera", on=on)

    def read_temperature_C(self, deadline_s: float) -> float | None:
        """Read the internal temperature, or None if the camera does not report it."""
        self._set_deadline(deadline_s)
        return known_state.read_temperature_C(self.features)

    def start(self, deadline_s: float) -> None:
        """Open the stream and start the acquisition; block ids restart."""
        self._set_deadline(deadline_s)
        payload = known_state.payload_bytes(self.features, self.area, self._options.pixel_format_code)
        self.trigger_command = self._make_trigger_command()
        assert self._receiver_process is not None, "the lifecycle allows this only while controlled"
        self._next_block = None
        with open_stream_socket(self.control.local_address, self._options.receive_buffer_bytes) as stream:
            self._receiver = self._receiver_process.receive(
                stream, self.control.link, payload, self._packet_bytes, self._options.resend
            )
            try:
                point_stream_to(self.control, stream, deadline_s)
                known_state.lock_transport(self.features, True)
                self.features.execute("AcquisitionStart")
            except BaseException:  # including interruptions: no one would read the stream
                self._close_receiver()
                raise

    def stop(self, deadline_s: float) -> None:
        """Stop the acquisition and close the stream."""
        self._set_deadline(deadline_s)
        try:
            self.features.execute("AcquisitionStop")
            self.control.write_register(Bootstrap.SCP, 0, deadline_s)
            known_state.lock_transport(self.features, False)
        finally:
            self._close_receiver()

    def tie(self, clock: Clock, deadline_s: float) -> Tie | None:
        """Relate the current tick count to theatre time, or return None without a time stamp counter."""
        if not self.tick_frequency_hz:
            return None
        try:
            before_s = clock.now_s()
            self.control.write_register(Bootstrap.TIMESTAMP_CONTROL, gev.TIMESTAMP_LATCH, deadline_s)
            after_s = clock.now_s()
            ticks = self._read_both(Bootstrap.TIMESTAMP_HIGH, Bootstrap.TIMESTAMP_LOW, deadline_s)
        except CommandRefused:
            return None
        if not ticks:
            return None  # the register exists but has no effect
        half_s = (after_s - before_s) / 2.0
        return Tie(ticks, self.tick_frequency_hz, before_s + half_s, half_s)

    def expect_next(self) -> None:
        """Discard pending frames and expect the one about to be triggered."""
        self.receiver.discard()
        if self.trigger_command is None:
            self._next_block = None  # a line may fire at any time
            return
        # this family begins with 1; for others nothing is known before the first frame
        patience_s = PATIENCE_S + self._exposure_us * 1e-6
        self.receiver.expect(self._next_block or gev.BLOCK_ID_FIRST, patience_s)

    def take(self, deadline_s: float, give_up: Callable[[], bool] = lambda: False) -> ReceivedImage | None:
        """Return the frame of the last trigger, or None at the deadline or when `give_up()` is true.

        Late frames of earlier triggers are discarded.
        """
        while (frame := self.receiver.take(deadline_s, give_up)) is not None:
            self._recorder.note_frame(frame, self.receiver.counters)
            if self._next_block is None or frame.block_id == self._next_block:
                self._next_block = next_block_id(frame.block_id)
                return frame
        return None

    def release(self, deadline_s: float) -> None:
        """Stop streaming, switch the projector off and release control; the channel stays open."""
        if self._features is not None:
            with contextlib.suppress(RonnaError, OSError):  # control is released whatever the line does
                self.switch_projector(False, deadline_s)
        if self._heartbeat is not None:
            self._heartbeat.close()
            self._heartbeat = None
        self._end_keep_alive()
        try:
            if self._receiver is not None:
                self.stop(deadline_s)
        finally:
            self.control.write_register(Bootstrap.CCP, gev.CCP_OPEN, deadline_s)

    def close(self, deadline_s: float) -> None:
        """Release control if the camera still replies, then close everything; never raises."""
        if self._control is None:
            return
        with contextlib.suppress(RonnaError, OSError):
            if self._heartbeat is not None:
                self.release(deadline_s)
        self._end_keep_alive()
        self._close_receiver()
        self._control.close()
        self._control = None

    def _take_control(self, deadline_s: float) -> None:
        take_control(self.control, f"the {self.side} camera at {self._address}", deadline_s)
        self.lost = None
        self._set_heartbeat_timeout(deadline_s)
        with contextlib.suppress(CommandRefused):  # older devices have no extended status codes
            self.control.write_register(
                Bootstrap.GVCP_CONFIGURATION, gev.GVCP_CONFIGURATION_EXTENDED_STATUS, deadline_s
            )

    def _set_heartbeat_timeout(self, deadline_s: float) -> None:
        wanted_ms = self._options.heartbeat_ms
        self.control.write_register(Bootstrap.HEARTBEAT_TIMEOUT_MS, wanted_ms, deadline_s)
        if (set_ms := self.control.read_register(Bootstrap.HEARTBEAT_TIMEOUT_MS, deadline_s)) != wanted_ms:
            self.notices.append(f"{self.side}: heartbeat time-out {set_ms} ms instead of {wanted_ms} ms")
        timeout_ms = min(wanted_ms, set_ms or wanted_ms)
        assert self._receiver_process is not None, "set by configure"
        self._keep_alive_number = self._receiver_process.keep_alive(
            self.control.link, timeout_ms / 1000.0 / KEEP_ALIVES_PER_TIMEOUT
        )
        self._heartbeat = Heartbeat(self.control, timeout_ms, self._note_lost, f"stereo-{self.side}")

    def _choose_packet_size(self, deadline_s: float) -> None:
        self.control.write_register(Bootstrap.SCPD, self._options.inter_packet_delay_ticks, deadline_s)
        with open_stream_socket(self.control.local_address, self._options.receive_buffer_bytes) as stream:
            self._packet_bytes, proven = choose_packet_bytes(
                self.control, stream, self._options.packet_bytes, deadline_s
            )
        if not proven:
            self.notices.append(
                f"{self.side}: no test packets from the camera; using {self._packet_bytes} bytes"
            )

    def _read_both(self, high: Bootstrap, low: Bootstrap, deadline_s: float) -> int:
        upper_half = self.control.read_register(high, deadline_s)
        return upper_half << 32 | self.control.read_register(low, deadline_s)

    def _make_trigger_command(self) -> Command | None:
        options = self._options
        if options.trigger == "software":
            address, value = self.features.command_write("TriggerSoftware")
            return register_write(address, int.from_bytes(value, "big"))
        if options.trigger == "action":
            keys = (options.action_device_key, options.action_group_key, known_state.ACTION_GROUP_MASK)
            return GvcpCommand.ACTION, gvcp.action_command(*keys)
        return None

    def _set_deadline(self, deadline_s: float) -> None:
        assert self._memory is not None, "the lifecycle allows this only while controlled"
        self._memory.deadline_s = max(deadline_s, time.monotonic())

    def _end_keep_alive(self) -> None:
        if self._keep_alive_number is not None and self._receiver_process is not None:
            self._receiver_process.end_keep_alive(self._keep_alive_number)
        self._keep_alive_number = None

    def _note_lost(self, error: RonnaError) -> None:
        self.lost = error

    def _close_receiver(self) -> None:
        if self._receiver is not None:
            self._receiver.close()
            self._receiver = None


class LinkRecorder:
    """Traffic recorder for one camera's links, such as `stereo.left`; without a `sink`, does nothing.

    Every datagram of the control channel is kept; for the stream, a note per image, and the counters. Resend
    requests and keep-alives are sent by the receiver process and are not included.
    """

    def __init__(self, name: str, sink: ByteSink | None) -> None:
        self._name = name
        self._sink = sink

    def on_bytes(self, direction: Direction, data: bytes) -> None:
        """Record a control channel datagram."""
        if self._sink is not None:
            self._sink.on_bytes(f"{self._name}.control", direction, data)

    def note_frame(self, frame: ReceivedImage, counters: StreamCounters) -> None:
        """Record the arrival of a complete or incomplete image."""
        if self._sink is None:
            return
        leader = {} if frame.leader is None else frame.leader._asdict()
        self._sink.note(
            f"{self._name}.stream",
            block_id=frame.block_id,
            missing_packets=frame.missing_packets,
            **leader,
            **asdict(counters),
        )
