"""Opens the controller, starts its RSI program, and ends it: the steps that involve both EKI and RSI."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.controller_state import require_ours, require_ready
from drivers.kuka_rsi.errors import (
    CommandRefused,
    ControllerLost,
    ControllerNotFound,
    NoTelegram,
    Unverified,
)
from drivers.kuka_rsi.fault_errors import error_of_fault, error_of_wait
from drivers.kuka_rsi.link_bytes import BytesPassed
from drivers.kuka_rsi.link_client import LinkClient
from drivers.kuka_rsi.options import KukaOptions
from drivers.kuka_rsi.realtime.link_state import CommandKind, Fault, Phase
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES, LinkSettings
from ronna_hw.arm.motion.limits import MotionLimits
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.endpoints import Endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_context import RsiContext
from ronna_hw.wire.kuka_eki import AckCode, CommandName, Correction, OperationMode, Reference, RsiState

FIRST_PAUSE_S = 0.1  # between attempts to reopen the EKI connection; doubled each time
LONGEST_PAUSE_S = 2.0
LEAST_TRY_S = 0.2
STOP_OBJECT_LIMIT_S = 1.0  # host time for the RSI program to end after Stop was sent


def rest_of(deadline: float) -> float:
    """Time left until a deadline of the host's monotonic clock, not negative, s."""
    return max(deadline - time.monotonic(), 0.0)


def open_controller(
    address: Endpoint,
    context: RsiContext,
    options: KukaOptions,
    timeout_s: float,
    passed: BytesPassed | None = None,
) -> tuple[EkiClient, Identity, bool]:
    """Connect by EKI and check that the controller runs our context for our arm; True if it confirms that.

    Raises EKI-001 when nothing, or no KR C4, answers, EKI-005 for a different set-up, EKI-006 when it does
    not report it and the option `accept_unverified` is off.
    """
    deadline = time.monotonic() + timeout_s
    eki = EkiClient(address.host, address.port, timeout_s, passed)
    try:
        state = eki.status(rest_of(deadline))
        unsaid = require_ours(state, context, options.variant)
        if unsaid and not options.accept_unverified:
            raise Unverified("the controller does not report its " + ", ".join(unsaid))
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
        ("verified", "no, it does not report its " + ", ".join(unsaid) if unsaid else "yes"),
    )
    model, serial = state.variant or "unknown", state.serial or ""
    # EKI does not carry the software version of the controller.
    return eki, Identity("KUKA", model, serial, firmware="", details=details), not unsaid


def reopen_controller(
    address: Endpoint,
    context: RsiContext,
    options: KukaOptions,
    timeout_s: float,
    passed: BytesPassed | None = None,
) -> tuple[EkiClient, Identity, bool]:
    """Like `open_controller`, retried with growing pauses: after a loss the server must first reopen."""
    deadline = time.monotonic() + timeout_s
    pause_s = FIRST_PAUSE_S
    while True:
        try:
            return open_controller(address, context, options, max(rest_of(deadline), LEAST_TRY_S), passed)
        except (ControllerNotFound, ControllerLost):
            if rest_of(deadline) <= pause_s:
                raise
        time.sleep(pause_s)
        pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)


def link_settings(
    rsi: Endpoint, context: RsiContext, options: KukaOptions
) -> Callable[[int, int], LinkSettings]:
    """Settings of the real-time process, except for the descriptors of mailbox and event."""

    def settings(mailbox_fd: int, event_fd: int) -> LinkSettings:
        return LinkSettings(
            host=rsi.host,
            port=rsi.port,
            parent_pid=os.getpid(),
            mailbox_fd=mailbox_fd,
            event_fd=event_fd,
            variant=options.variant.value,
            cycle_ms=context.program.cycle_ms,
            sentype=context.ethernet.sentype,
            send_tags=tuple(e.tag for e in context.send),
            receive_tags=tuple(e.tag for e in context.receive),
            axis_tags=tuple(context.wired_tag("AXISCORR", axis) or "" for axis in AXIS_NAMES),
            stop_tag=context.wired_tag("STOP", "In1") or "",
            silence_limit_s=options.silence_limit_s,
            heartbeat_limit_s=options.heartbeat_limit_s,
            settle_tolerance_deg=options.settle_tolerance_deg,
            real_time_priority=options.real_time_priority,
            rehearsal_lead_us=options.rehearsal_lead_us,
            controller_host=options.controller_host,
        )

    return settings


