"""A run of the RSI program, from RSI_ON to RSI_OFF: telegrams, replies and drive commands.

It has neither socket nor clock: the caller sends what `telegram` returns, passes every datagram to `read`,
and ends each cycle with `finish`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from ronna_hw.wire.kuka_context import RsiContext
from ronna_hw.wire.kuka_eki import RsiState
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.drives import Supervision
from sim.kuka.manipulator import Manipulator
from sim.kuka.pendant import PendantMessage, rsi_bad, rsi_timeout
from sim.kuka.rsi.signal_flow import (
    ACTIVE_BIT,
    AxisCorrector,
    EthernetOutputs,
    PositionCorrector,
    SignalFlow,
    resolve_inputs,
)
from sim.kuka.rsi.telegrams import NO_CURRENTS, NO_FORCES, RejectedReplies, Reply, ReplyReader, TelegramWriter

IPOC_STEP = 2_654_435_761  # from run to run, modulo the range: a new run may begin higher or lower
EXIT_MOVE_CORR = "ExitMoveCorr"
INFO_MESSAGE = "InfoMessage"
PATH_FAST = "PathFast"


def first_ipoc(run_number: int, cycle_ms: int, parameters: ControllerParameters) -> int:
    """Return the IPOC of a run's first telegram, a multiple of the cycle, with runs numbered from 1."""
    stamp = (parameters.ipoc_start + (run_number - 1) * IPOC_STEP) % (1 << parameters.ipoc_bits)
    return stamp - stamp % cycle_ms


@dataclass(frozen=True)
class RunSettings:
    """Run settings, as requested."""

    context: RsiContext
    cycle_ms: int
    relative: bool
    number: int
    counts_from_first_reply: bool  # an autostarted program waits for its first client
    needs_confirmation: bool = False  # in T1 and T2 the operator confirms that corrections become active
    correction_share: float = 1.0  # share of a correction that takes effect, if the override scales it


