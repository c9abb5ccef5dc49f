"""Settings of the real-time process."""

from __future__ import annotations

from dataclasses import dataclass

from ronna_hw.arm_stream.records import StreamSettings

AXIS_NAMES = ("A1", "A2", "A3", "A4", "A5", "A6")


@dataclass(frozen=True, kw_only=True)
class LinkSettings(StreamSettings):
    """Settings of the RSI link, passed as one line of JSON on standard input."""

    host: str
    port: int
    variant: str
    cycle_ms: int
    sentype: str
    send_tags: tuple[str, ...]
    receive_tags: tuple[str, ...]
    axis_tags: tuple[str, ...]  # which received tags feed AXISCORR A1..A6
    stop_tag: str  # which one feeds STOP
    controller_host: str = ""  # only telegrams from this host open a stream; "" for any
