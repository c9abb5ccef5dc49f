"""Theatre time, read from the clock at a given endpoint.

Dwell, age, averaging and guards use this clock. I/O time limits use the host's monotonic clock. With `host:`
both are the same. With `shm://` the time is that of the simulated theatre. It stands still unless a device
advances it, so a case takes only as long as its work.
"""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import socket
import threading
import time
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple, Protocol

from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.errors import ConnectError
from ronna_hw.host.shared_memory import MemoryMap, Word

# Host time between two polls of a clock that another process advances, and the share of the time still to
# wait, at the clock's own rate, after which the next poll is made: each interrupts what advances the clock.
SHORTEST_POLL_S, LONGEST_POLL_S = 0.0002, 0.005
POLL_SHARE = 0.5


class ClockUnavailable(ConnectError):
    """The shared clock in the theatre file cannot be opened."""

    code = "CLK-001"
    action = (
        "A clock ends with its theatre. Start the theatre again, with --continue where a run is to go on, "
        "and use the file it writes."
    )


class Clock(Protocol):
    """Source of theatre time, in seconds since the theatre started."""

    @property
    def paced(self) -> bool:
        """Whether theatre time follows the host clock, so that host durations are meaningful."""

    def now_s(self) -> float:
        """Current theatre time, seconds."""

    def sleep(self, duration_s: float) -> None:
        """Sleep for `duration_s` of theatre time."""

    def let_pass(self, duration_s: float) -> None:
        """Let theatre time pass by `duration_s` at most, until `hold_back`, without waiting for it."""

    def hold_back(self) -> None:
        """Let theatre time pass no further unless somebody waits for it."""


class HostClock:
    """Monotonic host clock that starts at zero when opened."""

    def __init__(self) -> None:
        self._epoch_ns = time.monotonic_ns()

    @property
    def paced(self) -> bool:
        return True

    def now_s(self) -> float:
        return (time.monotonic_ns() - self._epoch_ns) / 1e9

    def sleep(self, duration_s: float) -> None:
        time.sleep(max(0.0, duration_s))

    def let_pass(self, duration_s: float) -> None:
        """Do nothing: host time passes anyway."""

    def hold_back(self) -> None:
        """Do nothing: host time passes anyway."""


@contextmanager
def passing(clock: Clock, duration_s: float) -> Iterator[None]:
    """Let theatre time pass by `duration_s` at most within the block, for what it awaits in host time."""
    clock.let_pass(duration_s)
    try:
        yield
    finally:
        clock.hold_back()


# Layout of the shared clock. Times are nanoseconds of theatre time unless stated otherwise.
LAYOUT_VERSION = 7
CLOCK = MemoryMap(b"RONNACLK")
VERSION = CLOCK.word("I")
PACED = CLOCK.word("I")  # 1 when theatre time follows the host's clock, 0 when devices advance it
TIME_NS = CLOCK.word("q")  # meaningful when not paced
EPOCH_NS = CLOCK.word("q")  # host monotonic time at theatre time 0, meaningful when paced
WANTED_NS = CLOCK.word("q")  # the latest theatre time that any process waits for
UNREAD_NS = CLOCK.word("q")  # due time of the next measurement of a tracker that is being read, 0 for none
ALLOWED_NS = CLOCK.word("q")  # the latest theatre time that may pass although nobody waits for it
TURN = CLOCK.word("I")  # number of the cyclic device that runs while others that stream wait


class StreamRow(NamedTuple):
    """Words of one cyclic device, each written by that device only."""

    host_ns: Word  # host monotonic time of its last cycle, 0 if it does not stream
    time_ns: Word  # theatre time at the end of its last cycle
    resting: Word  # what it sleeps for; 0 while it does not
    stands: Word  # 1 while its cycles show nothing new


CYCLIC_DEVICES = 2  # the arms of a theatre
STREAMS = tuple(StreamRow(*map(CLOCK.word, "qqII")) for _ in range(CYCLIC_DEVICES))
FOR_TIME_TO_PASS, FOR_READER, FOR_TURN = 1, 2, 3
# Two devices that stream run in turns, in each until the one is this far ahead of the other: with each cycle
# in step, processes that alternate on the same processors find cold caches, at twice the time per cycle.
TURN_NS = 12_000_000
# Theatre time of one cycle of a device that stands while another moves: its cycles show nothing new.
STANDING_CYCLE_NS = 96_000_000
ALARM_LIMIT = 64  # calls taken from an alarm at once; a flood of them must not hold the cycles
# The longest time that a process asks for at once: one that was killed keeps time passing no longer.
WISH_NS = 2_000_000_000
# A cyclic device that has not run a cycle for this long no longer controls the pace of time. It waits two
# seconds for a missing reply (see the robot simulator), so the limit is above that.
STREAM_SILENCE_NS = 2_500_000_000