class RsiRun:
    """State of one run; once `over`, `message` is the reason, or None if the client requested the end."""

    def __init__(self, settings: RunSettings, arm: Manipulator, parameters: ControllerParameters) -> None:
        context = settings.context
        self.settings = settings
        self.state = RsiState.ON
        self.ipoc = first_ipoc(settings.number, settings.cycle_ms, parameters)
        self._ipoc_range = 1 << parameters.ipoc_bits
        self.late = 0
        self.over = False
        self.message: PendantMessage | None = None
        self.notice = ""  # last EStr
        self.sent_once = False  # the cycle of the first telegram has ended
        self.held = False
        self._confirmed = not settings.needs_confirmation
        self._late_in_a_row = 0
        self._counting = not settings.counts_from_first_reply and not context.ethernet.only_send
        self._cycles = 0
        self._parameters = parameters
        self._acts_early = parameters.corrections_act == "rsi_on"
        behind = parameters.delay_lag_cycles + 1
        self._delays = deque([0] * behind, maxlen=behind)  # values of D now and in the next cycles
        self._timeout = context.ethernet.timeout_packets
        self._stop_mode = context.stop.mode if context.stop is not None else EXIT_MOVE_CORR
        self._writer = TelegramWriter(
            context.all_send,
            context.ethernet.precision,
            arm.reported_deg,
            arm.reported_frame,
            context.feedback,
        )
        self.rejected = RejectedReplies(context.ethernet.sentype)
        self._reader = ReplyReader(context.receive, context.ethernet.sentype, parameters)
        self._outputs = EthernetOutputs(context, parameters.missing_element)
        inputs = resolve_inputs(context)
        self._supervision = Supervision(
            arm.description, settings.cycle_ms / 1000.0, parameters, cartesian=inputs.frame is not None
        )
        start_deg, relative = arm.axes_deg, settings.relative
        axis = position = None
        if inputs.axes:
            axis = AxisCorrector(
                arm.description, start_deg, context.axis_correction, context.axis_monitor, relative=relative
            )
        if inputs.frame:
            position = PositionCorrector(
                arm.tool_point(),
                arm.base[:3, :3],
                start_deg,
                arm.joints_for,
                context.position_correction,
                context.position_monitor,
                relative=relative,
            )
        self.flow = SignalFlow(
            inputs, start_deg, axis, position, relative=relative, share=settings.correction_share
        )

    @property
    def command_deg(self) -> list[float]:
        """Commanded axes in degrees; the same object while nothing changes."""
        return self.flow.command_deg

    @property
    def correction_stats(self) -> tuple[int, int]:
        """Stat outputs of AXISCORR and POSCORR, showing whether each is active and which limits clamp it."""
        axis, position = self.flow.stats
        mask = -1 if self._parameters.stat_tells_limits else ACTIVE_BIT
        return axis & mask, position & mask

    @property
    def states_currents(self) -> bool:
        """Whether the telegrams have the motor currents."""
        return self._writer.states_currents

    @property
    def states_forces(self) -> bool:
        """Whether the telegrams have the signals of a force sensor."""
        return self._writer.states_forces

    def telegram(
        self,
        frame: Sequence[float],
        axes_deg: Sequence[float],
        currents: Sequence[float] = NO_CURRENTS,
        forces: Sequence[float] = NO_FORCES,
    ) -> bytes:
        """Return this cycle's telegram, with motor currents in percent and a sensor's forces in N and Nm."""
        late, stats = self._delays[0], self.correction_stats
        return self._writer.write(frame, axes_deg, late, self.ipoc, stats, currents, forces)

    @property
    def streams(self) -> bool:
        """Whether telegrams are being sent, which may start only after the program does."""
        return self.sent_once or self.state is RsiState.MOVECORR or self._parameters.streams_from == "rsi_on"

    def short_telegram(self) -> bytes:
        """Return a nearly empty telegram, like the first one of an RSI before 3.0."""
        return f'<Rob Type="KUKA"><IPOC>{self.ipoc}</IPOC></Rob>'.encode("ascii")

    def with_other_stamp(self, telegram: bytes) -> bytes:
        """Return the telegram with an IPOC that could come from another arm's controller."""
        other = (self.ipoc + self._ipoc_range // 2) % self._ipoc_range
        return telegram.replace(f">{self.ipoc}<".encode("ascii"), f">{other}<".encode("ascii"))

    def read(self, data: bytes) -> Reply | None:
        """Parse the reply to this cycle's telegram, or return None if it is broken, foreign or outdated."""
        reply = self._reader.read(data)
        if reply is not None and reply.ipoc == self.ipoc:
            return reply
        self.rejected.record(data, self.ipoc)
        return None

    def finish(self, reply: Reply | None) -> None:
        """Finish the cycle with or without a reply, and set `over` if the run ends."""
        self._cycles += 1
        if not self.sent_once and not self.streams:
            self._enter_movecorr()
            return
        self.sent_once = True
        self.ipoc = (self.ipoc + self.settings.cycle_ms) % self._ipoc_range
        if self.settings.context.ethernet.only_send:
            reply = None
        elif reply is None:
            if self._count_late():
                self._end(rsi_timeout(self.late))
                return
        else:
            self._late_in_a_row = 0
            self._counting = True
            if reply.message:
                self.notice = reply.message
        self._delays.append(self._delay())
        values = self._outputs.update(reply.values if reply is not None else None)
        if self.flow.stop_rises(values) and not self._handle_stop():
            return
        acts = self.state is RsiState.MOVECORR
        if acts or (self._acts_early and not self.held):
            self._correct(values, has_reply=reply is not None)
        if not acts:
            self._enter_movecorr()

    def hold(self) -> None:
        """Keep streaming but ignore corrections, because the program is stopped but not cancelled."""
        self.held = True
        self.state = RsiState.ON

    @property
    def awaits_confirmation(self) -> bool:
        """Whether an operator must confirm before corrections become active."""
        return not self._confirmed and self._cycles >= self._parameters.movecorr_after_cycles

    def confirm(self) -> None:
        """Allow corrections to become active."""
        self._confirmed = True

    @property
    def stops_fast(self) -> bool:
        """Whether the STOP object brakes with fast-stop ramps."""
        return self._stop_mode == PATH_FAST

    def _enter_movecorr(self) -> None:
        waited = self._cycles >= self._parameters.movecorr_after_cycles
        if waited and self._confirmed and not self.held:
            self.state = RsiState.MOVECORR

    def _delay(self) -> int:
        if self._parameters.delay_tells == "total":
            return self.late
        return self._late_in_a_row if self._parameters.delay_tells == "in_a_row" else 0

    def _correct(self, values: list[float], *, has_reply: bool) -> None:
        before = self.flow.command_deg
        message = self.flow.correct(values)
        if message is None:
            if self._parameters.at_end_switch == "clamp":
                self.flow.command_deg = self._supervision.clip_to_range(self.flow.command_deg)
            message = self._supervision.judge(self.flow.command_deg, before, has_reply=has_reply)
        if message is not None:
            self.flow.command_deg = before
            self._end(message)

    def _handle_stop(self) -> bool:
        """Handle a rising edge at STOP and return whether the run continues."""
        if self._stop_mode == INFO_MESSAGE:
            self.notice = "STOP1: stop requested"
            return True
        if self._stop_mode != EXIT_MOVE_CORR:
            self.hold()
            return True
        self._end(None if self.state is RsiState.MOVECORR else rsi_bad("STOP1"))
        return False

    def _count_late(self) -> bool:
        if not self._counting:
            return False
        self.late += 1
        self._late_in_a_row += 1
        consecutive = self._parameters.timeout_counting == "consecutive"
        return (self._late_in_a_row if consecutive else self.late) >= self._timeout

    def _end(self, message: PendantMessage | None) -> None:
        self.over = True
        self.message = message
