"""While a process starts, nearly all it allocates stays: garbage collection costs a fifth of the start."""

from __future__ import annotations

import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from types import FrameType

from ronna_hw.errors import ConfigurationError


def begin_start() -> None:
    """Suspend garbage collection until `end_start`."""
    gc.disable()


def end_start() -> None:
    """Whatever exists now stays to the end: exclude it from all collections, in a cycle or at exit."""
    gc.freeze()
    gc.enable()


INIT = 1


@dataclass(frozen=True)
class ParentProcess:
    """The parent at the start of this process."""

    pid: int
    gone_at_start: bool = False

    @property
    def gone(self) -> bool:
        """Whether the parent has died, even before it could be noted."""
        return self.gone_at_start or os.getppid() != self.pid


def note_parent() -> ParentProcess:
    """Note the current parent.

    A service started by init leads its own process group or belongs to init's. A child of init in any other
    group is an orphan whose parent died before this call.
    """
    pid = os.getppid()
    orphan = pid == INIT and os.getpgrp() not in (os.getpid(), os.getpgid(INIT))
    return ParentProcess(pid, gone_at_start=orphan)


PARENT = note_parent()


OWN_PACKAGES = ("conformance", "drivers", "sim", "procedures", "studies")


class ForeignPackage(ConfigurationError):
    """One of our packages is shadowed by another of the same name on the path."""

    code = "CFG-003"
    action = "Use a separate virtual environment, and do not run from a folder that contains such a package."


def foreign_packages() -> tuple[str, ...]:
    """Those of our package names that Python would not load from the folder of `ronna_hw`."""
    home = Path(__file__).resolve().parents[2]
    foreign = []
    for name in OWN_PACKAGES:
        spec = find_spec(name)
        places = (
            [] if spec is None else [Path(place).resolve() for place in spec.submodule_search_locations or ()]
        )
        if places != [home / name]:
            foreign.append(name)
    return tuple(foreign)


def require_own_packages() -> None:
    """Raise CFG-003 when one of our names would load a foreign package."""
    foreign = foreign_packages()
    if foreign:
        raise ForeignPackage(f"another package on the path is named {' and '.join(foreign)}")


# read by OpenBLAS, OpenMP and MKL when they are loaded
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def single_threaded() -> None:
    """Keep this process and those that it starts to one thread. Call before NumPy is imported."""
    os.environ.update(dict.fromkeys(_THREADS, "1"))


@contextmanager
def processes_single_threaded() -> Iterator[None]:
    """Keep the processes started in the block to one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    single_threaded()
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
def interruption_deferred() -> Iterator[None]:
    """Hold back the signals that end a program until the block is left; for work bounded in time.

    Python delivers signals to the main thread only; in any other thread there is nothing to hold back.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[signal.Signals] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(signal.Signals(number))

    with _handled_by(note):
        yield
    for number in dict.fromkeys(received):
        signal.raise_signal(number)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let these signals end the block by KeyboardInterrupt, even if they are ignored around it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextmanager
def children_uninterrupted() -> Iterator[None]:
    """Start processes that never receive SIGINT, from their first moment on: they inherit it blocked.

    A session of their own, which hides the terminal's other signals, begins only after the fork.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def describe_exit(code: int) -> str:
    """How a process ended: the name of the signal that killed it, or its exit code."""
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:  # a real-time signal
        return f"killed by signal {-code}"


@contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """In the block, those signals go to `handler`; for the main thread."""
    before = {number: signal.signal(number, handler) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)
