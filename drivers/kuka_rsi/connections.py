"""Connections to the controller: EKI channel and RSI stream; starting the stream involves both."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Mapping

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.telegrams import ControllerState, require_matching_setup, require_ready
from drivers.kuka_rsi.errors import NO_TELEGRAM, STREAM_ERRORS, UNVERIFIED_CONTROLLER
from drivers.kuka_rsi.fault_errors import RsiFaults
from drivers.kuka_rsi.options import ROLES, KukaOptions
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES, LinkSettings
from ronna_hw.arm.catalogue import KUKA
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm_stream.client import START_TIMEOUT_S, LinkClient, StartRefused, TrafficHandler
from ronna_hw.arm_stream.connections import SHORTEST_TRY_S, StreamConnections, remaining_s
from ronna_hw.arm_stream.errors import CommandRefused
from ronna_hw.arm_stream.records import OpenStream, StreamPhase
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.endpoints import Endpoint
from ronna_hw.wire.kuka_context import RsiContext
from ronna_hw.wire.kuka_eki import CommandName, Correction, OperationMode, Reference, RsiState

PROCESS = "drivers.kuka_rsi.realtime.process"
ADDRESS_ADVICE = (
    "Give endpoint rsi, and the Ethernet file, the address that this computer has in the subnet of the "
    "controller's RSI interface; check that the cable is connected and the interface is up."
)


class Connections(StreamConnections[ControllerState, EkiClient]):
    """EKI and RSI connections of one arm; the control channel is EKI."""

    faults: RsiFaults

    def __init__(self, faults: RsiFaults, config: DeviceConfig, context: RsiContext, clock: Clock) -> None:
        """Check the endpoints without connecting; raises CFG-001 or CFG-002."""
        super().__init__(faults, clock)
        addresses = config.require_addresses(ROLES, faults.name)
        self._rsi, self._eki_address = addresses["rsi"], addresses["eki_project"]
        self._context = context
        self.verified = False  # the controller reports that it runs our context

    def start_link(self, timeout_s: float) -> None:
        """Start the real-time process, which binds the RSI port; raises RSI-001."""
        self.close_link()
        settings = link_settings(self._rsi, self._context, self.faults.options)
        self.open_link = start_link(settings, timeout_s, self._traffic_of("rsi"), self.clock)

    def request_state(self, timeout_s: float) -> ControllerState:
        """Request the controller's state; raises EKI-001 to EKI-004."""
        return self.control.status(timeout_s)

    def start_stream(self, timeout_s: float, limits: Mapping[OperationMode, MotionLimits]) -> OperationMode:
        """Switch on the drives, start the RSI program and its stream, and wait until corrections take effect.

        Until then every correction is zero: any other would take effect in one jump at RSI_MOVECORR.
        In T1 the operator switches the drives on and presses the start key. `limits` has an entry for each
        mode in which the stream may start; the real-time process and its monitor keep to them. Returns the
        operating mode.
        """
        eki, link, context, faults = self.control, self.link, self._context, self.faults
        modes = tuple(limits)
        deadline = time.monotonic() + timeout_s
        state = eki.status(remaining_s(deadline))
        require_matching_setup(state, context, faults.options.variant)
        require_ready(state, drives=False, modes=modes)
        if not state.drives:
            if state.mode is OperationMode.EXT:
                try:
                    eki.require(CommandName.DRIVES, remaining_s(deadline), On=1)
                except CommandRefused:  # a change since the state was read is more informative
                    state = eki.status(max(remaining_s(deadline), SHORTEST_TRY_S))
                    require_ready(state, drives=False, modes=modes)
                    raise
            eki.await_state(lambda s: s.drives, remaining_s(deadline))
            state = eki.status(max(remaining_s(deadline), SHORTEST_TRY_S))
        require_ready(state, drives=True, modes=modes)
        mode = state.mode
        number = link.command(OpenStream(limits[mode], state.joints_rad))
        link.wait(lambda s: s.command_number >= number, remaining_s(deadline))
        parameters = {"Cycle": context.program.cycle_ms, "Ref": Reference.ABSOLUTE, "Corr": Correction.AXIS}
        if mode is OperationMode.EXT:
            eki.require(CommandName.RSI_START, remaining_s(deadline), **parameters)
        else:
            # Whether or not the controller accepts it: in T1 an operator starts the program on the pendant.
            eki.command(CommandName.RSI_START, remaining_s(deadline), **parameters)
        before_stream = (StreamPhase.ARMED, StreamPhase.IDLE)
        if link.wait(lambda s: s.phase not in before_stream, remaining_s(deadline)) is None:
            raise faults.start_error(link.state, state.axes_deg, timeout_s)
        if eki.await_state(lambda s: s.rsi is RsiState.MOVECORR, remaining_s(deadline)) is None:
            raise NO_TELEGRAM(
                f"{faults.name}: the RSI program does not reach RSI_MOVECORR", limit=f"{timeout_s:g} s"
            )
        if (fault := faults.error(link.state, mode)) is not None:
            raise fault
        require_ready(eki.status(max(remaining_s(deadline), SHORTEST_TRY_S)), drives=True, modes=(mode,))
        return mode

    def acknowledge(self, person: str, deadline: float) -> None:
        """Stop any RSI program, acknowledge the controller's messages and check its state.

        Raises EKI-005 to EKI-007 for unmet requirements, EKI-008 when it refuses for another reason.
        """
        eki = self.control
        eki.command(CommandName.RSI_STOP, remaining_s(deadline))
        ack_refusal = None
        try:
            eki.require(CommandName.ACK_ERRORS, remaining_s(deadline))
        except CommandRefused as problem:  # the state is more informative than the answer
            ack_refusal = problem
        state = eki.status(remaining_s(deadline))
        require_matching_setup(state, self._context, self.faults.options.variant)
        require_ready(state, drives=False, modes=(OperationMode.EXT, OperationMode.T1))
        if ack_refusal is not None:
            raise ack_refusal

    def _ask(self, timeout_s: float) -> None:
        self.control.status(timeout_s)

    def _await_program_end(self, timeout_s: float) -> bool:
        ended = (RsiState.IDLE, RsiState.FAULT)
        return self.control.await_state(lambda s: s.rsi in ended, timeout_s) is not None

    def _end_program(self, timeout_s: float) -> None:
        self.control.require(CommandName.RSI_STOP, timeout_s)

    def _identify(self, timeout_s: float) -> Identity:
        """Connect by EKI, check the controller's set-up, and note whether it reports all of this.

        Raises EKI-001 when nothing, or no KR C4, answers, EKI-005 for a different set-up, EKI-006 when the
        controller does not report it and the option `accept_unverified` is off.
        """
        address, options = self._eki_address, self.faults.options
        deadline = time.monotonic() + timeout_s
        self.open_control = EkiClient(address.host, address.port, timeout_s, self._bytes_of("eki"))
        try:
            state = self.control.status(remaining_s(deadline))
        except TimeoutError as error:
            raise STREAM_ERRORS.not_found(
                f"{address} is open, but no KR C4 answers there", limit=f"{timeout_s:g} s"
            ) from error
        unreported = require_matching_setup(state, self._context, options.variant)
        if unreported and not options.accept_unverified:
            raise UNVERIFIED_CONTROLLER("the controller does not report its " + ", ".join(unreported))
        self.verified = not unreported
        details = (
            ("context", str(state.context_hash)),
            ("cycle_ms", str(state.cycle_ms)),
            ("mode", str(state.mode)),
            ("verified", "no, it does not report its " + ", ".join(unreported) if unreported else "yes"),
        )
        model, serial = state.variant or "unknown", state.serial or ""
        # EKI does not carry the software version of the controller.
        return Identity(KUKA, model, serial, firmware="", details=details)


