"""What a probe of a tracker's line means, in plain words: what was seen, the likely cause, what to do."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from dataclasses import dataclass
from typing import Any

from procedures.cli.line_probe import Access, Attempt, Outcome, Probe
from ronna_hw.wire.polaris import DEFAULT_BAUD

PRINTABLE_SHARE = 0.9
LEAST_TEXT = 6  # characters before bytes are called text


@dataclass(frozen=True)
class Verdict:
    """One line for a person."""

    well: bool
    seen: str
    advice: str = ""


def judge(probe: Probe) -> Verdict:
    """Say what the probe means."""
    if probe.access is not Access.OPENED:
        return _not_opened(probe)
    if (answered := probe.answered) is not None:
        return _answered(answered)
    if any(attempt.outcome is Outcome.LOST for attempt in probe.attempts):
        return Verdict(
            False,
            "broke off while it was asked",
            "Was the adapter pulled out, or the program at its far end stopped?",
        )
    noisy = [attempt for attempt in probe.attempts if attempt.heard]
    if not noisy:
        return _silent(probe)
    if any(attempt.outcome is Outcome.ECHO for attempt in noisy):
        return Verdict(
            False,
            f"gives back what we send {_where(noisy[0])}",
            "A plug that loops back, or a terminal with its echo on: no unit is there.",
        )
    seen = "; ".join(f"garbage {_where(attempt)}: bytes {attempt.heard.hex(' ')}" for attempt in noisy[-2:])
    if (text := _as_text(noisy[-1].heard)) is not None:
        advice = f"It speaks text ({text!r}): another device or program is on this line."
    elif probe.endpoint.scheme == "tcp":
        advice = "Another device or program listens there: check address and port."
    else:
        advice = (
            "Probably another rate, or another device. If it is the tracker: switch it off and on, "
            f"which brings it back to {DEFAULT_BAUD} baud."
        )
    return Verdict(False, seen, advice)


def document(probe: Probe) -> dict[str, Any]:
    """The probe and its verdict as plain data."""
    verdict = judge(probe)
    answered = probe.answered
    return {
        "endpoint": str(probe.endpoint),
        "well": verdict.well,
        "access": probe.access.value,
        "answered_at_baud": answered.baud if answered else None,
        "answer": answered.answer if answered else None,
        "last_bytes": probe.last_bytes.hex(" "),
        "attempts": [
            {
                "baud": attempt.baud,
                "outcome": attempt.outcome.value,
                "bytes": attempt.heard.hex(" "),
            }
            for attempt in probe.attempts
        ],
        "holders": [{"pid": holder.pid, "name": holder.name} for holder in probe.holders],
        "seen": verdict.seen,
        "cause": verdict.advice,
    }


def permissions(path: str) -> str:
    """Mode, owner and group of a port, as `ls -l` shows them."""
    try:
        about = os.stat(path)
    except OSError as error:
        return str(error.strerror)
    return f"{stat.filemode(about.st_mode)} {_owner(about.st_uid)} {_group(about.st_gid)}"


def permission_advice(path: str) -> str:
    """Who may use a port, and how to become one of them."""
    try:
        about = os.stat(path)
    except OSError:
        return "Join the group that owns it (often dialout), then log in again."
    group = _group(about.st_gid)
    mode = stat.filemode(about.st_mode)
    if about.st_mode & stat.S_IRGRP and about.st_mode & stat.S_IWGRP:
        return f"It belongs to group {group} ({mode}): sudo usermod -aG {group} $USER, then log in again."
    return f"Its mode {mode} lets not even its group {group} use it: have its udev rule corrected."


def _owner(number: int) -> str:
    try:
        return pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)


def _group(number: int) -> str:
    try:
        return grp.getgrgid(number).gr_name
    except KeyError:
        return str(number)


def _not_opened(probe: Probe) -> Verdict:
    endpoint = probe.endpoint
    if probe.access is Access.MISSING:
        return Verdict(
            False, f"{endpoint.path} does not exist", "Is the adapter plugged in? The ports above exist."
        )
    if probe.access is Access.FORBIDDEN:
        return Verdict(False, f"permission denied: {endpoint.path}", permission_advice(endpoint.path))
    if probe.access is Access.HELD:
        if probe.holders:
            who = " and ".join(str(holder) for holder in probe.holders)
            return Verdict(False, f"held by another program: {who}", "End that program, or use another port.")
        return Verdict(
            False,
            f"held by another program, which this user may not see ({probe.reason})",
            f"Find it by: sudo fuser -v {endpoint.path}",
        )
    if probe.access is Access.REFUSED:
        return Verdict(
            False,
            "connection refused",
            f"Nothing listens at {endpoint}: is the device on, and the program on it started?",
        )
    if probe.access is Access.CLOSED:
        return Verdict(
            False,
            f"the connection is closed as soon as it is used ({probe.reason})",
            "The unit may serve another client: end that one. Otherwise another program listens there.",
        )
    return Verdict(
        False,
        f"cannot be reached ({probe.reason})",
        f"{endpoint} cannot be reached: check cable, address and subnet.",
    )


def _answered(attempt: Attempt) -> Verdict:
    rate = "" if attempt.baud is None else f" at {attempt.baud}"
    seen = f"answered{rate}: {attempt.answer} (last bytes {attempt.heard.hex(' ')})"
    if attempt.baud in (None, DEFAULT_BAUD):
        return Verdict(True, seen)
    return Verdict(
        True,
        seen,
        f"An earlier program left it at this rate. Our driver finds it there; others need {DEFAULT_BAUD}: "
        "switch the unit off and on for them.",
    )


def _silent(probe: Probe) -> Verdict:
    if probe.endpoint.scheme == "tcp":
        return Verdict(
            False,
            "accepts the connection and says nothing",
            "Another program listens there, or the unit serves another client: check address and port.",
        )
    tried = [attempt.baud for attempt in probe.attempts if attempt.outcome is not Outcome.REFUSED]
    rates = ", ".join(str(baud) for baud in tried)
    return Verdict(
        False,
        f"silent at {rates} baud",
        "Is the unit powered, its cable plugged, and this its port? Switched off and on, it says RESET.",
    )


def _where(attempt: Attempt) -> str:
    return "over TCP" if attempt.baud is None else f"at {attempt.baud}"


def _as_text(heard: bytes) -> str | None:
    """The bytes as text when they look like it."""
    printable = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in heard)
    if len(heard) < LEAST_TEXT or printable < PRINTABLE_SHARE * len(heard):
        return None
    return heard.decode("ascii", "replace").strip()
