"""Commands as child processes: awaiting READY or exit, guaranteed termination, and hang detection.

A child prints one line `READY {json}` on standard output when clients may connect, and exits when its parent
dies. The end of its standard error is kept for the message if it fails. Even on a busy computer a working
process uses some processor time; one that uses none hangs.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from queue import Empty, SimpleQueue
from typing import IO, TYPE_CHECKING, Any, Protocol

from ronna_hw.errors import LinkTimeout
from ronna_hw.host.process import describe_exit, shield_children
from ronna_hw.logs import logger

if TYPE_CHECKING:
    import psutil


HANGS = "Run the command alone to see why it hangs."
TOO_SLOW = "Close other programs if this computer is busy; else run the command alone to see why it hangs."
READY_TIMEOUT_S = 60.0  # a busy computer takes many times the seconds that a start needs
IDLE_TIMEOUT_S = 10.0  # without processor time: it is halted, or waits for what does not come
STOP_TIMEOUT_S = 2.0  # the contract of every command that prints READY, for SIGTERM
MESSAGE_LINES_KEPT = 5
LAST_ROUNDS = 5  # of looking for processes that were started while others were ended
_PR_SET_CHILD_SUBREAPER = 36  # linux/prctl.h
POLL_S = 1.0  # between two readings, each of which lists the computer's processes
OUTPUT_POLL_S = 0.1  # host time


class ChildNotReady(LinkTimeout):
    """A child process ended or fell silent before becoming ready."""

    code = "PRC-001"
    action = "Run the command alone to see why it stops."


def timeout_error(what: str, late_s: float | None, idle_s: float = IDLE_TIMEOUT_S) -> ChildNotReady:
    """Build the error for a process overdue by `late_s` or, if None, idle for `idle_s`."""
    if late_s is not None:
        return ChildNotReady(what, limit=f"{late_s:g} s", action=TOO_SLOW)
    return ChildNotReady(what, limit=f"{idle_s:g} s without using the processor", action=HANGS)


def command(module: str, *arguments: str) -> list[str]:
    """Return the command line of one of our modules, run by this Python regardless of the path."""
    return [sys.executable, "-P", "-m", module, *arguments]


class RunningProcess(Protocol):
    """Process that `ChildProcess` watches and ends: the part of `subprocess.Popen` that it uses."""

    @property
    def pid(self) -> int:
        """Number of the process."""

    @property
    def returncode(self) -> int | Any:
        """Exit code, negative for a signal, as of the last `poll` or `wait`; None before the end."""

    @property
    def stdout(self) -> IO[str] | None:
        """Standard output of the process."""

    @property
    def stderr(self) -> IO[str] | None:
        """Messages of the process."""

    def poll(self) -> int | None:
        """Return the exit code; None while the process runs."""

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the exit code; raises subprocess.TimeoutExpired."""

    def terminate(self) -> None:
        """Send SIGTERM."""

    def kill(self) -> None:
        """Send SIGKILL."""


class ChildProcess:
    """Running child process. `ready` holds the fields of its READY line."""

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        *,
        timeout_s: float | None = READY_TIMEOUT_S,
        inherited: Sequence[int] = (),
        started: RunningProcess | None = None,
        on_message: Callable[[str], None] = lambda _line: None,
    ) -> None:
        """Start the process and wait until it is ready; raises PRC-001. `on_message` receives its messages.

        `inherited` are descriptors passed to it; `started` is a process that runs these arguments already.
        With `timeout_s` None there is no wait, so that several can start in parallel: `await_ready` must
        follow.
        """
        self.name = name
        self._log = logger(process=name)
        self.ready: dict[str, Any] = {}
        self._end_logged = False
        self._on_message = on_message
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        self._messages: deque[str] = deque(maxlen=MESSAGE_LINES_KEPT)
        self.process: RunningProcess = started or subprocess.Popen(
            list(arguments),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            # Ctrl-C reaches the whole foreground group: the parent decides what ends, and when.
            start_new_session=True,
            pass_fds=inherited,
        )
        self._log.debug("started", pid=self.process.pid)
        self._readers = [
            threading.Thread(target=self._read_output, args=(self.process.stdout,), daemon=True),
            threading.Thread(target=self._read_messages, args=(self.process.stderr,), daemon=True),
        ]
        for reader in self._readers:
            reader.start()
        if timeout_s is not None:
            self.await_ready(timeout_s)

    def await_ready(
        self,
        timeout_s: float = READY_TIMEOUT_S,
        stop_s: float = STOP_TIMEOUT_S,
        since: float | None = None,
        idle_s: float = IDLE_TIMEOUT_S,
    ) -> dict[str, Any]:
        """Wait for the READY line; raises PRC-001 with the last messages and ends the child within `stop_s`.

        `since` is the monotonic time from which the limit counts, for children that share one; by default
        now. A child without processor time for `idle_s` has failed.
        """
        deadline = (time.monotonic() if since is None else since) + timeout_s
        processor_use = ProcessorUse(self.process.pid)
        while True:
            try:
                line = self._lines.get(timeout=max(0.0, min(POLL_S, deadline - time.monotonic())))
            except Empty:
                is_late = time.monotonic() >= deadline
                if not is_late and processor_use.idle_s() < idle_s:
                    continue
                self.stop(stop_s)
                what = f"{self.name} did not become ready"
                raise timeout_error(what, timeout_s if is_late else None, idle_s) from None
            if line is None:
                self.process.wait()
                self._readers[1].join(timeout=1.0)
                code = self.process.returncode
                ended = [describe_exit(code)] if code < 0 or not self._messages else []
                words = " / ".join((*ended, *self._messages))
                self.stop()
                raise ChildNotReady(f"{self.name} ended before it was ready: {words}")
            if line.startswith("READY "):
                self.ready = json.loads(line.removeprefix("READY "))
                self._log.info("ready", pid=self.process.pid, ready=self.ready)
                return self.ready

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self.process.poll() is None

    @property
    def messages(self) -> tuple[str, ...]:
        """Last lines of standard error."""
        return tuple(self._messages)

    def stop(self, timeout_s: float = STOP_TIMEOUT_S) -> None:
        """End the process and its descendants: SIGTERM, then SIGKILL. Never raises; safe to call twice."""
        ended_before = not self.alive
        if not ended_before:
            self.process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout_s)
        if self.alive:
            self._log.warning("killed: SIGTERM did not end it", limit_s=timeout_s)
            offspring = descendants_of(self.process.pid)
            self.process.kill()
            self.process.wait()
            kill_all(offspring)
        for reader in self._readers:
            reader.join(timeout=1.0)
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()
        if not self._end_logged:
            self._end_logged = True
            self._log.info("ended", exit_code=self.process.returncode, by_itself=ended_before)

    def __enter__(self) -> ChildProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _read_output(self, stream: IO[str]) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in stream:
                self._lines.put(line)
        self._lines.put(None)

    def _read_messages(self, stream: IO[str]) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in stream:
                self._messages.append(line.rstrip())
                self._on_message(line.rstrip())


