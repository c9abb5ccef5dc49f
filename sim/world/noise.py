"""Noise as a function rather than a stream: the same keys and counters yield the same numbers.

Results therefore depend neither on the number of previous readings nor on the speed of the machine.
"""

from __future__ import annotations

import zlib

import numpy as np

WORD_MASK = 0xFFFFFFFFFFFFFFFF
TABLE_SIZE = 4099  # a prime: the values of a cycle do not repeat soon


def noise(seed: int, device: str, counter: int, lane: int = 0) -> np.random.Generator:
    """Return a random generator for one event of one device.

    `counter` is the device's own: frames since TSTART, triggers since AcquisitionStart, motions. `lane`
    separates independent uses within one event.
    """
    key = np.array(_philox_key(seed, device), dtype=np.uint64)
    # Philox: the words of the counter are free, except the lowest, which counts numbers within one event.
    start = np.array([0, lane, counter & WORD_MASK, 0], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=start))


class ReusedNoise:
    """Cheaper form of `noise` for one device, reusing a generator at a tenth of the cost.

    A new generator first draws a random seed that it then does not use.
    """

    def __init__(self, seed: int, device: str) -> None:
        self._philox = np.random.Philox(0)
        self._generator = np.random.Generator(self._philox)
        self._key = np.array(_philox_key(seed, device), dtype=np.uint64)
        self._start = np.zeros(4, dtype=np.uint64)
        self._no_buffer = np.zeros(4, dtype=np.uint64)

    def at(self, counter: int, lane: int = 0) -> np.random.Generator:
        """Return the random generator for one event, valid until the next call."""
        self._start[1:3] = lane, counter & WORD_MASK
        self._philox.state = {
            "bit_generator": "Philox",
            "state": {"counter": self._start, "key": self._key},
            "buffer": self._no_buffer,
            "buffer_pos": len(self._no_buffer),  # nothing is left of it
            "has_uint32": 0,
            "uinteger": 0,
        }
        return self._generator


class TabledNoise:
    """Cheapest form, for a few values in every cycle of a controller: normal noise from a table."""

    def __init__(self, seed: int, device: str) -> None:
        table = [float(value) for value in noise(seed, device, 0).standard_normal(TABLE_SIZE)]
        self._table = table + table

    def at(self, counter: int, count: int) -> list[float]:
        """Return the values (count,) of a cycle, of standard deviation 1."""
        begin = counter * count % TABLE_SIZE
        return self._table[begin : begin + count]


def _philox_key(seed: int, device: str) -> tuple[int, int]:
    return seed & WORD_MASK, zlib.crc32(device.encode())
