"""State of a tracker's line, below the driver: which rate gets a reply, in bytes, and who else has the port.

The inquiry is the driver's own: every unit of the protocol answers it, and it changes nothing. A unit is
never reset for this, not even with a break; a line that another program has open is left alone. A server that
speaks first, in XML, is left alone too: it is a controller, and takes every byte for a command.
"""

from __future__ import annotations

import errno
import os
import time
from dataclasses import dataclass
from enum import StrEnum

from drivers.ndi_polaris.errors import LinkLost, NotAPolaris, PortUnavailable
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.line.discovery import LIKELY_BAUDS
from drivers.ndi_polaris.line.inquiry import INQUIRY, inquire
from drivers.ndi_polaris.line.transport import open_transport
from ronna_hw.endpoints import Endpoint
from ronna_hw.host.port_users import PortUser, clients_of_tcp_port, users_of_serial_port
from ronna_hw.wire.polaris import COMM_BAUD_CODES, CR

# The driver reaches rates outside its list with a break, which a probe must not send.
BAUDS = (*LIKELY_BAUDS, *sorted(set(COMM_BAUD_CODES.values()) - set(LIKELY_BAUDS)))
OPEN_LIMIT_S = 2.0
INQUIRY_LIMIT_S = 1.0  # for one rate, or for the connection
SPEAKS_FIRST_S = 0.5  # host time; our EKI program sends its state every 0.1 s
KEPT_BYTES = 32


class Opening(StrEnum):
    """Whether the line could be opened."""

    OPENED = "opened"
    MISSING = "missing"
    FORBIDDEN = "forbidden"
    HELD = "held"
    REFUSED = "refused"  # nothing listens
    UNREACHABLE = "unreachable"
    CLOSED = "closed"  # accepted, and closed at once


class Outcome(StrEnum):
    """Outcome of an inquiry at one rate."""

    ANSWERED = "answered"
    GARBAGE = "garbage"
    ECHO = "echo"
    SILENCE = "silence"
    REFUSED = "rate refused"  # by this computer's adapter
    LOST = "line lost"


@dataclass(frozen=True)
class Attempt:
    """One rate: `heard` is the end of what was received; `reply` the text of a reply with a valid CRC."""

    baud: int | None  # None over TCP
    outcome: Outcome
    heard: bytes = b""
    reply: str = ""


@dataclass(frozen=True)
class LineState:
    """Everything observed on one line."""

    endpoint: Endpoint
    opening: Opening
    attempts: tuple[Attempt, ...] = ()
    users: tuple[PortUser, ...] = ()
    refusal: PortUnavailable | None = None  # if the line could not be opened

    @property
    def answered(self) -> Attempt | None:
        """The attempt that was answered, if any."""
        return next((attempt for attempt in self.attempts if attempt.outcome is Outcome.ANSWERED), None)

    @property
    def last_bytes(self) -> bytes:
        """The end of what was received last."""
        return next((attempt.heard for attempt in reversed(self.attempts) if attempt.heard), b"")


_OPENING_BY_ERROR = {
    errno.EACCES: Opening.FORBIDDEN,
    errno.EAGAIN: Opening.HELD,
    errno.EBUSY: Opening.HELD,
    errno.ECONNREFUSED: Opening.REFUSED,
}


def look_at_line(endpoint: Endpoint) -> LineState:
    """Check a serial or TCP line; never raises, whatever the line does. Raises CFG-002 for others."""
    if endpoint.require("serial", "tcp").scheme == "serial":
        if not os.path.exists(endpoint.path):
            return LineState(endpoint, Opening.MISSING)
        users = users_of_serial_port(endpoint.path)
        if not os.access(endpoint.path, os.R_OK | os.W_OK):
            return LineState(endpoint, Opening.FORBIDDEN, users=users)
        if users:
            return LineState(endpoint, Opening.HELD, users=users)
    elif users := clients_of_tcp_port(endpoint.host, endpoint.port):  # a second client may disturb theirs
        return LineState(endpoint, Opening.HELD, users=users)
    try:
        transport = open_transport(endpoint, OPEN_LIMIT_S)
    except PortUnavailable as error:
        opening = _OPENING_BY_ERROR.get(error.number or 0, Opening.UNREACHABLE)
        return LineState(endpoint, opening, refusal=error)
    try:
        attempts = _attempts(CommandLink(transport))
    finally:
        transport.close()
    closed = endpoint.scheme == "tcp" and attempts[-1].outcome is Outcome.LOST
    return LineState(endpoint, Opening.CLOSED if closed else Opening.OPENED, () if closed else attempts)


def _attempts(link: CommandLink) -> tuple[Attempt, ...]:
    attempts: list[Attempt] = []
    for baud in BAUDS if link.transport.baud is not None else (None,):
        attempts.append(_at_rate(link, baud))
        if attempts[-1].outcome in (Outcome.ANSWERED, Outcome.LOST):
            break
    return tuple(attempts)


def _at_rate(link: CommandLink, baud: int | None) -> Attempt:
    try:
        if baud is not None:
            link.transport.set_baud(baud)
        elif (first := link.transport.read(SPEAKS_FIRST_S)).startswith(b"<"):
            return Attempt(baud, Outcome.GARBAGE, first[-KEPT_BYTES:])
        heard, reply = inquire(link, time.monotonic() + INQUIRY_LIMIT_S)
    except PortUnavailable:
        return Attempt(baud, Outcome.REFUSED)
    except LinkLost:
        return Attempt(baud, Outcome.LOST)
    except NotAPolaris as error:
        return Attempt(baud, Outcome.GARBAGE, error.wire[-KEPT_BYTES:])
    if reply is not None:
        outcome = Outcome.ANSWERED
    elif INQUIRY.rstrip(CR) in heard:
        outcome = Outcome.ECHO
    else:
        outcome = Outcome.GARBAGE if heard else Outcome.SILENCE
    return Attempt(baud, outcome, heard[-KEPT_BYTES:], reply or "")
