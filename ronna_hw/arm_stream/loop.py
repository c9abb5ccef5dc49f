"""Main loop of a real-time process: what surrounds the exchange of telegrams.

The controller sends first and clocks everything. Nothing is computed between receiving and sending that could
have been computed before; after a stall only the newest telegram is answered.

This process has priority over all others. The network's soft interrupt, which may transmit the reply on this
processor, would have to wait until the next set-point is prepared. While the controller keeps a pace, the
processor is therefore yielded for a moment once the reply is out. Otherwise a peer on this machine would see
the preparation, 60 us and more, as turnaround.
"""

from __future__ import annotations

import os
import time
from abc import ABC, abstractmethod
from operator import attrgetter
from typing import Any

from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.pace import Line, PacedReceiver
from ronna_hw.arm_stream.records import Command, Orders, RecordedCycle, StreamPhase, StreamSettings
from ronna_hw.arm_stream.session import STREAMING_PHASES, StreamSession
from ronna_hw.host.real_time import ProcessorAffinity

# Without the parent and without a telegram for this long, there is no one left to answer.
QUIET_AFTER_STOP_NS = 100_000_000  # the program was asked to end
QUIET_BEFORE_STOP_NS = 400_000_000  # the usual Timeout of a controller: a loaded computer stalls for less
LONGEST_ENDING_CYCLES = 250  # of sending Stop after the parent is gone
YIELD_S = 50e-6  # of processor time after a reply; a cycle has 2,000 or more
RECORDED_AFTER_FAULT = 64  # cycles: how the stop began
LATE_CYCLES = 1.5  # waited this many cycles for a telegram: the host, or the network, was delayed
LOOK_EACH_CYCLES = 32  # of lock-step, for the processor of the sender and for foreign senders
# More than this share of a cycle, and this time, between two telegrams is a controller's pace: it leaves time
# to rest. Lock-step takes less, on a busy computer too; taken for a pace, it would stay that slow.
PACED_SHARE, LEAST_PACE_S = 0.2, 0.8e-3
LOCK_STEP_GAPS = 2  # shorter ones in a row; a single one follows a telegram that was late
# What a driver may wait for: it is woken by a change.
_awaited = attrgetter("phase", "fault", "result", "settled", "command_number", "stop_number")


