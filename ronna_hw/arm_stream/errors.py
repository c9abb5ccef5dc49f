"""Errors of all streams: one table of kinds and words, which each make has under its own codes.

The classes are the kinds that somebody catches by name; they have no code themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from ronna_hw.devices.errors import ACKNOWLEDGE, MotionInterrupted
from ronna_hw.errors import (
    AnyError,
    ConnectError,
    DeviceError,
    ErrorCode,
    LimitError,
    LinkTimeout,
    ProtocolError,
    RefusedError,
    RonnaError,
    StateError,
)


class ControllerNotFound(ConnectError):
    """No controller of the make answers at an endpoint."""


class ControllerLost(ProtocolError):
    """A connection to the controller broke."""


class NoAnswer(LinkTimeout):
    """The controller did not answer in time."""


class MalformedMessage(ProtocolError):
    """Bytes received from the controller are not a message of its protocol."""


class CommandRefused(DeviceError):
    """The controller refused a command."""


class MakeRow(NamedTuple):
    """Code that a make has for an error of the table, and its words where the table's do not hold for it."""

    code: str
    meaning: str = ""
    action: str = ""


@dataclass(frozen=True, kw_only=True)
class StreamWords:
    """Words of one make for the parts of its stream, for error messages."""

    clock: str  # time stamp of a message
    message: str  # sent by the controller in every cycle
    answers: str  # sent back, in the plural
    stop: str  # sentence: what happens without answers
    speed: str = "the controller's speed"  # slows motions there
    speed_action: str | None = None  # what to do about it


class StreamErrors:
    """Errors of one make's stream."""

    def __init__(self, words: StreamWords, make: Mapping[str, MakeRow]) -> None:
        """`make` has a row for each error, by name, and no other."""
        self.words = words
        remaining = dict(make)

        def row(name: str, kind: type[AnyError], meaning: str = "", action: str = "") -> ErrorCode[AnyError]:
            own = remaining.pop(name)
            return ErrorCode(own.code, kind, own.meaning or meaning, own.action or action)

        self.not_found = row("not_found", ControllerNotFound)
        self.lost = row(
            "lost",
            ControllerLost,
            "A connection to the controller broke.",
            f"To open a new connection and read everything again, {ACKNOWLEDGE}.",
        )
        self.no_answer = row(
            "no_answer",
            NoAnswer,
            "The controller did not answer in time.",
            f"Check that the controller's software runs; if the arm is in fault, {ACKNOWLEDGE}.",
        )
        self.not_started = row(
            "not_started",
            ConnectError,
            "The real-time process did not start.",
            "Check the computer's memory and process limits, then start again.",
        )
        self.died = row(
            "died",
            DeviceError,
            "The real-time process terminated unexpectedly.",
            f"{words.stop} Then {ACKNOWLEDGE}. Report the message if it repeats.",
        )
        self.stalled = row(
            "stalled",
            DeviceError,
            f"The real-time process is running but stalled, so the controller gets no {words.answers}.",
            f"{words.stop} Find what blocks the process or the computer; then {ACKNOWLEDGE}. "
            "A new process is started.",
        )
        self.silent = row(
            "silent",
            LinkTimeout,
            f"{words.message.capitalize()}s stopped arriving while the stream was running.",
            f"{words.stop} Check the cable and the controller, then {ACKNOWLEDGE}.",
        )
        self.heartbeat_late = row(
            "heartbeat_late",
            LinkTimeout,
            "This program's heartbeat to the real-time process was late, so the arm was stopped.",
            f"Reduce the computer's load, or find what blocked the program; then {ACKNOWLEDGE}.",
        )
        self.tripped = row(
            "tripped",
            LimitError,
            "The monitor stopped the arm.",
            f"Read the recorded cycles, find the cause, then {ACKNOWLEDGE}.",
        )
        self.path_failed = row(
            "path_failed",
            LimitError,
            "The path had no solution at some point, so the arm was stopped in joint space.",
            f"First {ACKNOWLEDGE}. Then move away from the singular pose by a joint move.",
        )
        self.unusable = row("unusable", LinkTimeout)  # too many losses
        self.protective_stop = row(
            "protective_stop",
            StateError,
            "A protective stop was requested; it remains latched.",
            f"Find the reason, then {ACKNOWLEDGE}.",
        )
        self.link_stopped = row("link_stopped", StateError, action=self.protective_stop.action)
        self.drives_off = row(
            "drives_off",
            StateError,
            "The drives were switched off on request, and a fault is latched.",
            self.protective_stop.action,
        )
        self.stopped = row(
            "stopped",
            MotionInterrupted,
            "A motion was stopped before its end, with the arm at rest on its path.",
            "Resume and plan a new motion from here; an interrupted path is not continued.",
        )
        self.not_finished = row(
            "not_finished",
            LinkTimeout,
            "The motion did not end, or the arm did not settle, within the time limit.",
            "Give the motion more time, or check the lost cycles and option settle_tolerance_deg.",
        )
        self.refused = row(
            "refused",
            RefusedError,
            "The real-time process refused a motion.",
            "Wait for the current motion to end, and plan from the arm's current pose.",
        )
        if remaining:
            raise TypeError(f"no errors of a stream: {', '.join(remaining)}")

    def rows(self) -> dict[str, ErrorCode[RonnaError]]:
        """Return all errors by name."""
        return {name: row for name, row in vars(self).items() if isinstance(row, ErrorCode)}
