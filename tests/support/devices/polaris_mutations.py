"""Replies of a Polaris unit, disturbed in every way a line can disturb them, by the thousand or the million.

Whatever happens on the line, the driver raises errors of ours only, believes no bytes whose CRC is wrong (the
CRC is computed here, from its definition), gives no pose of another frame than it says, and is back within
two commands of the line being whole again.
"""

from __future__ import annotations

import random
import struct
from collections import Counter
from collections.abc import Callable
from typing import Any

from polaris_unit_in_process import StillClock, UnitInProcess, tracker_on

from drivers.ndi_polaris import PolarisTracker
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.errors import RonnaError

LONGEST_BURST = 4  # consecutive replies that are disturbed
LONGEST_DELAY_S = 6.0  # longer than the unit may take for a reading
COMMANDS_TO_RECOVER = 2
REMEMBERED_BYTES = 1 << 14  # of what was heard: more than any reply

Delivery = list[tuple[float, bytes]]  # delay in seconds, bytes


def flipped(reply: bytes, chosen: random.Random) -> Delivery:
    changed = bytearray(reply)
    for _ in range(chosen.choice((1, 1, 1, 2, 3, 8))):
        changed[chosen.randrange(len(changed))] ^= 1 << chosen.randrange(8)
    return [(0.001, bytes(changed))]


def cut(reply: bytes, chosen: random.Random) -> Delivery:
    return [(0.001, reply[: chosen.randrange(len(reply))])]


def dropped(reply: bytes, chosen: random.Random) -> Delivery:
    at = chosen.randrange(len(reply))
    return [(0.001, reply[:at] + reply[at + 1 :])]


def inserted(reply: bytes, chosen: random.Random) -> Delivery:
    at = chosen.randrange(len(reply) + 1)
    return [(0.001, reply[:at] + chosen.randbytes(chosen.randint(1, 4)) + reply[at:])]


def doubled(reply: bytes, chosen: random.Random) -> Delivery:
    return [(0.001, reply), (chosen.choice((0.001, 0.003, 0.03, chosen.uniform(0, 1))), reply)]


def delayed(reply: bytes, chosen: random.Random) -> Delivery:
    return [(chosen.choice((0.5, 0.999, 1.001, chosen.uniform(0, LONGEST_DELAY_S))), reply)]


def joined(reply: bytes, chosen: random.Random) -> Delivery:
    return [(0.001, reply + reply[: chosen.randint(1, len(reply))])]


def torn(reply: bytes, chosen: random.Random) -> Delivery:
    at = chosen.randrange(len(reply))
    return [(0.001, reply[:at]), (chosen.uniform(0.001, 0.6), reply[at:])]


def swallowed(reply: bytes, chosen: random.Random) -> Delivery:
    return []


def refused(reply: bytes, chosen: random.Random) -> Delivery:
    return [(0.001, b"ERROR016BC2\r")]


MUTATIONS: tuple[Callable[[bytes, random.Random], Delivery], ...] = (
    flipped, cut, dropped, inserted, doubled, delayed, joined, torn, swallowed, refused,
)  # fmt: skip


def crc_by_definition(data: bytes, crc: int = 0) -> int:
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


class Tapped(UnitInProcess):
    """Unit that keeps what its host has received of late."""

    def __init__(self) -> None:
        super().__init__(baud=None)
        self.heard = b""

    def read(self, timeout_s: float) -> bytes:
        data = super().read(timeout_s)
        self.heard = (self.heard + data)[-REMEMBERED_BYTES:]
        return data

    def all_has_come(self) -> None:
        """Let the time pass in which late replies come."""
        self.now_s = max(self.now_s, self._last_arrival_s) + 0.001


