"""Mutants of good input that also repeat a part many times, or have numbers without sense."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

from mutations import mutations

_DIGITS = re.compile(rb"-?\d+(?:\.\d+)?")
_DECLARATIONS = [b'<?xml version="1.0" encoding="%b"?>' % name for name in (b"foo", b"hex", b"utf-7")]
_ODD = (
    b"-1",
    b"0",
    b"1e308",
    b"-1e-300",
    b"1e400",
    b"9" * 400,
    b"65536",
    b"4294967296",
    b"0x" + b"F" * 40,
    b"nan",
)


def mutants(good: tuple[bytes, ...], count: int, seed: int) -> Iterator[bytes]:
    """As `mutations`; one in eight then has a part of it many times, some have numbers without sense, or
    a declaration of an encoding before them.
    """
    chosen = random.Random(seed)
    for data in mutations(good, count, seed):
        if chosen.random() < 0.125 and data:
            begin = chosen.randrange(len(data))
            part = data[begin : begin + chosen.randint(1, 40)]
            data = data[:begin] + part * chosen.choice((2, 10, 100, 3000)) + data[begin:]
        if chosen.random() < 0.125:
            data = _DIGITS.sub(lambda found: found[0] if chosen.random() < 0.8 else chosen.choice(_ODD), data)
        if chosen.random() < 0.0625:
            data = chosen.choice(_DECLARATIONS) + data
        yield data
