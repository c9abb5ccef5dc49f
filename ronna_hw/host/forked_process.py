"""Forks of this process, which inherit its imports: a module as a program, or work beside its own.

Fork before any thread is started: the fork has only the thread that forked, and whatever lock another one
held stays locked there.
"""

from __future__ import annotations

import contextlib
import os
import runpy
import select
import signal
import subprocess
import sys
import threading
import traceback
import weakref
from collections.abc import Callable, Sequence
from functools import partial
from typing import NoReturn

from ronna_hw.host.child_process import command
from ronna_hw.host.process import ENDING_SIGNALS, Parent, ParentProcess, resume_garbage_collection
from ronna_hw.host.shown_command_line import show_command_line

FIRST_OTHER_DESCRIPTOR = 3  # after the standard streams
FAILED = 1


def fork_worker(work: Callable[[], None]) -> int:
    """Fork a process that does this work and ends with it; return its number.

    Ctrl-C on a terminal reaches both: the parent ends the worker. Work that writes to a pipe of the parent's
    ends with it, by BrokenPipeError.
    """
    process_id = os.fork()
    if process_id:
        return process_id
    status = FAILED
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        resume_garbage_collection()
        with contextlib.suppress(EOFError, OSError):  # the parent has closed its end, or has ended
            work()
        status = 0
    except Exception:  # the last frame of the process: nobody above would print it
        traceback.print_exc()
    finally:
        os._exit(status)


class ForkedProcess:
    """Child forked from this process, with the part of `subprocess.Popen` that `ChildProcess` uses."""

    def __init__(self, module: str, *arguments: str) -> None:
        """Fork and run a module, as `command` does, in its own session with piped output."""
        self.args: Sequence[str] = command(module, *arguments)
        self.returncode: int | None = None
        self._reaping = threading.Lock()
        parent = os.getpid()
        output, own_output = os.pipe()
        messages, own_messages = os.pipe()
        sys.stdout.flush()
        sys.stderr.flush()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING_SIGNALS)
        try:
            self.pid = os.fork()
            if not self.pid:
                _run(self.args, module, partial(_leave_parent, parent, own_output, own_messages, before))
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            for descriptor in (own_output, own_messages):
                os.close(descriptor)
        self.stdout, self.stderr = os.fdopen(output), os.fdopen(messages)
        self._end = os.pidfd_open(self.pid)
        weakref.finalize(self, os.close, self._end)

    def poll(self) -> int | None:
        """Return the exit code; None while the process runs."""
        with self._reaping:
            if self.returncode is None:
                ended, status = os.waitpid(self.pid, os.WNOHANG)
                if ended:
                    self.returncode = os.waitstatus_to_exitcode(status)
            return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the exit code; raises subprocess.TimeoutExpired."""
        ready, _, _ = select.select([self._end], [], [], timeout)
        code = self.poll()
        if not ready or code is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return code

    def terminate(self) -> None:
        """Send SIGTERM, if the process has not ended."""
        self._signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL, if the process has not ended."""
        self._signal(signal.SIGKILL)

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):  # ended, and reaped by another thread
            signal.pidfd_send_signal(self._end, number)


def _run(line: Sequence[str], module: str, prepare: Callable[[], None]) -> NoReturn:
    """Run a module, then exit without the parent's cleanup."""
    status = FAILED
    try:
        prepare()
        with contextlib.suppress(OSError, AttributeError, ValueError):  # it is only for people's eyes
            show_command_line(line)
        sys.argv = [module, *line[line.index(module) + 1 :]]
        runpy.run_module(module, run_name="__main__", alter_sys=True)
        status = 0
    except SystemExit as ended:
        status = _exit_code(ended.code)
    except Exception:  # the last frame of the process: nobody above would print it
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError):  # there may be no reader left
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(status)


def _exit_code(code: object) -> int:
    """Return the exit code for the argument of `sys.exit`, whose text is printed."""
    if code is None or isinstance(code, int):
        return int(code or 0)
    sys.stderr.write(f"{code}\n")
    return FAILED


def _leave_parent(parent: int, output: int, messages: int, signals: set[int | signal.Signals]) -> None:
    """Leave the parent's session, streams, files and signal handlers, as a new program would."""
    Parent.noted = ParentProcess(parent)
    os.setsid()
    for number in ENDING_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # by nohup
            signal.signal(number, signal.SIG_DFL)
    null = os.open(os.devnull, os.O_RDONLY)
    for standard, own in enumerate((null, output, messages)):
        os.dup2(own, standard)
    opened = max(map(int, os.listdir("/proc/self/fd")))
    os.closerange(FIRST_OTHER_DESCRIPTOR, opened + 1)  # such as the lock of a folder
    signal.pthread_sigmask(signal.SIG_SETMASK, signals)
