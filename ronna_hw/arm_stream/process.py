"""Startup and shutdown of the real-time process of a robot link.

Standard input carries one line of settings and nothing else: when it closes, the parent is gone. Orders and
state go through the mailbox, whose descriptor is inherited. Nothing is written to standard output. Ctrl-C
never reaches it: the driver starts it in a session of its own with SIGINT blocked.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from types import FrameType
from typing import Any, NoReturn, TypeVar

from ronna_hw.arm_stream.loop import StreamLoop
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.records import NO_STATE, StreamPhase, StreamSettings
from ronna_hw.arm_stream.session import StreamSession
from ronna_hw.host.real_time import (
    PARENT_DEATH_SIGNAL,
    lock_memory,
    make_sleep_precise,
    request_priority,
    signal_on_parent_death,
    stop_garbage_collection,
)

EXIT_NOT_STARTED = 2
S = TypeVar("S", bound=StreamSettings)
# The last two arguments: whether priority and locked memory are granted.
OpenLoop = Callable[[S, Mailbox, bool, bool], StreamLoop]


def run_process(settings_type: type[S], open_loop: OpenLoop[S]) -> int:
    """Run a loop until the parent exits; returns 2 if the settings are invalid or opening fails (OSError)."""
    try:
        settings = settings_type.from_json(sys.stdin.readline())
        mailbox = Mailbox(settings.mailbox_fd)
    except (TypeError, ValueError, OSError) as error:
        print(f"this process is started by the driver only: {error}", file=sys.stderr)  # noqa: T201
        return EXIT_NOT_STARTED
    locked, real_time = lock_memory(), request_priority(settings.real_time_priority)
    try:
        loop = open_loop(settings, mailbox, real_time, locked)
    except OSError as error:
        mailbox.write_state(replace(NO_STATE, phase=StreamPhase.FAILED, errno=error.errno or 0))
        os.eventfd_write(settings.event_fd, 1)
        return EXIT_NOT_STARTED
    _watch_parent(loop.session, settings.parent_pid)
    make_sleep_precise()
    stop_garbage_collection()
    loop.run()
    loop.close()
    return 0


def leave(code: int) -> NoReturn:
    """End the process at once: nothing is left to clean up, and the parent waits for the end."""
    sys.stderr.flush()
    os._exit(code)


def _watch_parent(session: StreamSession[Any, Any], parent_pid: int) -> None:
    def watch_lifeline() -> None:
        while os.read(0, 1):
            pass
        session.is_parent_gone = True

    def on_parent_death(_signal: int, _frame: FrameType | None) -> None:
        # The signal also arrives when only the thread that started this process has ended.
        if os.getppid() != parent_pid:
            session.is_parent_gone = True

    def on_terminate(_signal: int, _frame: FrameType | None) -> None:
        session.is_parent_gone = True

    signal.signal(PARENT_DEATH_SIGNAL, on_parent_death)
    signal.signal(signal.SIGTERM, on_terminate)
    signal_on_parent_death()
    if os.getppid() != parent_pid:
        session.is_parent_gone = True
    threading.Thread(target=watch_lifeline, name="lifeline", daemon=True).start()