class Campaign:
    """Tracker on a line that is disturbed burst after burst; AssertionError when a promise is broken."""

    def __init__(self, seed: int, reply: str) -> None:
        self.mutated = 0
        self.accepted = 0
        self.errors: Counter[str] = Counter()
        self.recoveries = 0
        self._chosen = random.Random(seed)
        self._unit = Tapped()
        self._tracker: PolarisTracker = tracker_on(
            self._unit, StillClock(), "tcp://127.0.0.1:1", reply=reply, tools=[TOOL]
        )
        self._left = 0
        self._last = -1
        self._tracker.connect()
        self._tracker.configure()
        self._unit.deliver = self._deliver
        self._activate()

    def run(self, replies: int) -> None:
        """Disturb at least this many replies."""
        goal = self.mutated + replies
        while self.mutated < goal:
            self._left = self._chosen.randint(1, LONGEST_BURST)
            while self._left and self._tracker.state is Lifecycle.ACTIVE:
                self._read()
            self._left = 0
            self._unit.all_has_come()
            self._recover()
        self._tracker.close()

    def _deliver(self, command: str, reply: bytes) -> Delivery:
        if not self._left:
            return [(0.001, reply)]
        self._left -= 1
        self.mutated += 1
        return self._chosen.choice(MUTATIONS)(reply, self._chosen)

    def _read(self) -> bool:
        self._unit.heard = b""
        try:
            frame = self._tracker.read_frame()
        except RonnaError as error:
            self.errors[error.code] += 1
            return False
        self._check(frame)
        return True

    def _recover(self) -> None:
        for _ in range(COMMANDS_TO_RECOVER):
            if self._tracker.state is Lifecycle.FAULT:
                self.recoveries += 1
                self._tracker.recover("tester", timeout_s=60.0)
                self._activate()
            if self._read():
                return
        raise AssertionError(f"not back within {COMMANDS_TO_RECOVER} commands: {dict(self.errors)}")

    def _activate(self) -> None:
        self._tracker.activate()
        self._last = -1

    def _check(self, frame: TrackerFrame) -> None:
        self.accepted += 1
        number = frame.stamp.device_clock
        assert (frame.validity is Validity.STALE) == (number == self._last)
        assert number >= self._last
        assert number <= self._unit.frame
        self._last = number
        position_mm = frame.tool(TOOL["name"]).position_mm
        assert position_mm is not None
        assert abs(position_mm[2] - (-1500.0 - number / 100)) < 0.006  # the frame is told in the depth
        assert self._heard_whole(number), "a reading was made from bytes whose CRC is wrong"

    def _heard_whole(self, number: int) -> bool:
        """Whether a reply with right CRCs and that frame number was among the bytes heard."""
        heard = self._unit.heard
        in_text = f"{number:08X}00{self._unit.marker_digits}".encode()
        in_binary = struct.pack("<I", number)
        return any(in_binary in body for body in whole_binary(heard)) or any(
            in_text in text for text in whole_text(heard)
        )


def whole_binary(heard: bytes) -> list[bytes]:
    """The bodies of all binary replies in the bytes, both CRCs right."""
    found = []
    at = heard.find(b"\xc4\xa5")
    while at >= 0:
        head = heard[at : at + 6]
        if len(head) == 6 and crc_by_definition(head[:4]) == int.from_bytes(head[4:], "little"):
            length = int.from_bytes(head[2:4], "little")
            body, crc = heard[at + 6 : at + 6 + length], heard[at + 6 + length : at + 8 + length]
            if len(crc) == 2 and crc_by_definition(body) == int.from_bytes(crc, "little"):
                found.append(body)
        at = heard.find(b"\xc4\xa5", at + 1)
    return found


def whole_text(heard: bytes) -> list[bytes]:
    """The texts of all ASCII replies in the bytes with a right CRC."""
    lines = [line for line in heard.split(b"\r") if len(line) > 4]
    return [line[:-4] for line in lines if line[-4:] == b"%04X" % crc_by_definition(line[:-4])]


TOOL: dict[str, Any] = {"name": "robot_frame", "rom": "robot_frame.rom"}
