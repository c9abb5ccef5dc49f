"""Connections to the controller: EKI channel and RSI stream.

`Connections` opens and closes each; starting and ending the stream involves both.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.telegrams import ControllerState, require_matching_setup, require_ready
from drivers.kuka_rsi.errors import CommandRefused, ControllerLost, ControllerNotFound, NoTelegram, Unverified
from drivers.kuka_rsi.fault_errors import fault_error, start_error
from drivers.kuka_rsi.link import start_link
from drivers.kuka_rsi.options import ROLES, KukaOptions
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES, LinkSettings
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.pose import radians6
from ronna_hw.arm_stream.client import LinkClient, TrafficHandler, pass_traffic
from ronna_hw.arm_stream.control_channel import BytesPassed, Listener
from ronna_hw.arm_stream.records import CommandKind, Fault, Phase
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.capabilities import ByteSink
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_context import RsiContext
from ronna_hw.wire.kuka_eki import AckCode, CommandName, Correction, OperationMode, Reference, RsiState

FIRST_PAUSE_S = 0.1  # between attempts to reopen the EKI connection; doubled each time
LONGEST_PAUSE_S = 2.0
SHORTEST_TRY_S = 0.2
STOP_OBJECT_LIMIT_S = 1.0  # host time for the RSI program to end after Stop was sent


class Connections:
    """EKI and RSI connections of one arm; accessing a closed one raises."""

    def __init__(
        self, name: str, config: DeviceConfig, options: KukaOptions, context: RsiContext, clock: Clock
    ) -> None:
        """Check the endpoints without connecting; raises CFG-001 or CFG-002."""
        self._name = name
        addresses = config.require_addresses(ROLES)
        self._rsi, self._eki_address = addresses["rsi"], addresses["eki_project"]
        self._options = options
        self._context = context
        self._clock = clock
        self.open_eki: EkiClient | None = None
        self.open_link: LinkClient | None = None
        self.recorder = LinkRecorder(name)
        self.verified = False  # the controller reports that it runs our context

    @property
    def reported(self) -> ControllerState | None:
        """Controller state received last, requested or unsolicited."""
        return None if self.open_eki is None else self.open_eki.latest

    @property
    def eki(self) -> EkiClient:
        """Open EKI connection; raises EKI-001 if not connected."""
        if self.open_eki is None:
            raise ControllerNotFound(f"{self._name}: no EKI connection is open")
        return self.open_eki

    @property
    def link(self) -> LinkClient:
        """Client of the real-time process; raises RSI-002 if the process has not been started."""
        if self.open_link is None:
            raise NoTelegram(f"{self._name}: no real-time process is running")
        return self.open_link

    def is_eki_answering(self, limit_s: float) -> bool:
        """Return whether the controller replies on the EKI connection in time."""
        if self.open_eki is None or self.open_eki.failure is not None:
            return False
        try:
            self.open_eki.status(limit_s)
        except RonnaError:
            return False
        return True

    def find_controller(
        self, timeout_s: float, listener: Listener[ControllerState], *, retry: bool = False
    ) -> Identity:
        """Open the EKI connection and identify the controller.

        With `retry`, try until the time limit at growing pauses: after a loss the controller's server must
        first reopen. Raises EKI-001 when nothing answers, EKI-005 or EKI-006 for a different controller or
        set-up.
        """
        self.close_control()
        deadline, pause_s = time.monotonic() + timeout_s, FIRST_PAUSE_S
        limit_s = max(timeout_s, SHORTEST_TRY_S) if retry else timeout_s
        while True:
            try:
                self.open_eki, identity, self.verified = self._open_controller(limit_s)
                break
            except (ControllerNotFound, ControllerLost):
                if not retry or remaining_s(deadline) <= pause_s:
                    raise
            time.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)
            limit_s = max(remaining_s(deadline), SHORTEST_TRY_S)
        self.open_eki.listen(listener)
        return identity

    def start_link(self, timeout_s: float) -> None:
        """Start the real-time process, which binds the RSI port; raises RSI-001."""
        self.close_link()
        settings = link_settings(self._rsi, self._context, self._options)
        self.open_link = start_link(settings, timeout_s, self.recorder.rsi_sink, self._clock)

    def start_stream(self, timeout_s: float, limits: Mapping[OperationMode, MotionLimits]) -> OperationMode:
        """Switch on the drives, start the RSI program and its stream, and wait until corrections take effect.

        Until then every correction is zero: any other would take effect in one jump at RSI_MOVECORR.
        In T1 the operator switches the drives on and presses the start key. `limits` has an entry for each
        mode in which the stream may start; the real-time process and its monitor keep to them. Returns the
        operating mode.
        """
        eki, link, context, options, name = self.eki, self.link, self._context, self._options, self._name
        modes = tuple(limits)
        deadline = time.monotonic() + timeout_s
        state = eki.status(remaining_s(deadline))
        require_matching_setup(state, context, options.variant)
        require_ready(state, drives=False, modes=modes)
        if not state.drives:
            if state.mode is OperationMode.EXT:
                answer = eki.command(CommandName.DRIVES, remaining_s(deadline), On=1)
                if answer.code is not AckCode.OK:
                    # A change since the state was read is more informative than the refusal.
                    require_ready(
                        eki.status(max(remaining_s(deadline), SHORTEST_TRY_S)), drives=False, modes=modes
                    )
                    raise CommandRefused(
                        f"the controller refused {CommandName.DRIVES}",
                        got=f"{answer.code.name} {answer.text}".strip(),
                    )
            eki.await_state(lambda s: s.drives, remaining_s(deadline))
            state = eki.status(max(remaining_s(deadline), SHORTEST_TRY_S))
        require_ready(state, drives=True, modes=modes)
        mode = state.mode
        number = link.command(CommandKind.OPEN, axes_rad=radians6(*state.axes_deg), limits=limits[mode])
        link.wait(lambda s: s.command_number >= number, remaining_s(deadline))
        parameters = {"Cycle": context.program.cycle_ms, "Ref": Reference.ABSOLUTE, "Corr": Correction.AXIS}
        if mode is OperationMode.EXT:
            eki.require(CommandName.RSI_START, remaining_s(deadline), **parameters)
        else:
            # Whether or not the controller accepts it: in T1 an operator starts the program on the pendant.
            eki.command(CommandName.RSI_START, remaining_s(deadline), **parameters)
        if link.wait(lambda s: s.phase not in (Phase.ARMED, Phase.IDLE), remaining_s(deadline)) is None:
            raise start_error(name, link.state, state.axes_deg, options, timeout_s)
        if eki.await_state(lambda s: s.rsi is RsiState.MOVECORR, remaining_s(deadline)) is None:
            raise NoTelegram(f"{name}: the RSI program does not reach RSI_MOVECORR", limit=f"{timeout_s:g} s")
        fault = fault_error(name, link.state, options, mode)
        if fault is not None:
            raise fault
        require_ready(eki.status(max(remaining_s(deadline), SHORTEST_TRY_S)), drives=True, modes=(mode,))
        return mode

    def acknowledge(self, deadline: float) -> None:
        """Stop any RSI program, acknowledge the controller's messages and check its state.

        Raises EKI-005 to EKI-007 for unmet requirements, EKI-008 when it refuses for another reason.
        """
        eki = self.eki
        eki.command(CommandName.RSI_STOP, remaining_s(deadline))
        ack_refusal = None
        try:
            eki.require(CommandName.ACK_ERRORS, remaining_s(deadline))
        except CommandRefused as problem:  # the state is more informative than the answer
            ack_refusal = problem
        state = eki.status(remaining_s(deadline))
        require_matching_setup(state, self._context, self._options.variant)
        require_ready(state, drives=False, modes=(OperationMode.EXT, OperationMode.T1))
        if ack_refusal is not None:
            raise ack_refusal

    def end_stream(self, deadline: float) -> None:
        """End the RSI program with the STOP object, or by EKI if that fails, and close the stream."""
        eki, link = self.eki, self.link
        number = link.command(CommandKind.END)
        state = link.wait(lambda s: s.command_number >= number, remaining_s(deadline))
        end_state = None
        if state is not None and state.phase is Phase.ENDING and state.fault is not Fault.SILENCE:
            limit_s = min(remaining_s(deadline) / 2, STOP_OBJECT_LIMIT_S)
            end_state = eki.await_state(lambda s: s.rsi in (RsiState.IDLE, RsiState.FAULT), limit_s)
        if end_state is None:
            eki.require(CommandName.RSI_STOP, remaining_s(deadline))
        number = link.command(CommandKind.CLOSE)
        link.wait(lambda s: s.command_number >= number, remaining_s(deadline))

    def close_control(self) -> None:
        """Close the EKI connection, if open."""
        if self.open_eki is not None:
            self.open_eki.close()
            self.open_eki = None

    def close_link(self) -> None:
        """Stop the real-time process, if running."""
        if self.open_link is not None:
            self.open_link.close()
            self.open_link = None

    def _open_controller(self, timeout_s: float) -> tuple[EkiClient, Identity, bool]:
        """Connect by EKI and check the controller's set-up; returns whether it reports all of this.

        Raises EKI-001 when nothing, or no KR C4, answers, EKI-005 for a different set-up, EKI-006 when the
        controller does not report it and the option `accept_unverified` is off.
        """
        address, options = self._eki_address, self._options
        deadline = time.monotonic() + timeout_s
        eki = EkiClient(address.host, address.port, timeout_s, self.recorder.eki_sink)
        try:
            state = eki.status(remaining_s(deadline))
            unreported = require_matching_setup(state, self._context, options.variant)
            if unreported and not options.accept_unverified:
                raise Unverified("the controller does not report its " + ", ".join(unreported))
        except RonnaError as error:
            eki.close()
            if isinstance(error, TimeoutError):
                raise ControllerNotFound(
                    f"{address} is open, but no KR C4 answers there", limit=f"{timeout_s:g} s"
                ) from error
            raise
        details = (
            ("context", str(state.context_hash)),
            ("cycle_ms", str(state.cycle_ms)),
            ("mode", str(state.mode)),
            ("verified", "no, it does not report its " + ", ".join(unreported) if unreported else "yes"),
        )
        model, serial = state.variant or "unknown", state.serial or ""
        # EKI does not carry the software version of the controller.
        return eki, Identity("KUKA", model, serial, firmware="", details=details), not unreported


def link_settings(rsi: Endpoint, context: RsiContext, options: KukaOptions) -> LinkSettings:
    """Build the settings of the real-time process, without the descriptors added by `LinkClient`."""
    return LinkSettings(
        host=rsi.host,
        port=rsi.port,
        parent_pid=os.getpid(),
        variant=options.variant.value,
        cycle_ms=context.program.cycle_ms,
        sentype=context.ethernet.sentype,
        send_tags=tuple(e.tag for e in context.send),
        receive_tags=tuple(e.tag for e in context.receive),
        axis_tags=tuple(context.find_wired_tag("AXISCORR", axis) or "" for axis in AXIS_NAMES),
        stop_tag=context.find_wired_tag("STOP", "In1") or "",
        silence_limit_s=options.silence_limit_s,
        heartbeat_limit_s=options.heartbeat_limit_s,
        settle_tolerance_deg=options.settle_tolerance_deg,
        real_time_priority=options.real_time_priority,
        rehearsal_lead_us=options.rehearsal_lead_us,
        controller_host=options.controller_host,
    )


class LinkRecorder:
    """Optional traffic recorder for both connections; takes effect when a connection is opened."""

    def __init__(self, arm: str) -> None:
        self._arm = arm
        self.sink: ByteSink | None = None

    @property
    def eki_sink(self) -> BytesPassed | None:
        """Recorder callback for EKI traffic, or None without a recorder."""
        sink, link = self.sink, f"{self._arm}.eki"
        if sink is None:
            return None
        return lambda direction, data: sink.on_bytes(link, direction, data)

    @property
    def rsi_sink(self) -> TrafficHandler | None:
        """Recorder callback for RSI traffic, or None without a recorder."""
        sink, link = self.sink, f"{self._arm}.rsi"
        return None if sink is None else pass_traffic(sink, link)


def remaining_s(deadline: float) -> float:
    """Return the time remaining until a deadline on the host's monotonic clock, at least 0."""
    return max(deadline - time.monotonic(), 0.0)
