"""Keeps freed memory in the process, so that the next image reuses it.

An image needs several arrays of a few megabytes. The C library returns such memory to the kernel when freed,
and the kernel clears it page by page on the next request. Whatever can be drawn a few rows at a time is
(`row_bands`); this is for the rest: strong defocus, faults on the lens, the images themselves.
"""

from __future__ import annotations

import ctypes

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX = -1, -3, -8  # from malloc.h of the GNU C library
KEPT_BYTES = 256 << 20
LARGEST_KEPT_BYTES = 32 << 20  # the largest value the library accepts


def keep_freed_memory() -> bool:
    """Set the allocator of this process; False if the C library has no such settings."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    settings = (
        (M_MMAP_THRESHOLD, LARGEST_KEPT_BYTES),
        (M_TRIM_THRESHOLD, KEPT_BYTES),
        (M_ARENA_MAX, 1),  # threads share one arena
    )
    return all([mallopt(name, value) == 1 for name, value in settings])
