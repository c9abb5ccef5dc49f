"""Low-level check of a tracker line: baud rate, other users of the port, advice.

The inquiry is the driver's own: every unit answers it, and it changes nothing. A unit is never reset for
this, not even by a break. A line opened by another program is left alone. So is a server that speaks first,
in XML: it is a controller, and takes every byte for a command.
"""

from __future__ import annotations

import errno
import os
import time
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from drivers.ndi_polaris.command_link import CommandLink
from drivers.ndi_polaris.discovery import INQUIRY, LIKELY_BAUDS, inquire
from drivers.ndi_polaris.errors import LinkLost, NotAPolaris, PortUnavailable
from drivers.ndi_polaris.transport import open_transport
from ronna_hw.devices.probing import Diagnostic
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import (
    LEAVE_A_CASE_ALONE,
    PortUser,
    advise_on_permission,
    find_serial_port_users,
    find_tcp_clients,
)
from ronna_hw.wire.kuka_eki import STATE
from ronna_hw.wire.polaris import COMM_BAUD_CODES, CR, DEFAULT_BAUD

# The driver reaches rates outside its list with a break, which a probe must not send.
BAUDS = (*LIKELY_BAUDS, *sorted(set(COMM_BAUD_CODES.values()) - set(LIKELY_BAUDS)))
OPEN_LIMIT_S = 2.0
INQUIRY_LIMIT_S = 1.0  # for one rate, or for the connection
SPEAKS_FIRST_S = 0.5  # host time; our EKI program sends its state every 0.1 s
KEPT_BYTES = 32
PRINTABLE_SHARE = 0.9
EKI_STATE = f"</{STATE}>".encode()  # how the telegrams of the project's EKI server end
LEAST_TEXT = 6  # characters for bytes to count as text
SECTION = "lines"
Finding = tuple[bool, str, str]  # whether all is well, observation, advice


class LineOpening(StrEnum):
    """Result of opening the line."""

    OPENED = "opened"
    MISSING = "missing"
    FORBIDDEN = "forbidden"
    HELD = "held"
    REFUSED = "refused"  # nothing listens
    UNREACHABLE = "unreachable"
    CLOSED = "closed"  # accepted, and closed at once


class LineOutcome(StrEnum):
    """Result of an inquiry at one baud rate."""

    ANSWERED = "answered"
    GARBAGE = "garbage"
    ECHO = "echo"
    SILENCE = "silence"
    REFUSED = "rate refused"  # by this computer's adapter
    LOST = "line lost"


@dataclass(frozen=True)
class Attempt:
    """Inquiry at one baud rate, with the last bytes received and the text of any valid reply."""

    baud: int | None  # None over TCP
    outcome: LineOutcome
    heard: bytes = b""
    reply: str = ""


@dataclass(frozen=True)
class LineState:
    """Diagnostic findings for one line."""

    endpoint: Endpoint
    opening: LineOpening
    attempts: tuple[Attempt, ...] = ()
    users: tuple[PortUser, ...] = ()
    refusal: PortUnavailable | None = None  # if the line could not be opened

    @property
    def answered_attempt(self) -> Attempt | None:
        """First attempt that got a reply, if any."""
        return next((attempt for attempt in self.attempts if attempt.outcome is LineOutcome.ANSWERED), None)

    @property
    def last_bytes(self) -> bytes:
        """Bytes received in the last attempt that got any."""
        return next((attempt.heard for attempt in reversed(self.attempts) if attempt.heard), b"")


_OPENING_BY_ERROR = {
    errno.EACCES: LineOpening.FORBIDDEN,
    errno.EAGAIN: LineOpening.HELD,
    errno.EBUSY: LineOpening.HELD,
    errno.ECONNREFUSED: LineOpening.REFUSED,
}