def run_command(
    name: str, arguments: Sequence[str], limit_s: float, meanwhile: Callable[[], object] = lambda: None
) -> subprocess.CompletedProcess[str]:
    """Run a command to completion, whatever its exit code; for `meanwhile` and PRC-001 see `await_end`."""
    with start_command(arguments) as process:
        output, messages = await_end(name, process, limit_s, meanwhile)
    return subprocess.CompletedProcess(arguments, process.returncode, output, messages)


def start_command(arguments: Sequence[str]) -> subprocess.Popen[str]:
    """Start a command that reads nothing, in a session of its own; `await_end` collects what it writes."""
    with shield_children():
        return subprocess.Popen(
            arguments,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )


def await_end(
    name: str, process: subprocess.Popen[str], limit_s: float, meanwhile: Callable[[], object] = lambda: None
) -> tuple[str, str]:
    """Wait for a command to end and return its output and messages.

    `meanwhile` is called several times a second. Kills the command and raises PRC-001 when it takes longer
    than `limit_s` or stops using the processor.
    """
    deadline_s, processor_use = time.monotonic() + limit_s, ProcessorUse(process.pid)
    try:
        while True:
            try:
                return process.communicate(timeout=OUTPUT_POLL_S)
            except subprocess.TimeoutExpired:
                meanwhile()
            is_late = time.monotonic() >= deadline_s
            if is_late or processor_use.idle_s() >= IDLE_TIMEOUT_S:
                raise timeout_error(f"{name} did not finish", limit_s if is_late else None)
    except BaseException:  # also an interruption: nothing is left running
        process.kill()
        process.wait()
        raise


class ProcessorUse:
    """Monitor for the processor time used by a process and its descendants."""

    def __init__(self, number: int) -> None:
        self._number = number  # of the process
        self._processor_time_s = 0.0
        self._changed_s = self._next_s = time.monotonic()

    def idle_s(self) -> float:
        """Return the host time in s since the process or a descendant last used the processor."""
        if (now_s := time.monotonic()) >= self._next_s:
            self._next_s = now_s + POLL_S
            if (used_s := _processor_time_s(self._number)) != self._processor_time_s:
                self._processor_time_s, self._changed_s = used_s, now_s
        return now_s - self._changed_s


def _processor_time_s(number: int) -> float:
    import psutil  # imported late: device processes import little

    used_s = 0.0
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(number)
        for member in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                used_s += sum(member.cpu_times())
    return used_s


def descendants_of(number: int) -> list[psutil.Process]:
    """List the descendants of a process; call before it ends and orphans them.

    A halted process reacts only to SIGKILL, not even to the death of its parent.
    """
    import psutil  # imported late: device processes import little

    try:
        offspring: list[psutil.Process] = psutil.Process(number).children(recursive=True)
    except psutil.Error:
        return []
    return offspring


@contextlib.contextmanager
def end_descendants(stop_s: float = STOP_TIMEOUT_S) -> Iterator[None]:
    """End what was started in the block and still runs at its end: SIGTERM, then SIGKILL after `stop_s`.

    This process adopts orphans meanwhile, so that detached processes are found too.
    """
    import psutil  # imported late: device processes import little

    set_option = ctypes.CDLL(None, use_errno=True).prctl
    before = set(descendants_of(os.getpid()))
    set_option(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        yield
    finally:
        remaining = [one for one in descendants_of(os.getpid()) if one not in before]
        for process in remaining:
            with contextlib.suppress(psutil.Error):
                process.terminate()
        kill_all(psutil.wait_procs(remaining, timeout=stop_s)[1])
        for _ in range(LAST_ROUNDS):  # what those started meanwhile; what cannot be killed ends nothing here
            if not (late := [one for one in descendants_of(os.getpid()) if one not in before]):
                break
            kill_all(late)
            psutil.wait_procs(late, timeout=stop_s)
        set_option(_PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


def kill_all(processes: list[psutil.Process]) -> None:
    """Kill processes; never raises, even if some have already ended."""
    import psutil

    for process in processes:
        with contextlib.suppress(psutil.Error):
            process.kill()
