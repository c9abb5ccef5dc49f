"""Ask whatever is on a tracker's line who it is, below every driver: what answered, at which rate, in bytes.

The question is APIREV: every unit of the protocol answers it in some way, and it changes nothing. A unit is
never reset for this; a line that another program has open is left alone.
"""

from __future__ import annotations

import os
import select
import socket
import time
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import PortUser, users_of_serial_port
from ronna_hw.wire.polaris import ASCII_CRC_DIGITS, BITS_PER_BYTE_ON_LINE, CR, DEFAULT_BAUD, crc16

# Rates that a unit may have been left at, the likeliest first.
BAUDS = (DEFAULT_BAUD, 115200, 921600, 230400, 57600, 38400, 19200, 14400, 1228739)
QUESTION_TEXT = b"APIREV:"
QUESTION = b"%b%04X\r" % (QUESTION_TEXT, crc16(QUESTION_TEXT))
ANSWER_BYTES = 64  # longest answer that a rate is given the time for
PATIENCE_S = 0.25  # per question, beside the transfer
TCP_PATIENCE_S = 1.0
OPEN_LIMIT_S = 2.0
QUESTIONS = 2  # the first may be spoilt by what the unit still holds of another rate
QUIET_S = 0.05
KEPT_BYTES = 32


class Outcome(StrEnum):
    """What came of asking at one rate."""

    ANSWERED = "answered"
    GARBAGE = "garbage"
    ECHO = "echo"
    SILENCE = "silence"
    REFUSED = "rate refused"  # by this computer's adapter
    LOST = "line lost"  # while it was asked


class Access(StrEnum):
    """Whether the line could be opened at all."""

    OPENED = "opened"
    MISSING = "missing"
    FORBIDDEN = "forbidden"
    HELD = "held"
    REFUSED = "refused"  # nobody listens
    UNREACHABLE = "unreachable"
    CLOSED = "closed"  # accepted, and closed at once


@dataclass(frozen=True)
class Attempt:
    """One rate: `heard` is the end of what came; `answer` the text of a reply with a right CRC."""

    baud: int | None  # None over TCP
    outcome: Outcome
    heard: bytes = b""
    answer: str = ""


@dataclass(frozen=True)
class Probe:
    """Everything that was seen of one line."""

    endpoint: Endpoint
    access: Access
    attempts: tuple[Attempt, ...] = ()
    holders: tuple[PortUser, ...] = ()
    reason: str = ""  # the operating system's word, where the line could not be opened

    @property
    def answered(self) -> Attempt | None:
        """The attempt that was answered, if any."""
        return next((attempt for attempt in self.attempts if attempt.outcome is Outcome.ANSWERED), None)

    @property
    def last_bytes(self) -> bytes:
        """The end of what was heard last."""
        return next((attempt.heard for attempt in reversed(self.attempts) if attempt.heard), b"")


class _Line(Protocol):
    def ask(self, patience_s: float) -> bytes: ...


def probe_line(endpoint: Endpoint) -> Probe:
    """Probe a serial or TCP line; never raises for what a line may do. Raises CFG-002 for other endpoints."""
    if endpoint.require("serial", "tcp").scheme == "tcp":
        return _probe_network(endpoint)
    return _probe_serial(endpoint)


def _probe_serial(endpoint: Endpoint) -> Probe:
    import serial

    path = endpoint.path
    if not os.path.exists(path):
        return Probe(endpoint, Access.MISSING)
    holders = users_of_serial_port(path)
    if not os.access(path, os.R_OK | os.W_OK):
        return Probe(endpoint, Access.FORBIDDEN, holders=holders)
    if holders:
        return Probe(endpoint, Access.HELD, holders=holders)
    try:
        port = serial.Serial(path, DEFAULT_BAUD, timeout=0, write_timeout=OPEN_LIMIT_S, exclusive=True)
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        reason = os.strerror(number).lower() if isinstance(number, int) else str(error)
        access = Access.FORBIDDEN if isinstance(error, PermissionError) else Access.HELD
        return Probe(endpoint, access, reason=reason)
    attempts: list[Attempt] = []
    with port:
        for baud in BAUDS:
            attempts.append(_at_rate(port, baud))
            if attempts[-1].outcome in (Outcome.ANSWERED, Outcome.LOST):
                break
    return Probe(endpoint, Access.OPENED, tuple(attempts))


