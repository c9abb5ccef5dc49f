"""Interprets the state of a tracker's line: observation, likely cause, what to do."""

from __future__ import annotations

from typing import Any, NamedTuple

from drivers.ndi_polaris.probe.line import Attempt, LineState, Opening, Outcome
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.host.port_users import permission_advice
from ronna_hw.wire.kuka_eki import STATE
from ronna_hw.wire.polaris import DEFAULT_BAUD

PRINTABLE_SHARE = 0.9
EKI_STATE = f"</{STATE}>".encode()  # how the telegrams of the project's EKI server end
LEAST_TEXT = 6  # characters for bytes to count as text
SECTION = "lines"


class Diagnosis(NamedTuple):
    """One line for display."""

    well: bool
    seen: str
    advice: str = ""


def line_diagnostic(line: LineState, *, of_tracker: bool) -> Diagnostic:
    """The line for the doctor, with every attempt in bytes."""
    well, seen, advice = diagnose(line, of_tracker=of_tracker)
    answered = line.answered
    document: dict[str, Any] = {
        "endpoint": str(line.endpoint),
        "well": well,
        "access": line.opening.value,
        "answered_at_baud": answered.baud if answered else None,
        "answer": answered.reply if answered else None,
        "last_bytes": line.last_bytes.hex(" "),
        "attempts": [
            {"baud": attempt.baud, "outcome": attempt.outcome.value, "bytes": attempt.heard.hex(" ")}
            for attempt in line.attempts
        ],
        "holders": [{"pid": user.pid, "name": user.name} for user in line.users],
        "seen": seen,
        "cause": advice,
    }
    return Diagnostic(f"line {line.endpoint}", well, seen, advice, SECTION, document)


def diagnose(line: LineState, *, of_tracker: bool = True) -> Diagnosis:
    """State the observation, and what it means.

    Unless the line was declared as a tracker's (`of_tracker`), it may also be a robot controller's.
    """
    if line.opening is not Opening.OPENED:
        return _not_opened(line)
    if (answered := line.answered) is not None:
        return _answered(answered)
    if any(attempt.outcome is Outcome.LOST for attempt in line.attempts):
        return Diagnosis(
            False,
            "lost during the inquiry",
            "Was the adapter unplugged, or the program at the other end stopped?",
        )
    noisy = [attempt for attempt in line.attempts if attempt.heard]
    if not noisy:
        return _silent(line)
    if any(attempt.outcome is Outcome.ECHO for attempt in noisy):
        return Diagnosis(
            False,
            f"echoes our commands {_where(noisy[0])}",
            "A loop-back plug, or a terminal with its echo on: there is no unit.",
        )
    if line.endpoint.scheme == "tcp" and EKI_STATE in noisy[-1].heard:
        return Diagnosis(
            not of_tracker,
            f"a robot controller that sends its state over EKI{', not a tracker' if of_tracker else ''}",
            "To check it, enter it as eki_project of [robot.master] and run ronna-procedure doctor --config.",
        )
    seen = "; ".join(f"garbage {_where(attempt)}: bytes {attempt.heard.hex(' ')}" for attempt in noisy[-2:])
    if (text := _as_text(noisy[-1].heard)) is not None:
        advice = f"It sends text ({text!r}): another device or program is on this line."
    elif line.endpoint.scheme == "tcp":
        advice = "Another device or program is listening there: check address and port."
    else:
        advice = (
            "Probably another rate, or another device. If it is the tracker: power-cycle it, which resets "
            f"it to {DEFAULT_BAUD} baud."
        )
    return Diagnosis(False, seen, advice)


def _not_opened(line: LineState) -> Diagnosis:
    endpoint = line.endpoint
    if line.opening is Opening.MISSING:
        advice = "Is the adapter plugged in? The ports that exist are listed above."
        return Diagnosis(False, f"{endpoint.path} does not exist", advice)
    if line.opening is Opening.FORBIDDEN:
        return Diagnosis(False, f"permission denied: {endpoint.path}", permission_advice(endpoint.path))
    if line.users:
        users = " and ".join(str(user) for user in line.users)
        return Diagnosis(
            False,
            f"held by another program: {users}",
            "If it runs a case, leave it alone: its arm may be at a patient. Otherwise stop it, or use "
            "another port.",
        )
    if line.opening is Opening.HELD:
        return Diagnosis(
            False,
            "held by another program, not visible to this user",
            f"Find it with: sudo fuser -v {endpoint.path}",
        )
    if line.opening is Opening.CLOSED:
        return Diagnosis(
            False,
            "the connection is closed as soon as it is used",
            "The unit may be serving another client: stop that one. Otherwise another program is "
            "listening there.",
        )
    assert line.refusal is not None
    return Diagnosis(False, line.refusal.reason, line.refusal.advice)


def _answered(attempt: Attempt) -> Diagnosis:
    rate = "" if attempt.baud is None else f" at {attempt.baud}"
    seen = f"answered{rate}: {attempt.reply} (last bytes {attempt.heard.hex(' ')})"
    if attempt.baud in (None, DEFAULT_BAUD):
        return Diagnosis(True, seen)
    return Diagnosis(
        True,
        seen,
        f"An earlier program left it at this rate. Our driver finds it there; others need {DEFAULT_BAUD}: "
        "power-cycle the unit for them.",
    )


def _silent(line: LineState) -> Diagnosis:
    if line.endpoint.scheme == "tcp":
        return Diagnosis(
            False,
            "accepts the connection and sends nothing",
            "Another program is listening there, or the unit serves another client: check address and port.",
        )
    tried = [attempt.baud for attempt in line.attempts if attempt.outcome is not Outcome.REFUSED]
    return Diagnosis(
        False,
        f"silent at {', '.join(map(str, tried))} baud",
        "Is the unit powered, is its cable plugged in, and is this its port? At power-up it sends RESET.",
    )


def _where(attempt: Attempt) -> str:
    return "over TCP" if attempt.baud is None else f"at {attempt.baud}"


def _as_text(heard: bytes) -> str | None:
    """The bytes as text if they look like it."""
    printable = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in heard)
    if len(heard) < LEAST_TEXT or printable < PRINTABLE_SHARE * len(heard):
        return None
    return heard.decode("ascii", "replace").strip()
