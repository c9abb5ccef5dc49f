"""Cycles of an arm's stream as arrays, copied from the flight recorder in shared memory.

The real-time process goes on writing meanwhile. Rows that it may have touched during the copy are left out.
"""

from __future__ import annotations

import numpy as np

from ronna_hw.arm_stream.mailbox import RECORDER_CYCLES, RECORDER_ROW_BYTES, Mailbox
from ronna_hw.arm_stream.records import AXES
from ronna_hw.devices.capabilities import StreamCycles

ROWS = np.dtype(  # of RecordedCycle
    {
        "names": ("cycle", "device_clock", "received_ns", "turnaround_us", "measured_rad", "sent_rad"),
        "formats": ("<u8", "<u8", "<i8", "<f8", (f"({AXES},)<f8"), (f"({AXES},)<f8")),
        "offsets": (0, 8, 16, 24, 32, 32 + 8 * AXES),
        "itemsize": RECORDER_ROW_BYTES,
    }
)


def read_cycles(mailbox: Mailbox, after_ns: int) -> StreamCycles:
    """Return the recorded cycles whose telegram came after a host monotonic time, oldest first."""
    whole_to = mailbox.read_state().cycles  # complete when the copy begins
    rows = np.frombuffer(mailbox.copy_recorder(), ROWS)
    overwritten_to = mailbox.read_state().cycles + 1 - RECORDER_CYCLES  # also the one that is being written
    cycle = rows["cycle"].astype(np.int64)
    rows = rows[(cycle > overwritten_to) & (cycle <= whole_to) & (rows["received_ns"] > after_ns)]
    rows = rows[np.argsort(rows["received_ns"])]
    return StreamCycles(rows["received_ns"], rows["device_clock"], rows["measured_rad"], rows["sent_rad"])
