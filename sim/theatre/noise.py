"""Noise as a function, not as a stream: the same key and counter always give the same numbers.

So a result does not depend on how many readings were taken before it, nor on the speed of the machine.
"""

from __future__ import annotations

import zlib

import numpy as np


def noise(seed: int, device: str, counter: int, lane: int = 0) -> np.random.Generator:
    """Generator for one event of one device.

    `counter` is what the device counts: frames since TSTART, triggers since AcquisitionStart, motions.
    `lane` separates independent uses within one event.
    """
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(device.encode())], dtype=np.uint64)
    # Philox: words of the counter are free; the lowest is left for the numbers drawn within one event.
    start = np.array([0, lane, counter & 0xFFFFFFFFFFFFFFFF, 0], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=start))
