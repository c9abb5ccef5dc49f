"""Layout of the clock shared by several processes: the first bytes of a `shm://` block.

Times are nanoseconds of theatre time unless stated otherwise.
"""

from __future__ import annotations

from ronna_hw.host.memory_map import MemoryMap

LAYOUT_VERSION = 3

CLOCK = MemoryMap(b"RONNACLK")
VERSION = CLOCK.word("I")
PACED = CLOCK.word("I")  # 1 when theatre time follows the host's clock, 0 when devices advance it
TIME_NS = CLOCK.word("q")  # meaningful when not paced
EPOCH_NS = CLOCK.word("q")  # host monotonic time at theatre time 0, meaningful when paced
STREAM_HOST_NS = CLOCK.word("q")  # host monotonic time of the last cycle of a cyclic device, 0 if none
WANTED_NS = CLOCK.word("q")  # the latest theatre time that any process waits for
UNREAD_NS = CLOCK.word("q")  # due time of the next measurement of a tracker that is being read, 0 for none

# A cyclic device that has not run a cycle for this long no longer controls the pace of time. It waits two
# seconds for a missing reply (see the robot simulator), so the limit is above that.
STREAM_SILENCE_NS = 2_500_000_000