def check_line(endpoint: Endpoint) -> LineState:
    """Check a serial or TCP line, reporting all problems in the result; raises CFG-002 for other schemes."""
    if endpoint.require("serial", "tcp").scheme == "serial":
        if not os.path.exists(endpoint.path):
            return LineState(endpoint, LineOpening.MISSING)
        users = find_serial_port_users(endpoint.path)
        if not os.access(endpoint.path, os.R_OK | os.W_OK):
            return LineState(endpoint, LineOpening.FORBIDDEN, users=users)
        if users:
            return LineState(endpoint, LineOpening.HELD, users=users)
    elif users := find_tcp_clients(endpoint.host, endpoint.port):  # a second client may disturb theirs
        return LineState(endpoint, LineOpening.HELD, users=users)
    try:
        transport = open_transport(endpoint, OPEN_LIMIT_S)
    except PortUnavailable as error:
        opening = _OPENING_BY_ERROR.get(error.number or 0, LineOpening.UNREACHABLE)
        return LineState(endpoint, opening, refusal=error)
    try:
        attempts = _try_rates(CommandLink(transport))
    finally:
        transport.close()
    closed = endpoint.scheme == "tcp" and attempts[-1].outcome is LineOutcome.LOST
    return LineState(
        endpoint, LineOpening.CLOSED if closed else LineOpening.OPENED, () if closed else attempts
    )


def _try_rates(link: CommandLink) -> tuple[Attempt, ...]:
    attempts: list[Attempt] = []
    for baud in BAUDS if link.transport.baud is not None else (None,):
        attempts.append(_try_rate(link, baud))
        if attempts[-1].outcome in (LineOutcome.ANSWERED, LineOutcome.LOST):
            break
    return tuple(attempts)


def _try_rate(link: CommandLink, baud: int | None) -> Attempt:
    try:
        if baud is not None:
            link.transport.set_baud(baud)
        elif (greeting := link.transport.read(SPEAKS_FIRST_S)).startswith(b"<"):
            return Attempt(baud, LineOutcome.GARBAGE, greeting[-KEPT_BYTES:])
        link.deadline_s = time.monotonic() + INQUIRY_LIMIT_S
        heard, reply = inquire(link)
    except PortUnavailable:
        return Attempt(baud, LineOutcome.REFUSED)
    except LinkLost:
        return Attempt(baud, LineOutcome.LOST)
    except NotAPolaris as error:
        return Attempt(baud, LineOutcome.GARBAGE, error.wire[-KEPT_BYTES:])
    if reply is not None:
        outcome = LineOutcome.ANSWERED
    elif INQUIRY.rstrip(CR) in heard:
        outcome = LineOutcome.ECHO
    else:
        outcome = LineOutcome.GARBAGE if heard else LineOutcome.SILENCE
    return Attempt(baud, outcome, heard[-KEPT_BYTES:], reply or "")


