"""Line faults: noise, lost and doubled bytes, delays in either direction.

Which command and which bit are hit is a function of seed and command number, so a run repeats.
"""

from __future__ import annotations

import time

import numpy as np

from ronna_hw.wire.polaris import COMMAND_TIMEOUT_S, CR
from sim.polaris.unit.unit import Unit
from sim.world.noise import noise

DEVICE = "tracker line"
WHOLE_PERCENT = 100.0
USUAL_LIMIT_S = 2.0  # of a host, for a command whose time limit is unknown
BITS = 8


class LineFaults:
    """Faults of the line between host and unit. Costs one look-up if there are none."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._board = unit.faults
        self._count = 0  # commands received while there were faults

    def to_unit(self, line: bytes) -> bytes:
        """A command line as received by the unit."""
        if self._board.empty:
            return line
        self._count += 1
        generator = noise(self._unit.seed, DEVICE, self._count, lane=0)
        return _flipped(line, generator) if line and self._strikes("garble_commands", generator) else line

    def to_host(self, line: bytes, reply: bytes) -> bytes:
        """A reply as received by the host, possibly late; empty if lost."""
        if self._board.empty:
            return reply
        if not reply:  # the unit has no power
            self._host_waits(line)
            return reply
        generator = noise(self._unit.seed, DEVICE, self._count, lane=1)
        for fault in self._board.active("late_replies"):
            self._wait(float(fault.argument))
        complete = len(reply)
        if self._strikes("garble_replies", generator):
            reply = _flipped(reply, generator)
        place = int(generator.integers(len(reply)))
        if self._strikes("double_bytes", generator):
            reply = reply[: place + 1] + reply[place:]
        if self._strikes("drop_bytes", generator):
            reply = reply[:place] + reply[place + 1 :]
        if self._strikes("cut_replies", generator):
            reply = reply[:place]
        if self._strikes("lose_replies", generator):
            reply = b""
        if len(reply) < complete:
            self._host_waits(line)
        return reply

    def _host_waits(self, line: bytes) -> None:
        """Let the host run into its time limit: an unpaced theatre advances by it, so that faults end."""
        if not self._unit.clock.paced:
            name = line.replace(b":", b" ").partition(b" ")[0].decode("latin-1")
            self._unit.take_time(COMMAND_TIMEOUT_S.get(name, USUAL_LIMIT_S))

    def _wait(self, duration_s: float) -> None:
        """Let host time and theatre time pass: a host's time limits use its own clock."""
        time.sleep(duration_s)
        if not self._unit.clock.paced:
            self._unit.take_time(duration_s)

    def _strikes(self, kind: str, generator: np.random.Generator) -> bool:
        chance = float(generator.random()) * WHOLE_PERCENT
        return any(chance < float(fault.argument) for fault in self._board.active(kind))


def _flipped(data: bytes, generator: np.random.Generator) -> bytes:
    """The bytes with one bit flipped, but never into or out of a CR."""
    damaged = bytearray(data)
    place = int(generator.integers(len(data)))
    bit = int(generator.integers(BITS))
    while damaged[place] ^ (1 << bit) == CR[0]:
        bit = (bit + 1) % BITS
    damaged[place] ^= 1 << bit
    return bytes(damaged)
