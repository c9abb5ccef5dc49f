"""Telegrams with a few bytes changed, dropped, doubled or moved: what a codec must survive."""

from __future__ import annotations

import random
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
