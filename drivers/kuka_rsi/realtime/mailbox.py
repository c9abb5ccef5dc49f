"""Shared memory between the driver and its real-time process: orders in, state out, last cycles kept.

The memory is anonymous and passed by an inherited file descriptor, so nothing is left behind whoever dies.
Small orders are single aligned words. Blocks carry a checksum: a reader that meets a half-written one sees
that and tries again; nobody ever waits for the other side.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from socket import inet_aton, inet_ntoa

from drivers.kuka_rsi.realtime.link_state import (
    NO_STATE,
    VIOLATIONS,
    Command,
    CommandKind,
    Fault,
    LinkState,
    Orders,
    Phase,
    Record,
    Result,
    StopOrder,
)
from ronna_hw.arm.errors import SurroundingsTooLarge
from ronna_hw.arm.planning import MotionPlan
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.progress import MOST_STEPS, PathLimits, SpeedStep
from ronna_hw.arm.surroundings import Surroundings

MAGIC = b"RONNARSI"
SIZE = 65536
READ_TRIES = 100  # a writer is in the block for about 2 us

# Orders: single words, each written by one side only.
HEARTBEAT_AT = 64
STOP_AT = 72  # stop number * 8 + StopOrder
COMMAND_AT = 80  # number of the command in the command block
ALIVE_AT = 88  # host monotonic time of the real-time process' last look, ns: written by that process
_ORDERS = struct.Struct("<QQQ")
_WORD = struct.Struct("<Q")

COMMAND_BLOCK_AT = 256
_COMMAND = struct.Struct(f"<QQBBB6d6d3d3d9d3d{2 * MOST_STEPS}d")
STATE_BLOCK_AT = 1024
_STATE = struct.Struct("<QQq 8B QQ QQQQQ4s 6d6d6d BB2d i")
HISTOGRAM_BINS = 64
HISTOGRAM_AT = 2048  # of turnarounds
JITTER_AT = HISTOGRAM_AT + 8 * HISTOGRAM_BINS
NOBODY = "0.0.0.0"  # no host
RECORDER_AT = 4096
RECORDER_CYCLES = 256
_RECORD = struct.Struct("<QQqd6d6dB7x")

_CHECKSUM = struct.Struct("<I")
SURROUNDINGS_AT = 40960
_COUNTED = struct.Struct("<QI")  # which surroundings, and how long the line is that follows
COUNTED_SIZE = _CHECKSUM.size + _COUNTED.size
LONGEST_SURROUNDINGS = SIZE - SURROUNDINGS_AT - COUNTED_SIZE - _CHECKSUM.size
LARGEST_BYTE = 255
NO_STEP = SpeedStep(0.0, 0.0)


class MailboxTorn(RuntimeError):
    """A block could not be read whole; the other side is writing all the time, or is not one of ours."""


class Mailbox:
    """Either side's view of the memory."""

    def __init__(self, fd: int) -> None:
        self._memory = mmap.mmap(fd, SIZE)
        whole = memoryview(self._memory)
        self._histogram = whole[HISTOGRAM_AT:JITTER_AT].cast("Q")
        self._jitter = whole[JITTER_AT : JITTER_AT + 8 * HISTOGRAM_BINS].cast("Q")
        whole.release()
        self._surroundings = Surroundings()  # the last written or read
        self._surroundings_number = 0

    @staticmethod
    def initialise(fd: int) -> None:
        """Give fresh anonymous memory its size, its mark and a first state."""
        os.ftruncate(fd, SIZE)
        os.pwrite(fd, MAGIC, 0)
        mailbox = Mailbox(fd)
        mailbox.write_state(NO_STATE)
        mailbox._write_surroundings(Surroundings())
        mailbox.close()

    @property
    def is_ours(self) -> bool:
        """Whether the memory carries our mark."""
        return self._memory[: len(MAGIC)] == MAGIC

    def close(self) -> None:
        """Let go of the memory."""
        self._histogram.release()
        self._jitter.release()
        self._memory.close()

    # The driver's side writes ...

    def beat(self, count: int) -> None:
        _WORD.pack_into(self._memory, HEARTBEAT_AT, count)

    def order_stop(self, number: int, kind: StopOrder) -> None:
        _WORD.pack_into(self._memory, STOP_AT, number * 8 + kind)

    def write_command(self, command: Command) -> None:
        plan = command.plan
        target = plan.target if plan else None
        pose = target or Pose()
        zeros = (0.0,) * 6
        steps = plan.speed_steps if plan else ()
        payload = _COMMAND.pack(
            command.number,
            command.stop_number,
            command.kind,
            target is not None,
            len(steps),
            *(plan.start_rad if plan else zeros),
            *(plan.target_rad if plan else zeros),
            *(plan.limits if plan else zeros[:3]),
            *pose.position_mm,
            *pose.rotation,
            *(plan.tool_in_flange_mm if plan else zeros[:3]),
            *(value for step in (*steps, *(NO_STEP,) * (MOST_STEPS - len(steps))) for value in step),
        )
        if command.surroundings is not self._surroundings:
            self._write_surroundings(command.surroundings)
        self._write_block(COMMAND_BLOCK_AT, payload)
        _WORD.pack_into(self._memory, COMMAND_AT, command.number)

    def _write_surroundings(self, surroundings: Surroundings) -> None:
        line = surroundings.to_json().encode()
        if len(line) > LONGEST_SURROUNDINGS:
            raise SurroundingsTooLarge(
                "the arm's surroundings do not fit into its mailbox",
                limit=f"{LONGEST_SURROUNDINGS} bytes",
                got=f"{len(line)} bytes",
            )
        self._surroundings = surroundings
        self._surroundings_number += 1
        self._write_block(SURROUNDINGS_AT, _COUNTED.pack(self._surroundings_number, len(line)))
        self._write_block(SURROUNDINGS_AT + COUNTED_SIZE, line)

    # ... and the real-time process reads.

    def orders(self) -> Orders:
        return Orders(*_ORDERS.unpack_from(self._memory, HEARTBEAT_AT))

    def stop_word(self) -> int:
        """The one order that changes the very next reply."""
        word: int = _WORD.unpack_from(self._memory, STOP_AT)[0]
        return word

    def read_command(self) -> Command | None:
        """The command block, or None while it is being written."""
        payload = self._read_block(COMMAND_BLOCK_AT, _COMMAND.size)
        if payload is None:
            return None
        number, stop_number, kind, has_pose, steps, *v = _COMMAND.unpack(payload)
        plan = None
        if kind == CommandKind.MOVE:
            if not self._read_surroundings():
                return None
            pose = Pose((v[15], v[16], v[17]), tuple(v[18:27])) if has_pose else None
            slower = tuple(SpeedStep(v[30 + 2 * k], v[31 + 2 * k]) for k in range(steps))
            plan = MotionPlan(
                tuple(v[0:6]), tuple(v[6:12]), PathLimits(*v[12:15]), pose, (v[27], v[28], v[29]), slower
            )
        return Command(number, CommandKind(kind), plan, stop_number, self._surroundings)

    def _read_surroundings(self) -> bool:
        """Take over new surroundings; False while they are being written."""
        counted = self._read_block(SURROUNDINGS_AT, _COUNTED.size)
        if counted is None:
            return False
        number, size = _COUNTED.unpack(counted)
        if number == self._surroundings_number:
            return True
        line = self._read_block(SURROUNDINGS_AT + COUNTED_SIZE, size)
        if line is None:
            return False
        self._surroundings = Surroundings.from_json(line.decode())
        self._surroundings_number = number
        return True

    # The real-time process writes ...

    def write_state(self, state: LinkState) -> None:
        payload = _STATE.pack(
            state.cycles,
            state.IPOC,
            state.received_ns,
            state.phase,
            state.fault,
            state.result,
            state.degraded,
            state.moving,
            state.settled,
            state.real_time,
            state.locked,
            state.command_number,
            state.stop_number,
            state.late,
            state.lost,
            state.rejected,
            state.dropped,
            state.foreign,
            inet_aton(state.foreign_host or NOBODY),
            *state.measured_rad,
            *state.commanded_rad,
            *state.base_rad,
            VIOLATIONS.index(state.violation_kind),
            min(state.violation_axis, LARGEST_BYTE),
            state.violation_value,
            state.violation_limit,
            state.errno,
        )
        self._write_block(STATE_BLOCK_AT, payload)

    def say_alive(self, now_ns: int) -> None:
        _WORD.pack_into(self._memory, ALIVE_AT, now_ns)

    def count_turnaround(self, bin_number: int) -> None:
        self._histogram[bin_number] += 1

    def count_jitter(self, bin_number: int) -> None:
        self._jitter[bin_number] += 1

    def clear_histograms(self) -> None:
        for k in range(HISTOGRAM_BINS):
            self._histogram[k] = self._jitter[k] = 0

    def record(self, record: Record) -> None:
        slot = RECORDER_AT + (record.cycle % RECORDER_CYCLES) * _RECORD.size
        _RECORD.pack_into(
            self._memory, slot, *record[:4], *record.measured_rad, *record.sent_rad, record.choice
        )

    # ... and the driver reads.

    def read_state(self) -> LinkState:
        """The state of the last cycle; raises MailboxTorn when no whole one can be had."""
        payload = None
        for _ in range(READ_TRIES):
            payload = self._read_block(STATE_BLOCK_AT, _STATE.size)
            if payload is not None:
                break
        if payload is None:
            raise MailboxTorn("the state block is never whole")
        v = _STATE.unpack(payload)
        return LinkState(
            v[0],
            v[1],
            v[2],
            Phase(v[3]),
            Fault(v[4]),
            Result(v[5]),
            bool(v[6]),
            bool(v[7]),
            bool(v[8]),
            bool(v[9]),
            bool(v[10]),
            v[11],
            v[12],
            v[13],
            v[14],
            v[15],
            v[16],
            v[17],
            inet_ntoa(v[18]) if any(v[18]) else "",
            v[19:25],
            v[25:31],
            v[31:37],
            VIOLATIONS[v[37]],
            v[38],
            v[39],
            v[40],
            v[41],
        )

    def said_alive_ns(self) -> int:
        """When the real-time process last looked around, host monotonic; 0 before its first look."""
        said: int = _WORD.unpack_from(self._memory, ALIVE_AT)[0]
        return said

    def histogram(self) -> tuple[int, ...]:
        return tuple(self._histogram)

    def jitter_histogram(self) -> tuple[int, ...]:
        return tuple(self._jitter)

    def records(self) -> tuple[Record, ...]:
        """The recorded cycles, oldest first. Whole only while the recorder stands still."""
        found = []
        for k in range(RECORDER_CYCLES):
            v = _RECORD.unpack_from(self._memory, RECORDER_AT + k * _RECORD.size)
            if v[0]:
                found.append(Record(v[0], v[1], v[2], v[3], v[4:10], v[10:16], v[16]))
        return tuple(sorted(found))

    def _write_block(self, at: int, payload: bytes) -> None:
        # The checksum goes first and last would do as well: either way a torn block does not match it.
        end = at + _CHECKSUM.size + len(payload)
        self._memory[at:end] = _CHECKSUM.pack(zlib.crc32(payload)) + payload

    def _read_block(self, at: int, size: int) -> bytes | None:
        block = self._memory[at : at + _CHECKSUM.size + size]
        payload = block[_CHECKSUM.size :]
        if zlib.crc32(payload) != _CHECKSUM.unpack_from(block)[0]:
            return None
        return payload
