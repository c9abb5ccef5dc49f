"""Shared memory between driver and real-time process: orders, state and recorded cycles.

The memory is anonymous and passed by an inherited file descriptor, so nothing is left behind whichever side
dies. Every location in it has one writer; half-written rows are detected by their checksum.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import SURROUNDINGS_TOO_LARGE
from ronna_hw.arm_stream.records import (
    AXES,
    NO_STATE,
    STOP_KIND_BITS,
    CloseStream,
    Command,
    EndStream,
    GuideByHand,
    LinkState,
    Move,
    OpenStream,
    Orders,
    RecordedCycle,
    Request,
    StopOrder,
)
from ronna_hw.arm_stream.statistics import HISTOGRAM_BINS, histogram_bin
from ronna_hw.host.row_codec import RowCodec, one_of
from ronna_hw.host.shared_memory import ByteRing, MemoryMap

RECORDER_CYCLES = 1024  # four seconds of a controller's pace, a fifth of a second or more of lock-step
LAST_CYCLES = 256  # of these, in the record of a fault
LONGEST_SURROUNDINGS_BYTES = 24_000
KEPT_BYTES = 1 << 20  # of telegrams and replies: a third of a second at the pace of lock-step
LONGEST_KEPT_BYTES = 1 << 15  # a datagram of maximum length and its reply
READ_TRIES = 100  # a writer is in the block for about 2 us
REQUESTS: tuple[type[Request], ...] = (Move, OpenStream, EndStream, CloseStream, GuideByHand)


class CommandHead(NamedTuple):
    """Head of a command, before its request; a new `surroundings_number` means that they have changed."""

    number: Annotated[int, "Q"]
    stop_number: Annotated[int, "Q"]
    surroundings_number: Annotated[int, "Q"]
    request: Annotated[type[Request], one_of(REQUESTS)]


_HEAD = RowCodec(CommandHead)
_REQUESTS: dict[type[Request], RowCodec[Any]] = {request: RowCodec(request, AXES) for request in REQUESTS}

_MAP = MemoryMap(b"RONNAARM")
_HEARTBEAT = _MAP.word()
_STOP = _MAP.word()  # stop number and StopOrder
_COMMAND_NUMBER = _MAP.word()  # of the command in the row
_ALIVE_NS = _MAP.word()  # host monotonic time of the real-time process' last heartbeat
_COMMAND = _MAP.checked_bytes(_HEAD.size_bytes + max(codec.size_bytes for codec in _REQUESTS.values()))
_STATE = _MAP.checked_row(LinkState)
_TURNAROUNDS = _MAP.counters(HISTOGRAM_BINS)
_JITTER = _MAP.counters(HISTOGRAM_BINS)
_RECORDER = _MAP.rows(RecordedCycle, RECORDER_CYCLES)
RECORDER_ROW_BYTES = _RECORDER.stride
_SURROUNDINGS = _MAP.checked_bytes(LONGEST_SURROUNDINGS_BYTES)
_KEPT = ByteRing(_MAP.word(), _MAP.plain_bytes(KEPT_BYTES), LONGEST_KEPT_BYTES)


class KeptHead(NamedTuple):
    """Header of a recorded telegram and its reply; times are host monotonic."""

    received_ns: Annotated[int, "q"]
    sent_ns: Annotated[int, "q"]
    telegram_bytes: Annotated[int, "I"]
    reply_bytes: Annotated[int, "I"]


_KEPT_HEAD = RowCodec(KeptHead)


class KeptCycle(NamedTuple):
    """Recorded telegram and its reply, empty if none was sent; times are host monotonic."""

    received_ns: int
    sent_ns: int
    telegram: bytes
    reply: bytes


class MailboxTorn(RuntimeError):
    """No consistent state could be read: the writer never pauses, or the memory is not a mailbox."""


class Mailbox:
    """Shared memory as used by driver and real-time process."""

    def __init__(self, fd: int) -> None:
        self._memory = mmap.mmap(fd, _MAP.size_bytes)
        self._histogram = _TURNAROUNDS.view(self._memory)
        self._jitter = _JITTER.view(self._memory)
        self._surroundings = Surroundings()  # last written or read
        self._surroundings_number = 0
        self._fetched = 0  # bytes of kept cycles

    @staticmethod
    def initialise(fd: int) -> None:
        """Initialise newly created memory: size, mark and initial state."""
        os.ftruncate(fd, _MAP.size_bytes)
        os.pwrite(fd, _MAP.mark, 0)
        mailbox = Mailbox(fd)
        mailbox.write_state(NO_STATE)
        mailbox.close()

    def close(self) -> None:
        """Unmap the memory."""
        self._histogram.release()
        self._jitter.release()
        self._memory.close()

    # Written by the driver ...

    def write_heartbeat(self, count: int) -> None:
        _HEARTBEAT.write(self._memory, count)

    def order_stop(self, number: int, kind: StopOrder) -> None:
        _STOP.write(self._memory, number << STOP_KIND_BITS | kind)

    def write_command(self, command: Command) -> None:
        if command.surroundings is not self._surroundings:
            self._write_surroundings(command.surroundings)
        request = command.request
        head = CommandHead(command.number, command.stop_number, self._surroundings_number, type(request))
        _COMMAND.write(self._memory, _HEAD.pack(head) + _REQUESTS[type(request)].pack(request))
        _COMMAND_NUMBER.write(self._memory, command.number)

    def _write_surroundings(self, surroundings: Surroundings) -> None:
        line = surroundings.to_json().encode()
        if len(line) > LONGEST_SURROUNDINGS_BYTES:
            raise SURROUNDINGS_TOO_LARGE(
                "the arm's surroundings do not fit into its mailbox",
                limit=f"{LONGEST_SURROUNDINGS_BYTES} bytes",
                got=f"{len(line)} bytes",
            )
        self._surroundings = surroundings
        self._surroundings_number += 1
        _SURROUNDINGS.write(self._memory, line)

    # ... and read by the real-time process.

    def orders(self) -> Orders:
        memory = self._memory
        return Orders(_HEARTBEAT.read(memory), _STOP.read(memory), _COMMAND_NUMBER.read(memory))

    def stop_word(self) -> int:
        """Read the stop order, the only one that affects the very next reply."""
        return _STOP.read(self._memory)

    def read_command(self) -> Command | None:
        """Read the last command; None while it is being written."""
        line = _COMMAND.read(self._memory)
        if not line:  # also before the first
            return None
        head = _HEAD.unpack(line[: _HEAD.size_bytes])
        if not self._read_surroundings(head.surroundings_number):
            return None
        request = _REQUESTS[head.request].unpack(line[_HEAD.size_bytes :])
        return Command(head.number, request, head.stop_number, self._surroundings)

    def _read_surroundings(self, number: int) -> bool:
        """Read new surroundings; returns False while they are being written."""
        if number == self._surroundings_number:
            return True
        if (line := _SURROUNDINGS.read(self._memory)) is None:
            return False
        self._surroundings = Surroundings.from_json(line.decode())
        self._surroundings_number = number
        return True

    # Written by the real-time process ...

    def write_state(self, state: LinkState) -> None:
        _STATE.write(self._memory, state)

    def write_alive(self, now_ns: int) -> None:
        _ALIVE_NS.write(self._memory, now_ns)

    def count(self, turnaround_us: float, jitter_us: float) -> None:
        """Count the times of a cycle in their histograms."""
        self._histogram[histogram_bin(turnaround_us)] += 1
        self._jitter[histogram_bin(jitter_us)] += 1

    def clear_histograms(self) -> None:
        for k in range(HISTOGRAM_BINS):
            self._histogram[k] = self._jitter[k] = 0

    def record(self, record: RecordedCycle) -> None:
        _RECORDER.write(self._memory, record, record.cycle % RECORDER_CYCLES)

    def keep(self, received_ns: int, sent_ns: int, telegram: bytes, reply: bytes) -> None:
        """Keep a cycle's traffic until the driver fetches it or it is overwritten."""
        head = _KEPT_HEAD.pack(KeptHead(received_ns, sent_ns, len(telegram), len(reply)))
        _KEPT.write(self._memory, head + telegram + reply)

    # ... and read by the driver.

    def fetch_kept(self) -> tuple[list[KeptCycle], int]:
        """Return the cycles recorded since the last call, and the number of bytes lost to overwriting."""
        content, self._fetched, lost = _KEPT.read(self._memory, self._fetched)
        return list(_split_kept_cycles(content)), lost

    def read_state(self) -> LinkState:
        """Read the latest state; raises MailboxTorn if no consistent one can be read."""
        for _ in range(READ_TRIES):
            if (state := _STATE.read(self._memory)) is not None:
                return state
        raise MailboxTorn("the state row is never consistent")

    def read_alive_ns(self) -> int:
        """Read the time of the real-time process' last heartbeat, host monotonic; 0 before the first."""
        return _ALIVE_NS.read(self._memory)

    def read_histograms(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Read the histograms of turnaround and jitter."""
        return tuple(self._histogram), tuple(self._jitter)

    def read_records(self) -> tuple[RecordedCycle, ...]:
        """Return the last recorded cycles, oldest first; consistent only while recording is paused."""
        kept = (_RECORDER.read(self._memory, k) for k in range(RECORDER_CYCLES))
        return tuple(sorted(record for record in kept if record.cycle))[-LAST_CYCLES:]

    def copy_recorder(self) -> bytes:
        """Copy the flight recorder's rows as they are; the one of a running cycle may be half written."""
        return _RECORDER.copy(self._memory)


def _split_kept_cycles(content: bytes) -> Iterator[KeptCycle]:
    offset = 0
    while offset < len(content):
        head = _KEPT_HEAD.unpack_from(content, offset)
        offset += _KEPT_HEAD.size_bytes
        middle = offset + head.telegram_bytes
        end = middle + head.reply_bytes
        yield KeptCycle(head.received_ns, head.sent_ns, content[offset:middle], content[middle:end])
        offset = end