def start_stream(
    eki: EkiClient,
    link: LinkClient,
    context: RsiContext,
    options: KukaOptions,
    name: str,
    timeout_s: float,
    limits: Mapping[OperationMode, MotionLimits],
) -> OperationMode:
    """Switch the drives on, start the RSI program, answer its telegrams, wait until corrections take effect.

    Until then every correction is zero: what is sent before RSI_MOVECORR would take effect in one jump. In T1
    the operator switches the drives on and presses the start key. `limits` are those of each mode in which
    it may start; the real-time process and its monitor keep to them. Returns the operating mode.
    """
    modes = tuple(limits)
    deadline = time.monotonic() + timeout_s
    state = eki.status(rest_of(deadline))
    require_ours(state, context, options.variant)
    require_ready(state, drives=False, modes=modes)
    if not state.drives:
        if state.mode is OperationMode.EXT:
            answer = eki.command(CommandName.DRIVES, rest_of(deadline), On=1)
            if answer.code is not AckCode.OK:
                # What has come up since the state was read is more informative than the refusal.
                require_ready(eki.status(max(rest_of(deadline), LEAST_TRY_S)), drives=False, modes=modes)
                raise CommandRefused(
                    f"the controller refused {CommandName.DRIVES}",
                    got=f"{answer.code.name} {answer.text}".strip(),
                )
        eki.await_state(lambda s: s.drives, rest_of(deadline))
        state = eki.status(max(rest_of(deadline), LEAST_TRY_S))
    require_ready(state, drives=True, modes=modes)
    mode = state.mode
    number = link.command(CommandKind.OPEN, axes_rad=radians6(*state.axes_deg), limits=limits[mode])
    link.wait(lambda s: s.command_number >= number, rest_of(deadline))
    wanted = {"Cycle": context.program.cycle_ms, "Ref": Reference.ABSOLUTE, "Corr": Correction.AXIS}
    if mode is OperationMode.EXT:
        eki.require(CommandName.RSI_START, rest_of(deadline), **wanted)
    else:
        # Whether or not the controller accepts it: in T1 an operator starts the program on the pendant.
        eki.command(CommandName.RSI_START, rest_of(deadline), **wanted)
    if link.wait(lambda s: s.phase not in (Phase.ARMED, Phase.IDLE), rest_of(deadline)) is None:
        raise error_of_wait(name, link.state, state.axes_deg, options, timeout_s)
    if eki.await_state(lambda s: s.rsi is RsiState.MOVECORR, rest_of(deadline)) is None:
        raise NoTelegram(f"{name}: the RSI program does not reach RSI_MOVECORR", limit=f"{timeout_s:g} s")
    fault = error_of_fault(name, link.state, options, mode)
    if fault is not None:
        raise fault
    require_ready(eki.status(max(rest_of(deadline), LEAST_TRY_S)), drives=True, modes=(mode,))
    return mode


def acknowledge(eki: EkiClient, context: RsiContext, options: KukaOptions, deadline: float) -> None:
    """Acknowledge the controller's messages and read its state again, with no RSI program running.

    Raises EKI-005 to EKI-007 for what is not as required, EKI-008 when it refuses for another reason.
    """
    eki.command(CommandName.RSI_STOP, rest_of(deadline))
    refused = None
    try:
        eki.require(CommandName.ACK_ERRORS, rest_of(deadline))
    except CommandRefused as problem:  # the state is more informative than the answer
        refused = problem
    state = eki.status(rest_of(deadline))
    require_ours(state, context, options.variant)
    require_ready(state, drives=False, modes=(OperationMode.EXT, OperationMode.T1))
    if refused is not None:
        raise refused


def end_stream(eki: EkiClient, link: LinkClient, deadline: float) -> None:
    """End the RSI program with the STOP object, or by EKI if that fails, and close the connection."""
    number = link.command(CommandKind.END)
    state = link.wait(lambda s: s.command_number >= number, rest_of(deadline))
    ended = None
    if state is not None and state.phase is Phase.ENDING and state.fault is not Fault.SILENCE:
        limit_s = min(rest_of(deadline) / 2, STOP_OBJECT_LIMIT_S)
        ended = eki.await_state(lambda s: s.rsi in (RsiState.IDLE, RsiState.FAULT), limit_s)
    if ended is None:
        eki.require(CommandName.RSI_STOP, rest_of(deadline))
    number = link.command(CommandKind.CLOSE)
    link.wait(lambda s: s.command_number >= number, rest_of(deadline))