class StreamLoop(ABC):
    """Main loop that ends once the parent has exited and the arm is at rest."""

    def __init__(
        self,
        session: StreamSession[Any, Any],
        settings: StreamSettings,
        line: Line[Any],
        mailbox: Mailbox,
        cycle_s: float,
        *,
        real_time: bool = False,
        locked: bool = False,
    ) -> None:
        self.session = session
        self._line = line
        self._receiver = PacedReceiver(
            line, lead_ns=settings.rehearsal_lead_us * 1000, rehearse=self._rehearse
        )
        self._processor = ProcessorAffinity(follows=real_time)
        self._mailbox = mailbox
        self._event_fd = settings.event_fd
        self._granted = (real_time, locked)
        self._may_be_paced = settings.keeps_pace
        self._keeps_bytes = settings.keeps_bytes
        self._received_ns = 0  # arrival of the last telegram
        self._last_reply = b""
        self._sent_ns = 0
        self._late_ns = round(LATE_CYCLES * cycle_s * 1e9)
        self._answered_ns = 0  # arrival of the last telegram answered
        self._paced_ns = round(max(PACED_SHARE * cycle_s, LEAST_PACE_S) * 1e9)
        self._short_gaps = 0  # between two telegrams answered, in a row
        self._turnaround_us = 0.0  # until its reply was sent
        self._command_number = 0
        self._published: object = None
        self._ending_cycles = 0
        self._stop_sent = False  # in the last reply
        self._lock_step_cycles = 0  # without a pause
        self._cycles_since_fault = 0

    @abstractmethod
    def _step(self) -> None:
        """Receive and answer a telegram, or call `_check_orders` when none arrives in time."""

    @abstractmethod
    def _rehearse(self) -> None:
        """Run the code path from telegram to reply without effect, to keep the caches warm."""

    def _look_aside(self) -> None:  # noqa: B027 -- not every protocol needs it
        """Look at what a stream in lock-step needs only now and then."""

    @abstractmethod
    def close(self) -> None:
        """Close what the loop has opened."""

    def run(self) -> None:
        """Run until the parent has exited and the arm is at rest."""
        self._publish()
        while not self._is_done():
            self._step()

    def _note_sent(self, reply: bytes) -> None:
        """Record a reply that has just been sent, and yield the processor at a controller's pace."""
        self._sent_ns = sent_ns = time.monotonic_ns()
        is_short = self._received_ns - self._answered_ns <= self._paced_ns
        self._short_gaps = self._short_gaps + 1 if is_short else 0
        if self._may_be_paced and self._short_gaps < LOCK_STEP_GAPS:
            if self._receiver.keeps_pace:  # before anything else: a peer on this processor waits for it
                time.sleep(YIELD_S)
            self._lock_step_cycles = 0
            if self._receiver.note_paced():
                self._processor.follow(self._line.processor())
        else:
            self._receiver.note_lock_step(stays_awake=self.session.moving and self._processor.has_others)
            self._lock_step_cycles += 1
            if self._is_time_to_look():
                self._processor.avoid(self._line.processor())
        self._last_reply = reply
        self._answered_ns = self._received_ns
        self._turnaround_us = (sent_ns - self._received_ns) / 1000.0

    def _is_time_to_look(self) -> bool:
        """Return whether system calls that lock-step needs only now and then are due; in a pace always."""
        return not self._lock_step_cycles or self._lock_step_cycles % LOOK_EACH_CYCLES == 1

    def _finish_cycle(self, data: bytes, device_clock: int, orders: Orders) -> None:
        """Prepare the next reply and record the completed cycle."""
        session, mailbox = self.session, self._mailbox
        self._stop_sent = session.phase is StreamPhase.ENDING
        session.finish_cycle(self._new_command(orders.command_number))
        mailbox.count(self._turnaround_us, session.jitter_us)
        self._cycles_since_fault = self._cycles_since_fault + 1 if session.fault else 0
        if self._cycles_since_fault <= RECORDED_AFTER_FAULT:
            mailbox.record(
                RecordedCycle(
                    session.cycles,
                    device_clock,
                    self._received_ns,
                    self._turnaround_us,
                    session.measured_rad,
                    session.sent_rad,
                    session.choice,
                )
            )
        if self._keeps_bytes:
            mailbox.keep(self._received_ns, self._sent_ns, data, self._last_reply)
        if self._is_time_to_look():
            self._look_aside()
        self._publish()

    def _leave_unanswered(self, data: bytes) -> None:
        if self._keeps_bytes:
            self._mailbox.keep(self._received_ns, 0, data, b"")
        self._check_orders()

    def _check_orders(self) -> None:
        """Check orders, silence and parent while no telegram is answered."""
        self._look_aside()
        orders = self._mailbox.orders()
        self.session.monitor_silence(orders, time.monotonic_ns())
        if (command := self._new_command(orders.command_number)) is not None:
            self.session.execute_command(command)
        self._publish()

    def _new_command(self, number: int) -> Command | None:
        """Return the latest command if complete and not seen yet."""
        if number == self._command_number:
            return None
        if (command := self._mailbox.read_command()) is None or command.number != number:
            return None
        self._command_number = number
        return command

    def _publish(self) -> None:
        real_time, locked = self._granted
        state = self.session.state(real_time=real_time, locked=locked)
        self._mailbox.write_state(state)
        self._mailbox.write_alive(time.monotonic_ns())
        if (published := _awaited(state)) != self._published:
            self._published = published
            os.eventfd_write(self._event_fd, 1)

    def _is_done(self) -> bool:
        session = self.session
        if not session.is_parent_gone:
            return False
        if session.phase not in STREAMING_PHASES:
            return True
        if session.phase is StreamPhase.ENDING:
            self._ending_cycles += 1
        quiet_ns = QUIET_AFTER_STOP_NS if self._stop_sent else QUIET_BEFORE_STOP_NS
        is_quiet = session.silent_for_ns(time.monotonic_ns()) > quiet_ns
        return is_quiet or self._ending_cycles > LONGEST_ENDING_CYCLES
