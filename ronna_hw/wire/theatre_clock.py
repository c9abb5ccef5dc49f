"""Layout of the clock that several processes share: the first bytes of a `shm://` block.

All values little endian. Times are nanoseconds of theatre time unless said otherwise.
"""

from __future__ import annotations

MAGIC = b"RONNACLK"
VERSION = 1

MAGIC_OFFSET = 0  # 8 bytes
VERSION_OFFSET = 8  # u32
PACED_OFFSET = 12  # u32: 1 when theatre time follows the host's clock, 0 when devices advance it
TIME_NS_OFFSET = 16  # i64, meaningful when not paced
EPOCH_NS_OFFSET = 24  # i64: host monotonic time at theatre time 0, meaningful when paced
STREAM_HOST_NS_OFFSET = 32  # i64: host monotonic time of the last cycle of a cyclic device, 0 when none
WANTED_NS_OFFSET = 40  # i64: the furthest theatre time that anybody waits for
CLOCK_BYTES = 64

# A cyclic device that has not run a cycle for this long no longer owns the pace of time: it waits two
# seconds for a missing reply (see the robot simulator), so the limit is above that.
STREAM_SILENCE_NS = 2_500_000_000
