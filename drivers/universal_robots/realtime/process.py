"""Real-time process, started by the driver: `python -P -m drivers.universal_robots.realtime.process`."""

from __future__ import annotations

import socket

from drivers.universal_robots.realtime.loop import LinkLoop
from drivers.universal_robots.realtime.settings import LinkSettings
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.process import leave, run_process


def open_loop(settings: LinkSettings, mailbox: Mailbox, real_time: bool, locked: bool) -> LinkLoop:
    """Take connections from the driver; raises OSError."""
    channel = socket.socket(fileno=settings.handover_fd)
    return LinkLoop(settings, channel, mailbox, real_time=real_time, locked=locked)


if __name__ == "__main__":
    leave(run_process(LinkSettings, open_loop))