def line_diagnostic(line: LineState, *, of_tracker: bool = True) -> Diagnostic:
    """Return the doctor's finding for a line, with the bytes received in each attempt.

    Unless the line was declared as a tracker's (`of_tracker`), it may also be a robot controller's.
    """
    well, seen, advice = _diagnose(line, of_tracker=of_tracker)
    answered_attempt = line.answered_attempt
    document: dict[str, Any] = {
        "endpoint": str(line.endpoint),
        "well": well,
        "access": line.opening.value,
        "answered_at_baud": answered_attempt.baud if answered_attempt else None,
        "answer": answered_attempt.reply if answered_attempt else None,
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


def _diagnose(line: LineState, *, of_tracker: bool) -> Finding:
    if line.opening is not LineOpening.OPENED:
        return _diagnose_refusal(line)
    if (answered_attempt := line.answered_attempt) is not None:
        return _diagnose_reply(answered_attempt)
    if any(attempt.outcome is LineOutcome.LOST for attempt in line.attempts):
        advice = "Was the adapter unplugged, or the program at the other end stopped?"
        return False, "lost during the inquiry", advice
    if not (noisy_attempts := [attempt for attempt in line.attempts if attempt.heard]):
        return _diagnose_silence(line)
    if any(attempt.outcome is LineOutcome.ECHO for attempt in noisy_attempts):
        advice = "A loop-back plug, or a terminal with its echo on: there is no unit."
        return False, f"echoes our commands {_rate_text(noisy_attempts[0])}", advice
    if line.endpoint.scheme == "tcp" and EKI_STATE in noisy_attempts[-1].heard:
        seen = f"a robot controller that sends its state over EKI{', not a tracker' if of_tracker else ''}"
        advice = (
            "To check it, enter it as eki_project of [robot.master] and run ronna-procedure doctor --config."
        )
        return not of_tracker, seen, advice
    seen = "; ".join(
        f"garbage {_rate_text(attempt)}: bytes {attempt.heard.hex(' ')}" for attempt in noisy_attempts[-2:]
    )
    if (text := _decode_text(noisy_attempts[-1].heard)) is not None:
        advice = f"It sends text ({text!r}): another device or program is on this line."
    elif line.endpoint.scheme == "tcp":
        advice = "Another device or program is listening there: check address and port."
    else:
        advice = (
            "Probably another rate, or another device. If it is the tracker: power-cycle it, which resets "
            f"it to {DEFAULT_BAUD} baud."
        )
    return False, seen, advice


def _diagnose_refusal(line: LineState) -> Finding:
    endpoint = line.endpoint
    if line.opening is LineOpening.MISSING:
        advice = "Is the adapter plugged in? doctor --all lists the ports that exist."
        return False, f"{endpoint.path} does not exist", advice
    if line.opening is LineOpening.FORBIDDEN:
        return False, f"permission denied: {endpoint.path}", advise_on_permission(endpoint.path)
    if line.users:
        users = " and ".join(str(user) for user in line.users)
        advice = f"{LEAVE_A_CASE_ALONE} Otherwise stop it, or use another port."
        return False, f"held by another program: {users}", advice
    if line.opening is LineOpening.HELD:
        advice = f"Find it with: sudo fuser -v {endpoint.path}"
        return False, "held by another program, not visible to this user", advice
    if line.opening is LineOpening.CLOSED:
        unit_serves_another = "The unit may be serving another client: stop that one."
        advice = f"{unit_serves_another} Otherwise another program is listening there."
        return False, "the connection is closed as soon as it is used", advice
    assert line.refusal is not None
    return False, line.refusal.reason, line.refusal.advice


def _diagnose_reply(attempt: Attempt) -> Finding:
    rate = "" if attempt.baud is None else f" at {attempt.baud}"
    seen = f"answered{rate}: {attempt.reply} (last bytes {attempt.heard.hex(' ')})"
    if attempt.baud in (None, DEFAULT_BAUD):
        return True, seen, ""
    advice = (
        f"An earlier program left it at this rate. Our driver finds it there; others need {DEFAULT_BAUD}: "
        "power-cycle the unit for them."
    )
    return True, seen, advice


def _diagnose_silence(line: LineState) -> Finding:
    if line.endpoint.scheme == "tcp":
        advice = (
            "Another program is listening there, or the unit serves another client: check address and port."
        )
        return False, "accepts the connection and sends nothing", advice
    tried = [attempt.baud for attempt in line.attempts if attempt.outcome is not LineOutcome.REFUSED]
    advice = "Is the unit powered, is its cable plugged in, and is this its port? At power-up it sends RESET."
    return False, f"silent at {', '.join(map(str, tried))} baud", advice


def _rate_text(attempt: Attempt) -> str:
    return "over TCP" if attempt.baud is None else f"at {attempt.baud}"


def _decode_text(heard: bytes) -> str | None:
    """Decode the bytes as text if most of them are printable."""
    printable = sum(32 <= byte < 127 or byte in b"\r\n\t" for byte in heard)
    if len(heard) < LEAST_TEXT or printable < PRINTABLE_SHARE * len(heard):
        return None
    return heard.decode("ascii", "replace").strip()
