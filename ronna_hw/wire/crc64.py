"""CRC-64 of OpenIGTLink: ECMA-182, not reflected, from zero, without a final XOR.

Short data go byte by byte through a table. Long data are cut into lanes that NumPy advances together; the
remainders of the lanes are then joined in pairs, as the remainder is linear in GF(2). Zeros ahead of the data
do not change it, so the first lane is filled up with them.
"""

from __future__ import annotations

from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

POLYNOMIAL: Final = 0x42F0E1EBA9EA3693
_MASK: Final = 0xFFFF_FFFF_FFFF_FFFF
LANE_BYTES: Final = 512
SHORT_BYTES: Final = 16_384  # up to here the table is faster
Words = NDArray[np.uint64]


def _table() -> tuple[int, ...]:
    remainders = []
    for byte in range(256):
        value = byte << 56
        for _ in range(8):
            value = ((value << 1) & _MASK) ^ (POLYNOMIAL if value >> 63 else 0)
        remainders.append(value)
    return tuple(remainders)


_TABLE: Final = _table()
_WORDS: Final = np.array(_TABLE, dtype=np.uint64)
_BITS: Final = np.arange(64, dtype=np.uint64)


def crc64(data: bytes | bytearray | memoryview) -> int:
    """Return the CRC-64 of these bytes."""
    return _by_table(data) if len(data) <= SHORT_BYTES else _by_lanes(data)


def _by_table(data: bytes | bytearray | memoryview) -> int:
    value, table = 0, _TABLE
    for byte in data:
        value = ((value << 8) & _MASK) ^ table[(value >> 56) ^ byte]
    return value


def _by_lanes(data: bytes | bytearray | memoryview) -> int:
    lanes = 1 << (-(-len(data) // LANE_BYTES) - 1).bit_length()
    filled = np.zeros(lanes * LANE_BYTES, dtype=np.uint8)
    filled[filled.size - len(data) :] = np.frombuffer(data, dtype=np.uint8)
    columns = np.ascontiguousarray(filled.reshape(lanes, LANE_BYTES).T)
    values = np.zeros(lanes, dtype=np.uint64)
    for column in columns:
        values = (values << np.uint64(8)) ^ _WORDS[(values >> np.uint64(56)) ^ column]
    joined = 0
    while values.size > 1:
        values = _apply(_shift(joined), values[::2]) ^ values[1::2]
        joined += 1
    return int(values[0])


def _apply(images: Words, values: Words) -> Words:
    """Apply a linear map, given by the images of the 64 bits, to each value."""
    chosen = np.where((values[:, None] >> _BITS) & np.uint64(1), images, np.uint64(0))
    mapped: Words = np.bitwise_xor.reduce(chosen, axis=1)
    return mapped


@cache
def _shift(joined: int) -> Words:
    """Return the images of the 64 bits under LANE_BYTES * 2**joined bytes of zeros behind them."""
    if joined:
        return _apply(_shift(joined - 1), _shift(joined - 1))
    values = np.uint64(1) << _BITS
    for _ in range(LANE_BYTES):
        values = (values << np.uint64(8)) ^ _WORDS[values >> np.uint64(56)]
    return values
