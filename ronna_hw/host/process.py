"""The current process: start, parent, threads, and termination signals.

Import it before anything heavy: an import may outlast the parent, whose number is noted here.

Ctrl-C on a terminal reaches the whole foreground group. The program handles it alone: the processes that it
starts never see it.

Linear algebra runs on one thread. Its rounding depends on how many threads share a product, and a fit turns a
difference in the last digit into a micrometre: with one thread, a seed gives the same result on any computer.
"""

from __future__ import annotations

import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NamedTuple


def suspend_garbage_collection() -> None:
    """Suspend garbage collection until `resume_garbage_collection`.

    Nearly all that a starting process allocates stays, and collecting would take a fifth of the start.
    """
    gc.disable()


def resume_garbage_collection() -> None:
    """Exempt all existing objects from later collections and resume garbage collection, if suspended."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


INIT = 1


class ParentProcess(NamedTuple):
    """Parent process at the start of this process."""

    pid: int
    gone_at_start: bool = False

    @property
    def is_gone(self) -> bool:
        """Whether the parent has died, possibly before it was recorded; init adopts orphans."""
        return self.gone_at_start or os.getppid() != self.pid


def note_parent() -> ParentProcess:
    """Record the current parent.

    A service started by init leads its own process group or belongs to that of init. A child of init in any
    other group is an orphan whose parent died before this call.
    """
    pid = os.getppid()
    is_orphan = pid == INIT and os.getpgrp() not in (os.getpid(), os.getpgid(INIT))
    return ParentProcess(pid, gone_at_start=is_orphan)


class Parent:
    """Parent of this process."""

    noted = note_parent()  # a fork notes its own


# read by OpenBLAS, OpenMP and MKL when they are loaded
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def limit_to_one_thread() -> None:
    """Limit this process and its children to one thread. Call before NumPy is imported."""
    os.environ.update(dict.fromkeys(_THREADS, "1"))


@contextmanager
def limit_children_to_one_thread() -> Iterator[None]:
    """Limit processes started in the block to one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    limit_to_one_thread()
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # Ctrl-C, an order, a closed terminal


@contextmanager
def defer_interruption() -> Iterator[None]:
    """Defer termination signals to the end of the block, whose work must be bounded in time.

    Python delivers signals to the main thread only; in any other thread nothing is deferred.
    """
    received: list[signal.Signals] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(signal.Signals(number))

    with _handle_signals(note):
        yield
    for number in dict.fromkeys(received):
        signal.raise_signal(number)


@contextmanager
def allow_interruption() -> Iterator[None]:
    """Make termination signals raise KeyboardInterrupt in the block, even if ignored outside it."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handle_signals(interrupt):
        yield


@contextmanager
def _handle_signals(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Route termination signals to `handler` within the block; other threads than the main one get none."""
    is_main = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, handler) for number in ENDING_SIGNALS if is_main}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


@contextmanager
def shield_children() -> Iterator[None]:
    """Block SIGINT in processes started within the block, through signal-mask inheritance.

    Their own session, which hides the other signals of the terminal, begins only after the fork.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def describe_exit(code: int) -> str:
    """Describe how a process ended: the signal that killed it, or its exit code."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:  # a real-time signal
        return f"killed by signal {-code}"
