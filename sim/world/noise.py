"""Noise as a function, not a stream: equal key and counter yield equal numbers.

Results therefore depend neither on the number of previous readings nor on the speed of the machine.
"""

from __future__ import annotations

import zlib

import numpy as np


def noise(seed: int, device: str, counter: int, lane: int = 0) -> np.random.Generator:
    """Random generator for one event of one device.

    `counter` is the device's own: frames since TSTART, triggers since AcquisitionStart, motions. `lane`
    separates independent uses within one event.
    """
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(device.encode())], dtype=np.uint64)
    # Philox: the words of the counter are free, except the lowest, which counts numbers within one event.
    start = np.array([0, lane, counter & 0xFFFFFFFFFFFFFFFF, 0], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=start))
