"""Telegrams with a few bytes changed, dropped, doubled or moved: what a codec must survive."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Sequence

SPICES = (
    b"<",
    b">",
    b"/",
    b'"',
    b"\0",
    b"&",
    b"&#0;",
    b"<!--",
    b"]]>",
    b"nan",
    b"1e999",
    b"-",
    b"\xff",
    b"<IPOC>",
)

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


def mutations(originals: Sequence[bytes], count: int, seed: int) -> Iterator[bytes]:
    """`count` mutants of the originals; the same for a seed."""
    generator = random.Random(seed)
    draw = generator.random
    for number in range(count):
        data = originals[number % len(originals)]
        for _ in range(1 + int(draw() * 4)):
            size = len(data)
            place = int(draw() * (size + 1))
            kind = int(draw() * 8)
            if kind == 0:
                data = data[:place] + bytes((int(draw() * 256),)) + data[place + 1 :]
            elif kind == 1:
                data = data[:place] + data[place + 1 :]
            elif kind == 2:
                data = data[:place] + bytes((int(draw() * 256),)) + data[place:]
            elif kind == 3:
                data = data[:place] + SPICES[int(draw() * len(SPICES))] + data[place:]
            elif kind == 4:
                data = data[:place]
            elif kind == 5:
                end = place + int(draw() * 20)
                data = data[:end] + data[place:]
            elif kind == 6:
                end = place + int(draw() * 20)
                data = data[:place] + data[end:]
            elif place < size:
                data = data[:place] + bytes((data[place] ^ 1 << int(draw() * 8),)) + data[place + 1 :]
        yield data


def mutants(good: tuple[bytes, ...], count: int, seed: int) -> Iterator[bytes]:
    """Mutate as `mutations`; some then repeat a part many times, or have senseless numbers or an encoding."""
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
