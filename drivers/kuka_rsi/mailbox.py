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
from enum import IntEnum
from typing import NamedTuple

from ronna_hw.arm.planning import MotionPlan, PathLimits
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector

MAGIC = b"RONNARSI"
SIZE = 65536
READ_TRIES = 100  # a writer is in the block for about 2 us

# Orders: single words, each written by one side only.
HEARTBEAT_AT = 64
STOP_AT = 72  # stop number * 8 + StopOrder
COMMAND_AT = 80  # number of the command in the command block
_ORDERS = struct.Struct("<QQQ")
_WORD = struct.Struct("<Q")

COMMAND_BLOCK_AT = 256
_COMMAND = struct.Struct("<QQBB6d6d3d3d9d3d")
STATE_BLOCK_AT = 1024
_STATE = struct.Struct("<QQq 8B QQ QQQQ 6d6d6d BB2d i")
HISTOGRAM_AT = 2048
HISTOGRAM_BINS = 64
RECORDER_AT = 4096
RECORDER_CYCLES = 256
_RECORD = struct.Struct("<QQqd6d6dB7x")

_CHECKSUM = struct.Struct("<I")


class CommandKind(IntEnum):
    """What the command block holds."""

    MOVE = 1
    OPEN = 2  # answer the next telegrams; the first correction is zero
    END = 3  # at rest, send Stop until the telegrams cease
    CLOSE = 4  # answer no more; clears a fault


class StopOrder(IntEnum):
    """Kinds of stop, as in `ronna_hw.devices.StopKind`."""

    HOLD = 1
    PROTECTIVE = 2
    LINK = 3
    DRIVES_OFF = 4


class Phase(IntEnum):
    """Where the real-time process stands."""

    STARTING = 0
    IDLE = 1  # no session: telegrams are not answered
    ARMED = 2  # a session is open, the first telegram has not come
    RUNNING = 3
    FAULT = 4  # latched: stopping or at rest, telegrams are answered with the last point
    ENDING = 5  # Stop is being sent
    SILENT = 6  # replies have ceased on request
    FAILED = 7  # could not start; `errno` says why


class Fault(IntEnum):
    """Why FAULT is latched."""

    NONE = 0
    MONITOR = 1
    SILENCE = 2
    HEARTBEAT = 3
    PROTECTIVE = 4
    LINK_STOP = 5
    DRIVES_OFF = 6
    PATH = 7
    RESTARTED = 8
    BASE = 9  # the first telegram's axes are outside the joint ranges


class Result(IntEnum):
    """What became of the last motion."""

    NONE = 0
    RUNNING = 1
    DONE = 2  # the path ended and the arm settled
    STOPPED = 3  # stopped on the way, and settled
    REFUSED_BUSY = 4
    REFUSED_START = 5  # planned from somewhere else
    REFUSED_PHASE = 6
    REFUSED_NUMBERS = 7
    REFUSED_STOP = 8  # a stop was ordered after the motion was planned


VIOLATIONS = ("", "range", "total correction", "step", "acceleration", "jerk", "following error")
CHOICES = ("go", "stop", "repeat", "hold")


class Orders(NamedTuple):
    """The three words the real-time process looks at in every cycle."""

    heartbeat: int
    stop_word: int
    command_number: int


class Command(NamedTuple):
    """One command; `plan` only for MOVE."""

    number: int
    kind: CommandKind
    plan: MotionPlan | None = None
    stop_number: int = 0  # the last stop known when it was written: a later stop overtakes the motion


class LinkState(NamedTuple):
    """What the real-time process says of itself, once per cycle. Angles in rad."""

    cycles: int
    IPOC: int
    received_ns: int
    phase: Phase
    fault: Fault
    result: Result
    degraded: bool
    moving: bool
    settled: bool
    real_time: bool
    locked: bool
    command_number: int
    stop_number: int  # the last stop order seen
    late: int  # the controller's count
    lost: int  # telegrams that never came, by the gap in IPOC
    rejected: int
    dropped: int  # older ones that were queued behind a stall
    measured_rad: JointVector
    commanded_rad: JointVector
    base_rad: JointVector
    violation_kind: str
    violation_axis: int
    violation_value: float
    violation_limit: float
    errno: int


