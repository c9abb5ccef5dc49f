"""The simulator that a stranger's program is run against: its addresses, its faults, and waiting for it.

Python's own library alone: Aravis has bindings for the Python of the distribution only.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

from ronna_hw.control_port import ask_control_port

LIMIT_S = 10.0


def address(variable: str) -> tuple[str, int]:
    """Return host and port of an endpoint, by the name that `ronna-sim env` gives it."""
    host, _, port = os.environ[variable].rpartition("/")[2].rpartition(":")
    return host, int(port)


def inject(line: str) -> None:
    """Inject a fault into the simulator."""
    ask_control_port(os.environ["RONNA_CONTROL"], "fault", line=line)


def clear() -> None:
    """End all faults."""
    ask_control_port(os.environ["RONNA_CONTROL"], "clear_faults")


def eventually(holds: Callable[[], object], limit_s: float = LIMIT_S) -> bool:
    """Return whether a condition holds within host time."""
    until_s = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > until_s:
            return False
        time.sleep(0.005)
    return True
