"""Name and load of this computer's processor, which every time measured on it depends on."""

from __future__ import annotations

import os
import platform
from pathlib import Path

from ronna_hw.text import format_count

CPU_INFO = Path("/proc/cpuinfo")  # Linux only


def name_processor() -> str:
    """Return the model of the processor, or its architecture where the system does not name it."""
    try:
        lines = CPU_INFO.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.machine()


def describe_load() -> str:
    """Describe the load of the last minute, or return '' unless it exceeds the number of processors."""
    processors, running = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    if running <= processors:
        return ""
    return f"a load of {running:.1f} on {format_count(processors, 'processor')}"