def _at_rate(port: Any, baud: int) -> Attempt:
    import termios

    try:
        port.baudrate = baud
    except (OSError, ValueError, termios.error):
        return Attempt(baud, Outcome.REFUSED)
    patience_s = PATIENCE_S + (len(QUESTION) + ANSWER_BYTES) * BITS_PER_BYTE_ON_LINE / baud
    try:
        return _asked(_SerialLine(port), baud, patience_s)
    except OSError:  # the adapter was pulled out, or the far end is gone
        return Attempt(baud, Outcome.LOST)


def _probe_network(endpoint: Endpoint) -> Probe:
    try:
        peer = socket.create_connection((endpoint.host, endpoint.port), OPEN_LIMIT_S)
    except ConnectionRefusedError as error:
        return Probe(endpoint, Access.REFUSED, reason=str(error.strerror))
    except OSError as error:
        return Probe(endpoint, Access.UNREACHABLE, reason=error.strerror or str(error))
    with peer:
        try:
            attempt = _asked(_NetworkLine(peer), None, TCP_PATIENCE_S)
        except OSError as error:
            return Probe(endpoint, Access.CLOSED, reason=error.strerror or str(error))
    return Probe(endpoint, Access.OPENED, (attempt,))


def _asked(line: _Line, baud: int | None, patience_s: float) -> Attempt:
    heard = b""
    for _ in range(QUESTIONS):
        heard = line.ask(patience_s)
        if (answer := _answer(heard)) is not None:
            return Attempt(baud, Outcome.ANSWERED, heard[-KEPT_BYTES:], answer)
        if not heard:
            return Attempt(baud, Outcome.SILENCE)
    outcome = Outcome.ECHO if QUESTION.rstrip(CR) in heard else Outcome.GARBAGE
    return Attempt(baud, outcome, heard[-KEPT_BYTES:])


def _answer(heard: bytes) -> str | None:
    """The text of the last reply with a right CRC in what was heard; our own question is none."""
    for line in reversed(heard.split(CR)[:-1]):
        for start in range(max(0, len(line) - ANSWER_BYTES), len(line) - ASCII_CRC_DIGITS):
            text, digits = line[start:-ASCII_CRC_DIGITS], line[-ASCII_CRC_DIGITS:]
            if digits == b"%04X" % crc16(text) and not text.startswith(QUESTION_TEXT):
                return text.decode("ascii", "replace")
    return None


class _SerialLine:
    def __init__(self, port: Any) -> None:
        self._port = port

    def ask(self, patience_s: float) -> bytes:
        port = self._port
        port.reset_input_buffer()
        port.write(QUESTION)
        return _listen(port.fileno(), patience_s)


class _NetworkLine:
    def __init__(self, peer: socket.socket) -> None:
        self._peer = peer

    def ask(self, patience_s: float) -> bytes:
        self._peer.sendall(QUESTION)
        return _listen(self._peer.fileno(), patience_s)


def _listen(file: int, patience_s: float) -> bytes:
    """What comes until a whole answer is there, the line is quiet after some bytes, or patience ends."""
    heard = b""
    until_s = time.monotonic() + patience_s
    while (left_s := until_s - time.monotonic()) > 0:
        if not select.select([file], [], [], min(left_s, QUIET_S) if heard.endswith(CR) else left_s)[0]:
            if heard.endswith(CR):
                break
            continue
        data = os.read(file, 4096)
        if not data:
            if heard:
                break
            raise ConnectionResetError("closed by the other side")
        heard = (heard + data)[-4096:]
        if _answer(heard) is not None:
            break
    return heard