def start_link(
    settings: LinkSettings,
    timeout_s: float = START_TIMEOUT_S,
    on_traffic: TrafficHandler | None = None,
    clock: Clock | None = None,
) -> LinkClient:
    """Start the real-time process, which listens on the RSI port; raises RSI-001."""
    try:
        return LinkClient(settings, PROCESS, STREAM_ERRORS, timeout_s, on_traffic, clock)
    except StartRefused as refusal:
        known = os.strerror(refusal.errno) if refusal.errno > 0 else "no such address"
        reason = f"cannot listen on udp://{settings.host}:{settings.port}: {known}"
        if refusal.errno <= 0 or refusal.errno == errno.EADDRNOTAVAIL:
            raise STREAM_ERRORS.not_started(
                reason, expected="an address of this computer", action=ADDRESS_ADVICE
            ) from None
        raise STREAM_ERRORS.not_started(reason) from None


def link_settings(rsi: Endpoint, context: RsiContext, options: KukaOptions) -> LinkSettings:
    """Build the settings of the real-time process, without the descriptors added by `LinkClient`."""
    if options.force_sensor:
        context = context.with_force_sensor()
    return LinkSettings(
        host=rsi.host,
        port=rsi.port,
        variant=options.variant,
        cycle_ms=context.program.cycle_ms,
        sentype=context.ethernet.sentype,
        send_tags=tuple(e.tag for e in context.all_send),
        receive_tags=tuple(e.tag for e in context.receive),
        axis_tags=tuple(context.find_wired_tag("AXISCORR", axis) or "" for axis in AXIS_NAMES),
        stop_tag=context.find_wired_tag("STOP", "In1") or "",
        controller_host=options.controller_host,
        **options.process_settings(),
    )