class _ClockLock:
    """Lock of a clock, which excludes other processes and other threads of this process.

    Taken in every cycle: a generator with `contextmanager` would cost as much again.
    """

    def __init__(self, file: int) -> None:
        self._file = file
        self._threads = threading.Lock()

    def __enter__(self) -> None:
        self._threads.acquire()
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX)
        except BaseException:
            self._threads.release()
            raise

    def __exit__(self, *_: object) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_UN)
        finally:
            self._threads.release()


class SharedClock:
    """Clock shared by several processes, at the start of a `shm://` block.

    While a cyclic device streams (the correction stream of a robot), only its cycles advance the time and
    everything else waits; otherwise a wait advances the time itself. A process requests time to pass under
    the lock. Two devices that stream take turns, at most `TURN_NS` apart: the time is that of the slower one.
    """

    def __init__(self, path: str, device: int = 0) -> None:
        """Open the clock; `device` is the number of the cyclic device, if this process is one."""
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        except (OSError, ValueError) as error:  # the latter for what is no path at all
            reason = error.strerror if isinstance(error, OSError) else error
            raise ClockUnavailable(f"cannot open the clock at {path}: {reason}") from error
        self._file_closer = weakref.finalize(self, os.close, self._file)
        try:
            self._memory = mmap.mmap(self._file, CLOCK.size_bytes)
        except (OSError, ValueError) as error:
            self._file_closer()
            raise ClockUnavailable(f"{path} is too short for a clock file") from error
        self._caller = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._caller_closer = weakref.finalize(self, self._caller.close)
        memory = self._memory
        if not CLOCK.is_marked(memory) or VERSION.read(memory) != LAYOUT_VERSION:
            self.close()
            raise ClockUnavailable(f"{path} is not a clock file of this version")
        self._lock = _ClockLock(self._file)
        found = os.fstat(self._file)
        self._alarm_address = f"\0ronna-clock-{found.st_dev}-{found.st_ino}"
        self._device = device
        self._stream = STREAMS[device]
        self._paced = bool(PACED.read(self._memory))

    @staticmethod
    def initialise(memory: mmap.mmap, *, paced: bool, begins_ns: int = 0) -> None:
        """Initialise a clock at theatre time `begins_ns` in the first bytes of a block."""
        CLOCK.mark_memory(memory)
        VERSION.write(memory, LAYOUT_VERSION)
        PACED.write(memory, int(paced))
        TIME_NS.write(memory, begins_ns)
        for word in (WANTED_NS, UNREAD_NS, ALLOWED_NS, TURN, *(word for row in STREAMS for word in row)):
            word.write(memory, 0)
        EPOCH_NS.write(memory, time.monotonic_ns() - begins_ns)

    @property
    def paced(self) -> bool:
        return self._paced

    def now_ns(self) -> int:
        """Current theatre time, nanoseconds."""
        if self._paced:
            return time.monotonic_ns() - EPOCH_NS.read(self._memory)
        return TIME_NS.read(self._memory)

    def now_s(self) -> float:
        return self.now_ns() / 1e9

    def sleep(self, duration_s: float) -> None:
        self.wait_until_ns(self.now_ns() + round(max(0.0, duration_s) * 1e9))

    def wait_until_ns(self, moment_ns: int) -> None:
        """Wait until theatre time reaches `moment_ns`, advancing it unless a device is streaming."""
        if self._paced:
            time.sleep(max(0, moment_ns - self.now_ns()) / 1e9)
            return
        began_ns, began_s = self.now_ns(), time.monotonic()
        while (now_ns := self.now_ns()) < moment_ns:
            wanted_ns = min(moment_ns, now_ns + WISH_NS)
            # Without the lock: the time only grows, and so does the latest time wanted.
            is_unasked = WANTED_NS.read(self._memory) < min(moment_ns, now_ns + WISH_NS // 2)
            if is_unasked or not self.is_streaming():
                with self._lock:
                    if self.now_ns() >= moment_ns:
                        return
                    if not self.is_streaming():
                        TIME_NS.write(self._memory, moment_ns)
                        return
                    if WANTED_NS.read(self._memory) < wanted_ns:
                        WANTED_NS.write(self._memory, wanted_ns)
                self._wake_devices(FOR_TIME_TO_PASS, FOR_READER)
            left = (moment_ns - now_ns) / max(1, now_ns - began_ns)  # in units of the time waited so far
            waited_s = time.monotonic() - began_s if now_ns > began_ns else 0.0
            time.sleep(min(LONGEST_POLL_S, max(SHORTEST_POLL_S, POLL_SHARE * left * waited_s)))

    def let_pass(self, duration_s: float) -> None:
        """Let a streaming device advance the time by `duration_s` at most, as while a motion is followed.

        Without the lock: two that ask at once lose the shorter grant at most, and both ask again.
        """
        if self._paced:
            return
        moment_ns = self.now_ns() + round(duration_s * 1e9)
        if ALLOWED_NS.read(self._memory) < moment_ns:
            ALLOWED_NS.write(self._memory, moment_ns)
        self._wake_devices(FOR_TIME_TO_PASS, FOR_READER)

    def hold_back(self) -> None:
        """Have a streaming device rest as soon as nobody waits; another thread's `let_pass` ends as well."""
        if self._paced:
            return
        ALLOWED_NS.write(self._memory, 0)

    def has_waiters(self) -> bool:
        """Whether any process is waiting for a future theatre time."""
        return WANTED_NS.read(self._memory) > TIME_NS.read(self._memory)

    def may_pass(self) -> bool:
        """Whether any process waits for a future theatre time or lets time pass."""
        return self.has_waiters() or ALLOWED_NS.read(self._memory) > TIME_NS.read(self._memory)

    def open_alarm(self) -> socket.socket:
        """Open the socket that becomes readable when a resting device is to go on."""
        alarm = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        with contextlib.suppress(OSError):  # the device then looks by itself from time to time
            alarm.bind(f"{self._alarm_address}-{self._device}")
        return alarm

    @staticmethod
    def silence(alarm: socket.socket) -> None:
        """Clear an alarm's pending wake-ups, so that the next wait blocks until a new one."""
        with contextlib.suppress(BlockingIOError):
            for _ in range(ALARM_LIMIT):
                alarm.recv(1)

    @contextmanager
    def rest(self, alarm: socket.socket, reason: int = FOR_TIME_TO_PASS) -> Iterator[None]:
        """Have this cyclic device woken by its alarm, which is to be silenced after each wake.

        What it sleeps for, `may_pass` or the end of `must_wait_for_reader` or `must_wait_for_turn`, is to be
        checked within first.
        """
        self._stream.resting.write(self._memory, reason)
        if reason == FOR_TIME_TO_PASS:
            self._wake_devices(FOR_TURN)  # it may be theirs
        try:
            yield
        finally:
            self._stream.resting.write(self._memory, 0)

    def _wake_devices(self, *reasons: int) -> None:
        """Ring the alarms of the devices that rest for one of these reasons."""
        for number, row in enumerate(STREAMS):
            if row.resting.read(self._memory) in reasons:
                with contextlib.suppress(OSError):  # its alarm is already ringing, or it has ended
                    self._caller.sendto(b"", f"{self._alarm_address}-{number}")

    def is_streaming(self) -> bool:
        """Whether a cyclic device controls the pace of time."""
        return any(self._streams(row) for row in STREAMS)

    def _streams(self, row: StreamRow) -> bool:
        last = row.host_ns.read(self._memory)
        return last != 0 and time.monotonic_ns() - last < STREAM_SILENCE_NS

    def advance_cycle(self, duration_ns: int, *, stands: bool = False) -> int:
        """Advance by one cycle of this cyclic device and return the new time. No effect when paced.

        A device that stands while another moves takes `STANDING_CYCLE_NS` for a cycle. Where all stand, all
        but the first take `TURN_NS`, which costs readers of a tracker none of its frames; the first takes up
        to that where somebody waits so long.
        Ahead of another device that streams, the time stands until that one has come as far; `TURN_NS` ahead,
        this device is to wait while `must_wait_for_turn`.
        """
        if self._paced:
            return self.now_ns()
        memory, own = self._memory, self._stream
        with self._lock:
            own.stands.write(memory, int(stands))
            if stands:
                duration_ns = max(duration_ns, self._standing_cycle_ns(duration_ns))
            ends_ns = self._cycle_start_ns() + duration_ns
            own.time_ns.write(memory, ends_ns)
            own.host_ns.write(memory, time.monotonic_ns())
            slowest = self._keep_step()
            is_over = slowest != self._device and ends_ns - STREAMS[slowest].time_ns.read(memory) >= TURN_NS
            if is_over:
                TURN.write(memory, slowest)
                if WANTED_NS.read(memory) < ends_ns:
                    WANTED_NS.write(memory, ends_ns)
        if is_over:
            self._wake_devices(FOR_TURN, FOR_TIME_TO_PASS)
        return self.now_ns()

    def must_wait_for_turn(self) -> bool:
        """Return whether another cyclic device has the turn, one that streams and has a reason to go on."""
        memory = self._memory
        if self._paced or (turn := TURN.read(memory)) == self._device:
            return False
        with self._lock:
            self._stream.host_ns.write(memory, time.monotonic_ns())
            self._keep_step()
            other = STREAMS[turn]
            rests = other.resting.read(memory) == FOR_TIME_TO_PASS
            is_level = other.time_ns.read(memory) >= self._stream.time_ns.read(memory)
            if self._streams(other) and not (rests and is_level):
                return True
            TURN.write(memory, self._device)  # the other has ended, has fallen silent or rests
        return False

    def _standing_cycle_ns(self, cycle_ns: int) -> int:
        """Return the least theatre time of this device's cycle while it stands.

        The first device that sets the pace takes as many cycles at once as the latest wait needs: the time
        ends where single cycles would have left it. Somebody who lets time pass may count cycles, and gets
        single ones.
        """
        memory = self._memory
        streaming = [number for number, row in enumerate(STREAMS) if self._streams(row)]
        if not all(STREAMS[number].stands.read(memory) for number in streaming):
            return STANDING_CYCLE_NS
        if min(streaming, default=self._device) != self._device:
            return TURN_NS
        now_ns = TIME_NS.read(memory)
        if ALLOWED_NS.read(memory) > now_ns:
            return cycle_ns
        awaited_cycles = -((now_ns - WANTED_NS.read(memory)) // cycle_ns)
        return min(awaited_cycles, TURN_NS // cycle_ns) * cycle_ns

    def _cycle_start_ns(self) -> int:
        """Return the theatre time at which this device's next cycle begins."""
        now_ns = TIME_NS.read(self._memory)
        return max(now_ns, self._stream.time_ns.read(self._memory)) if self._streams(self._stream) else now_ns

    def _keep_step(self) -> int:
        """Let the time follow the slowest device that streams; return its number, this one's if none does."""
        memory = self._memory
        reached = [(row.time_ns.read(memory), n) for n, row in enumerate(STREAMS) if self._streams(row)]
        reached_ns, slowest = min(reached, default=(0, self._device))
        if reached_ns > TIME_NS.read(memory):
            TIME_NS.write(memory, reached_ns)
        return slowest

    def expect_reader(self, moment_ns: int) -> None:
        """Set when the next individually read measurement is due; 0 clears it."""
        UNREAD_NS.write(self._memory, moment_ns)
        self._wake_devices(FOR_READER)

    def must_wait_for_reader(self, duration_ns: int) -> bool:
        """Whether the next cycle would reach a measurement that no reader is waiting for yet."""
        if (due_ns := UNREAD_NS.read(self._memory)) == 0 or self._paced or self.has_waiters():
            return False
        return self._cycle_start_ns() + duration_ns >= due_ns

    def end_stream(self) -> None:
        """Mark the cyclic stream as ended, so that it no longer paces theatre time."""
        with self._lock:
            self._stream.host_ns.write(self._memory, 0)
            if not self._paced:
                self._keep_step()
        self._wake_devices(FOR_TIME_TO_PASS, FOR_READER, FOR_TURN)

    def close(self) -> None:
        """Release the shared memory; safe to call twice."""
        self._caller_closer()
        self._memory.close()
        self._file_closer()


def open_clock(endpoint: Endpoint | str) -> HostClock | SharedClock:
    """Open the clock of a theatre file: `host:` or `shm://`."""
    address = parse_endpoint(endpoint) if isinstance(endpoint, str) else endpoint
    address.require("host", "shm")
    return HostClock() if address.scheme == "host" else SharedClock(address.path)
