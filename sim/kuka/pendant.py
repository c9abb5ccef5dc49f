"""Teach pendant: stop messages, interlocks, keys and the printed display.

Messages have KUKA's numbers and our own wording.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from ronna_hw.wire.kuka_eki import OperationMode
from sim.kuka.controller_parameters import ControllerParameters

RSI_OBJECT_ERROR = 29002
RSI_LIMIT_EXCEEDED = 29000
COMMAND_TORQUE = 1073
COMMAND_ACCELERATION = 1074
COMMAND_VELOCITY = 1102
OVERSPEED = 421

MANUAL_MODES = (OperationMode.T1, OperationMode.T2)

PENDANT_PREFIX = "pendant at "  # of each line of the display


class PendantMessage(NamedTuple):
    """A message requiring acknowledgement; the drives go off (`drives_off`) or the arm brakes on its path."""

    number: int
    text: str
    drives_off: bool


def rsi_timeout(late: int) -> PendantMessage:
    """Return the message for too many late replies."""
    return PendantMessage(
        RSI_OBJECT_ERROR, f"signal flow: object ETHERNET1 returns error RSITimeout ({late} packets)", False
    )


def rsi_bad(object_name: str) -> PendantMessage:
    """Return the message for an RSI object that has no effect at this point."""
    return PendantMessage(RSI_OBJECT_ERROR, f"signal flow: object {object_name} returns error RSIBad", False)


def out_of_range(monitor: str, what: str, value: float, limit: float) -> PendantMessage:
    """Return the message for a total correction beyond a monitor's range."""
    return PendantMessage(
        RSI_LIMIT_EXCEEDED, f"{monitor}: {what} out of range, {value:.4f} beyond {limit:.4f}", False
    )


def too_fast(axis: str, speed_deg_s: float, limit_deg_s: float) -> PendantMessage:
    """Return the message for a commanded speed above the axis limit."""
    return PendantMessage(
        COMMAND_VELOCITY, f"command velocity {axis}: {speed_deg_s:.1f} deg/s, at most {limit_deg_s:.1f}", True
    )


def end_switch(number: int, axis: str, angle_deg: float) -> PendantMessage:
    """Return the message for a command beyond a software end switch."""
    sign = "+" if angle_deg > 0 else "-"
    return PendantMessage(number, f"software end switch {sign}{axis} at {angle_deg:.4f} deg", False)


def near_singularity() -> PendantMessage:
    """Return the message for a Cartesian correction or path that the joints cannot follow."""
    return PendantMessage(
        COMMAND_VELOCITY, "command velocity A4, A6: Cartesian motion near a singularity", True
    )


# Trips by their name in a fault script; always of the first axis.
TRIPS: dict[str, Callable[[ControllerParameters], PendantMessage]] = {
    "timeout": lambda _: PendantMessage(
        RSI_OBJECT_ERROR, "signal flow: object ETHERNET1 returns error RSITimeout", False
    ),
    "rsi_bad": lambda _: rsi_bad("AXISCORR1"),
    "monitor": lambda _: PendantMessage(RSI_LIMIT_EXCEEDED, "AXISCORRMON: A1 out of range", False),
    "torque": lambda _: PendantMessage(COMMAND_TORQUE, "command gear torque A1", True),
    "acceleration": lambda _: PendantMessage(COMMAND_ACCELERATION, "command acceleration A1", True),
    "velocity": lambda _: PendantMessage(COMMAND_VELOCITY, "command velocity A1", True),
    "overspeed": lambda _: PendantMessage(OVERSPEED, "overspeed A1", True),
    "end_switch": lambda parameters: PendantMessage(
        parameters.end_switch_message, "software end switch +A1", False
    ),
    "singularity": lambda _: near_singularity(),
}


@dataclass
class Interlocks:
    """State of interlocks and keys, with the enabling switch initially held."""

    mode: OperationMode = OperationMode.EXT
    emergency_stop: bool = False
    guard_open: bool = False
    enabling_switch: bool = True  # matters in T1 and T2 only
    start_key: bool = False  # in T1 and T2 a program runs while it is held

    @property
    def manual(self) -> bool:
        """Whether a test mode (T1 or T2) is selected."""
        return self.mode in MANUAL_MODES

    @property
    def guard_matters(self) -> bool:
        """Whether an open guard forbids motion, which is never the case in the test modes."""
        return self.guard_open and not self.manual

    @property
    def forbids_drives(self) -> bool:
        """Whether the interlocks prevent switching the drives on."""
        return self.emergency_stop or self.guard_matters or (self.manual and not self.enabling_switch)

    @property
    def forbids_program(self) -> str:
        """Reason why the present mode forbids running a program, or an empty string if it may run."""
        if self.mode is OperationMode.AUT:
            return "mode AUT: the program can only be started at the pendant"
        if self.manual and not self.start_key:
            return f"mode {self.mode}: the start key is not held"
        return ""


class PendantDisplay:
    """Prints messages and the client's EStr texts on standard error, stamped with the theatre time."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._message: PendantMessage | None = None
        self._notice = ""

    def update(self, message: PendantMessage | None, notice: str) -> None:
        """Print a new message, its acknowledgement, or a new EStr text."""
        if message is not self._message:
            shown, self._message = self._message, message
            if message is not None:
                self._write(f"{_kss_number(message)} {message.text}")
            elif shown is not None:
                self._write(f"{_kss_number(shown)} acknowledged")
        if notice != self._notice:
            self._notice = notice
            if notice:
                self._write(notice)

    def _write(self, what: str) -> None:
        text = "".join(letter if letter.isprintable() else " " for letter in what)
        sys.stderr.write(f"{PENDANT_PREFIX}{self._now_s():.3f} s: {text}\n")
        sys.stderr.flush()


def _kss_number(message: PendantMessage) -> str:
    return f"KSS{message.number:05d}"
