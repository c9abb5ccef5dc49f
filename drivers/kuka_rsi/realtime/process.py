"""Real-time process, started by the driver: `python -P -m drivers.kuka_rsi.realtime.process`.

Standard input carries one line of settings and nothing else: when it closes, the parent is gone. Orders and
state go through the mailbox, whose descriptor is inherited. Nothing is written to standard output. Ctrl-C
never reaches it: the driver starts it in a session of its own with SIGINT blocked.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

from drivers.kuka_rsi.realtime.link_state import NO_STATE, LinkSettings, Phase
from drivers.kuka_rsi.realtime.loop import LinkLoop
from drivers.kuka_rsi.realtime.mailbox import Mailbox
from drivers.kuka_rsi.realtime.sockets import bind
from ronna_hw.host.real_time import (
    PARENT_DEATH_SIGNAL,
    lock_memory,
    make_sleep_precise,
    request_priority,
    signal_on_parent_death,
    stop_garbage_collection,
)

EXIT_NOT_STARTED = 2


def main() -> int:
    """Run the loop until the parent exits; returns 2 if the settings or the port are invalid."""
    try:
        settings = LinkSettings.from_json(sys.stdin.readline())
        mailbox = Mailbox(settings.mailbox_fd)
    except (TypeError, ValueError, OSError) as error:
        print(f"this process is started by the driver only: {error}", file=sys.stderr)  # noqa: T201
        return EXIT_NOT_STARTED
    try:
        link = bind(settings.host, settings.port)
    except OSError as error:
        mailbox.write_state(NO_STATE._replace(phase=Phase.FAILED, errno=error.errno or 0))
        os.eventfd_write(settings.event_fd, 1)
        return EXIT_NOT_STARTED
    locked = lock_memory()
    loop = LinkLoop(
        settings,
        link,
        mailbox,
        real_time=request_priority(settings.real_time_priority),
        locked=locked,
    )
    _watch_parent(loop, settings.parent_pid)
    make_sleep_precise()
    stop_garbage_collection()
    loop.run()
    loop.close()
    link.close()
    return 0


def _watch_parent(loop: LinkLoop, parent_pid: int) -> None:
    def watch_lifeline() -> None:
        while os.read(0, 1):
            pass
        loop.responder.is_parent_gone = True

    def on_parent_death(_signal: int, _frame: FrameType | None) -> None:
        # The signal also arrives when only the thread that started this process has ended.
        if os.getppid() != parent_pid:
            loop.responder.is_parent_gone = True

    def on_terminate(_signal: int, _frame: FrameType | None) -> None:
        loop.responder.is_parent_gone = True

    signal.signal(PARENT_DEATH_SIGNAL, on_parent_death)
    signal.signal(signal.SIGTERM, on_terminate)
    signal_on_parent_death()
    if os.getppid() != parent_pid:
        loop.responder.is_parent_gone = True
    threading.Thread(target=watch_lifeline, name="lifeline", daemon=True).start()


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    os._exit(code)  # nothing is left to clean up, and the parent waits for the end
