"""Settings of the real-time process: plain values, passed as JSON on its standard input."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

AXIS_NAMES = ("A1", "A2", "A3", "A4", "A5", "A6")


@dataclass(frozen=True)
class LinkSettings:
    """One line of JSON. Tags come from the context description; the process itself reads no files."""

    host: str
    port: int
    parent_pid: int
    mailbox_fd: int
    event_fd: int
    variant: str
    cycle_ms: int
    sentype: str
    send_tags: tuple[str, ...]
    receive_tags: tuple[str, ...]
    axis_tags: tuple[str, ...]  # which received tags feed AXISCORR A1..A6
    stop_tag: str  # which one feeds STOP
    silence_limit_s: float
    heartbeat_limit_s: float
    settle_tolerance_deg: float
    real_time_priority: int
    rehearsal_lead_us: int = 0  # how long before its telegram is due the reply is rehearsed; 0 is never
    controller_host: str = ""  # only telegrams from this host open a stream; "" for any
    keeps_bytes: bool = False  # telegrams and replies are kept for the driver to fetch

    def to_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> LinkSettings:
        """The inverse; raises TypeError or ValueError if the line is not from `to_json`."""
        values = json.loads(line)
        for name in ("send_tags", "receive_tags", "axis_tags"):
            values[name] = tuple(values[name])
        return cls(**values)
