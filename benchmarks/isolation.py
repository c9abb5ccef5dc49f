"""Isolated execution of a measurement in its own session, ending with all its child processes.

What a measurement starts may have sessions of its own, and foreign programs do not end with their parent. So
this process adopts the orphans among its descendants, as init would, and ends them too.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import psutil

from ronna_hw.host.process import Parent

STOP_S = 10.0  # after SIGTERM a measurement ends what it started, and removes its files
LINGER_S = 5.0  # what watches its parent ends a little later than that
POLL_S = 0.02
PREFIX = "ronna-bench-"  # of the folder for the files of a measurement
WORDS_KEPT = 60  # of the messages of a measurement that failed
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # linux/prctl.h


def run_alone(line: Sequence[str], limit_s: float, *, linger_s: float = LINGER_S) -> str:
    """Run a command to completion and return its output. No process it started outlives this call.

    Raises RuntimeError when it fails, takes longer than the limit, or left a process running. Ends all
    descendants of this process: it must have no other children.
    """
    _adopt_orphans()
    with TemporaryDirectory(prefix=PREFIX, ignore_cleanup_errors=True) as place:
        output, messages = Path(place) / "output", Path(place) / "messages"
        with output.open("wb") as out, messages.open("wb") as err:  # a pipe stays open as long as a child
            process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
                env=os.environ | {"TMPDIR": place},
            )
        try:
            process.wait(limit_s)
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"not finished within {limit_s:g} s") from None
        finally:
            _stop(process)
            left = _end_descendants(linger_s)
        if process.returncode:
            words = messages.read_text(encoding="utf-8", errors="replace").split()
            raise RuntimeError(" ".join(words[-WORDS_KEPT:]) or f"exit code {process.returncode}")
        if left:
            raise RuntimeError(f"left running: {'; '.join(left)}")
        return output.read_text(encoding="utf-8")


@contextlib.contextmanager
def end_with_runner() -> Iterator[None]:
    """Interrupt the measurement in this block if its runner is killed, and remove the folder of its files."""
    _control_process(_PR_SET_PDEATHSIG, signal.SIGTERM)
    try:
        if Parent.noted.is_gone:
            raise KeyboardInterrupt
        yield
    finally:
        place = Path(os.environ.get("TMPDIR", ""))
        if Parent.noted.is_gone and place.name.startswith(PREFIX):
            shutil.rmtree(place, ignore_errors=True)


def _adopt_orphans() -> None:
    _control_process(_PR_SET_CHILD_SUBREAPER, 1)


def _control_process(option: int, value: int) -> None:
    if ctypes.CDLL(None, use_errno=True).prctl(option, value, 0, 0, 0):
        raise OSError(ctypes.get_errno(), f"prctl {option} is refused")


def _stop(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(STOP_S)
    if process.poll() is None:
        process.kill()
        process.wait()


def _end_descendants(linger_s: float) -> list[str]:
    """Wait for all descendants, kill any that remain, and return their command lines."""
    stayed = _await_descendants(linger_s)
    lines = [_command_line(one) for one in stayed]
    for number in (signal.SIGTERM, signal.SIGKILL):
        for one in stayed:
            with contextlib.suppress(psutil.Error):
                one.send_signal(number)
        stayed = _await_descendants(linger_s)
    return lines


def _await_descendants(limit_s: float) -> list[psutil.Process]:
    """Reap descendants until all have ended or the limit has passed. Return those still running."""
    deadline_s = time.monotonic() + limit_s
    while True:
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        left: list[psutil.Process] = psutil.Process().children(recursive=True)
        if not left or time.monotonic() >= deadline_s:
            return left
        time.sleep(POLL_S)


def _command_line(process: psutil.Process) -> str:
    with contextlib.suppress(psutil.Error):
        return " ".join(process.cmdline()) or str(process.name())
    return str(process.pid)