_ZEROS: JointVector = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
NO_STATE = LinkState(
    cycles=0,
    IPOC=0,
    received_ns=0,
    phase=Phase.STARTING,
    fault=Fault.NONE,
    result=Result.NONE,
    degraded=False,
    moving=False,
    settled=False,
    real_time=False,
    locked=False,
    command_number=0,
    stop_number=0,
    late=0,
    lost=0,
    rejected=0,
    dropped=0,
    measured_rad=_ZEROS,
    commanded_rad=_ZEROS,
    base_rad=_ZEROS,
    violation_kind="",
    violation_axis=0,
    violation_value=0.0,
    violation_limit=0.0,
    errno=0,
)


class Record(NamedTuple):
    """One cycle in the recorder."""

    cycle: int
    IPOC: int
    received_ns: int
    turnaround_us: float
    measured_rad: JointVector
    sent_rad: JointVector
    choice: int


class MailboxTorn(RuntimeError):
    """A block could not be read whole; the other side is writing all the time, or is not one of ours."""


class Mailbox:
    """Either side's view of the memory."""

    def __init__(self, fd: int) -> None:
        self._memory = mmap.mmap(fd, SIZE)
        self._histogram = memoryview(self._memory)[HISTOGRAM_AT : HISTOGRAM_AT + 8 * HISTOGRAM_BINS].cast("Q")

    @staticmethod
    def initialise(fd: int) -> None:
        """Give fresh anonymous memory its size, its mark and a first state."""
        os.ftruncate(fd, SIZE)
        os.pwrite(fd, MAGIC, 0)
        mailbox = Mailbox(fd)
        mailbox.write_state(NO_STATE)
        mailbox.close()

    @property
    def is_ours(self) -> bool:
        """Whether the memory carries our mark."""
        return self._memory[: len(MAGIC)] == MAGIC

    def close(self) -> None:
        """Let go of the memory."""
        self._histogram.release()
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
        payload = _COMMAND.pack(
            command.number,
            command.stop_number,
            command.kind,
            target is not None,
            *(plan.start_rad if plan else zeros),
            *(plan.target_rad if plan else zeros),
            *(plan.limits if plan else zeros[:3]),
            *pose.position_mm,
            *pose.rotation,
            *(plan.tool_in_flange_mm if plan else zeros[:3]),
        )
        self._write_block(COMMAND_BLOCK_AT, payload)
        _WORD.pack_into(self._memory, COMMAND_AT, command.number)

    # ... and the real-time process reads.

    def orders(self) -> Orders:
        return Orders(*_ORDERS.unpack_from(self._memory, HEARTBEAT_AT))

    def read_command(self) -> Command | None:
        """The command block, or None while it is being written."""
        payload = self._read_block(COMMAND_BLOCK_AT, _COMMAND.size)
        if payload is None:
            return None
        number, stop_number, kind, has_pose, *v = _COMMAND.unpack(payload)
        plan = None
        if kind == CommandKind.MOVE:
            pose = Pose((v[15], v[16], v[17]), tuple(v[18:27])) if has_pose else None
            plan = MotionPlan(
                tuple(v[0:6]), tuple(v[6:12]), PathLimits(*v[12:15]), pose, (v[27], v[28], v[29])
            )
        return Command(number, CommandKind(kind), plan, stop_number)

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
            *state.measured_rad,
            *state.commanded_rad,
            *state.base_rad,
            VIOLATIONS.index(state.violation_kind),
            state.violation_axis,
            state.violation_value,
            state.violation_limit,
            state.errno,
        )
        self._write_block(STATE_BLOCK_AT, payload)

    def count_turnaround(self, bin_number: int) -> None:
        self._histogram[bin_number] += 1

    def clear_histogram(self) -> None:
        for k in range(HISTOGRAM_BINS):
            self._histogram[k] = 0

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
            v[17:23],
            v[23:29],
            v[29:35],
            VIOLATIONS[v[35]],
            v[36],
            v[37],
            v[38],
            v[39],
        )

    def histogram(self) -> tuple[int, ...]:
        return tuple(self._histogram)

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
