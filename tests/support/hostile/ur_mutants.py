"""Bytes that no decent client sends to a Universal Robots controller: mutants of decent ones."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from random import Random

from ur_clients import INPUTS, OUTPUTS, package, script

EXTREMES = (
    b"\0" * 8,
    b"\xff" * 8,
    b"\x7f\xf8" + b"\0" * 6,
    b"\x7f\xf0" + b"\0" * 6,
    b"\x7f\xef" + b"\xff" * 6,
)
REGISTERS = "input_int_register_0,input_int_register_1," + ",".join(
    f"input_double_register_{number}" for number in range(13)
)


def _registers(command: int, value: float) -> bytes:
    return package("U", struct.pack(">B2i13d", 1, command, 0, *(value,) * 13))


RTDE = (
    package("V", b"\0\2"),
    package("v"),
    package("O", struct.pack(">d", 125.0) + OUTPUTS.encode()),
    package("I", INPUTS.encode()),
    package("I", REGISTERS.encode()),
    package("S"),
    package("U", struct.pack(">B3i6d", 1, 1, 0, 7, *(0.1,) * 6)),
    package(
        "I", b"speed_slider_mask,speed_slider_fraction,standard_analog_output_mask,standard_analog_output_0"
    ),
    package("M", b"\1a\1b\3"),
    package("P"),
)
VALUES = (0.1, -2.0, math.nan, math.inf, -1e308, 5e-324)
COMMANDS = tuple(_registers(command, value) for command in (*range(72), 99, 255) for value in VALUES)
SET_POINTS = tuple(
    package("U", struct.pack(">B3i6d", 1, number, 0, 7, *(value,) * 6))
    for number in (0, 1, 2, -(2**31))
    for value in (-1.5, *VALUES)
)
LINES = (
    *(
        f"{line}\n".encode()
        for line in ("robotmode", "power on", "brake release", "load wait_program.urp", "play")
    ),
    *(
        f"{line}\n".encode()
        for line in ("popup a text", "programState", "unlock protective stop", "stop", "quit")
    ),
)
SCRIPTS = (
    script().encode(),
    b"def plain():\n  set_digital_out(3, True)\n  movej([0.1, -1.5, -1.5, 0, 0, 0], a=5.0, v=1.0)\nend\n",
    b"movel(p[0.3, 0.2, 0.3, 0, 3.1, 0], a=1.2, v=0.25)\n",
    b"sec outputs():\n  set_tcp(p[0, 0, 0.1, 0, 0, 0])\n  set_payload(1.5, [0, 0, 0.1])\nend\n",
    b"def loop():\n  # RTDE Control Script Loaded\n  global reg_offset_int = 0\nend\n",
    b"stop program\n",
    b'rtde_set_watchdog("input_int_register_0", 10, "stop")\n',
)
NUMBERS = (b"1e999", b"-1", b"1.2.3", b"99999999999", b"nan", b".", b"-", b"1e-320", b"[", b")", b"0")


def mutants(seeds: tuple[bytes, ...], count: int, seed: int) -> Iterator[bytes]:
    """Yield that many streams of up to five packages, each changed once or twice."""
    random = Random(seed)
    for _ in range(count):
        stream = b"".join(random.choice(seeds) for _ in range(random.choice((1, 1, 2, 5))))
        for _ in range(random.randint(0, 2)):
            stream = random.choice(CHANGES)(stream, random)
        yield stream


def _flip(stream: bytes, random: Random) -> bytes:
    place = random.randrange(len(stream))
    return stream[:place] + bytes([random.randrange(256)]) + stream[place + 1 :]


def _cut(stream: bytes, random: Random) -> bytes:
    return stream[: random.randrange(1, len(stream) + 1)]


def _leave_out(stream: bytes, random: Random) -> bytes:
    place = random.randrange(len(stream))
    return stream[:place] + stream[place + random.randint(1, 8) :] or b"\0"


def _repeat(stream: bytes, random: Random) -> bytes:
    place = random.randrange(len(stream))
    return stream[:place] + stream[place : place + 16] * random.randint(2, 50) + stream[place:]


def _put_extreme(stream: bytes, random: Random) -> bytes:
    place = random.randrange(len(stream))
    extreme = random.choice(EXTREMES)
    return stream[:place] + extreme + stream[place + len(extreme) :]


def _put_number(stream: bytes, random: Random) -> bytes:
    digits = [place for place, byte in enumerate(stream) if byte in b"0123456789"]
    place = random.choice(digits) if digits else random.randrange(len(stream))
    return stream[:place] + random.choice(NUMBERS) + stream[place + 1 :]


CHANGES: tuple[Callable[[bytes, Random], bytes], ...] = (
    _flip,
    _cut,
    _leave_out,
    _repeat,
    _put_extreme,
    _put_number,
)
