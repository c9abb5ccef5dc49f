"""Real-time process, started by the driver: `python -P -m drivers.kuka_rsi.realtime.process`."""

from __future__ import annotations

from drivers.kuka_rsi.realtime.loop import LinkLoop
from drivers.kuka_rsi.realtime.settings import LinkSettings
from drivers.kuka_rsi.realtime.sockets import bind
from ronna_hw.arm_stream.mailbox import Mailbox
from ronna_hw.arm_stream.process import leave, run_process


def open_loop(settings: LinkSettings, mailbox: Mailbox, real_time: bool, locked: bool) -> LinkLoop:
    """Listen on the stream's port; raises OSError."""
    link = bind(settings.host, settings.port)
    return LinkLoop(settings, link, mailbox, real_time=real_time, locked=locked)


if __name__ == "__main__":
    leave(run_process(LinkSettings, open_loop))
