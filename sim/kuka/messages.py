"""What the controller shows on its pendant when it stops: numbers of the maker, words of our own."""

from __future__ import annotations

from typing import NamedTuple

RSI_OBJECT_ERROR = 29002
RSI_LIMIT_EXCEEDED = 29000
COMMAND_ACCELERATION = 1074
COMMAND_VELOCITY = 1102


class Message(NamedTuple):
    """An acknowledgement message. `drives_off` when the drives stop, else the arm brakes on its path."""

    number: int
    text: str
    drives_off: bool


def rsi_timeout(late: int) -> Message:
    """Too many replies were late."""
    return Message(
        RSI_OBJECT_ERROR, f"signal flow: object ETHERNET1 returns error RSITimeout ({late} packets)", False
    )


def rsi_bad(object_name: str) -> Message:
    """An object was used where it cannot act."""
    return Message(RSI_OBJECT_ERROR, f"signal flow: object {object_name} returns error RSIBad", False)


def out_of_range(monitor: str, what: str, value: float, limit: float) -> Message:
    """The total correction left the range that a monitor guards."""
    return Message(
        RSI_LIMIT_EXCEEDED, f"{monitor}: {what} out of range, {value:.4f} beyond {limit:.4f}", False
    )


def step_too_large(axis: str, step_deg: float, limit_deg: float) -> Message:
    """One command was too far from the one before."""
    return Message(
        COMMAND_ACCELERATION,
        f"command acceleration {axis}: step {step_deg:.4f} deg, at most {limit_deg:.4f}",
        True,
    )


def too_fast(axis: str, speed_deg_s: float, limit_deg_s: float) -> Message:
    """The command moved faster than the axis can."""
    return Message(
        COMMAND_VELOCITY, f"command velocity {axis}: {speed_deg_s:.1f} deg/s, at most {limit_deg_s:.1f}", True
    )


def end_switch(number: int, axis: str, angle_deg: float) -> Message:
    """The command would pass a software end switch."""
    sign = "+" if angle_deg > 0 else "-"
    return Message(number, f"software end switch {sign}{axis} at {angle_deg:.4f} deg", False)


def no_inverse() -> Message:
    """A Cartesian correction leads where the joints cannot follow."""
    return Message(COMMAND_VELOCITY, "command velocity A4, A6: Cartesian correction near a singularity", True)
