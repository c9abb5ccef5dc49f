"""Find a unit on a line: at power-up's rate or the one it was left at, by a break if need be; then INIT."""

from __future__ import annotations

import math

from drivers.ndi_polaris.errors import (
    MalformedReply,
    NotAPolaris,
    NothingAnswers,
    PortUnavailable,
    UnitError,
)
from drivers.ndi_polaris.line.codec import encode_command, trailing_text
from drivers.ndi_polaris.line.command_link import LONGEST_REPLY_BYTES, RESET_TEXT, CommandLink
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.wire.polaris import BITS_PER_BYTE_ON_LINE, COMMAND_TIMEOUT_S, CR, DEFAULT_BAUD

PROBE_LIMIT_S = 0.3  # per rate: an idle unit answers a harmless command in a few milliseconds
PROBES = 2  # the first command may be spoilt by what the unit still holds of an earlier one
RESET_LIMIT_S = 7.0  # from a break to the unit's RESET, the longest that any client waits
PROBE_COMMAND = "APIREV"  # has no effect, and every unit answers it in some way
PROBE_REPLY_BYTES = 32
# Rates a unit may have been left at, the likeliest first.
LIKELY_BAUDS = (DEFAULT_BAUD, 115200, 921600, 230400, 57600, 38400, 19200, 14400)


def find_unit(link: CommandLink, deadline_s: float) -> None:
    """Leave the line at a rate at which the unit answers.

    Raises NDI-002 when nothing answers, NDI-003 when what answers is no Polaris unit.
    """
    transport = link.transport
    heard = bytearray()
    tried = []
    bauds = LIKELY_BAUDS if transport.baud is not None else (DEFAULT_BAUD,)
    for baud in bauds:
        if link.now_s() >= deadline_s:
            break
        try:
            transport.set_baud(baud)
        except PortUnavailable:  # this adapter cannot do that rate
            continue
        tried.append(f"{baud} baud" if transport.baud is not None else "the connection")
        if answers(link, deadline_s, heard):
            return
    if transport.baud is not None and link.now_s() < deadline_s:
        transport.set_baud(DEFAULT_BAUD)
        transport.send_break()
        tried.append("a break")
        if await_reset(link, deadline_s) or answers(link, deadline_s, heard):
            return
    if heard:
        raise NotAPolaris("something answers, but with no valid CRC", wire=bytes(heard))
    what = ", ".join(tried) or "nothing: the time limit is too short"
    raise NothingAnswers(f"no unit answers: tried {what}", awaited=f"a reply to {PROBE_COMMAND}")


def answers(link: CommandLink, deadline_s: float, heard: bytearray | None = None) -> bool:
    """True when a unit answers at the present rate; bytes that came are added to `heard`."""
    for _ in range(PROBES):
        answered, came = _probe(link, deadline_s)
        if heard is not None:
            heard += came
        if answered or not came:
            return answered
    return False


def await_reset(link: CommandLink, deadline_s: float) -> bool:
    """True when the unit says RESET within its time after a break or the RESET command."""
    until_s = min(deadline_s, link.now_s() + RESET_LIMIT_S)
    heard = b""
    while (left_s := until_s - link.now_s()) > 0:
        heard += link.transport.read(left_s)
        if RESET_TEXT in heard:
            return True
    return False


def initialise(link: CommandLink, deadline_s: float) -> None:
    """INIT; when the unit cannot, RESET it once and try again. Raises NDI-03x, NDI-005 to NDI-008."""
    try:
        link.ask("INIT", deadline_s=deadline_s)
    except (UnitError, LinkTimeout, ProtocolError):
        if link.now_s() >= deadline_s:
            raise
        link.transport.write(encode_command("RESET", "0"))
        if link.transport.baud is not None:
            link.transport.set_baud(DEFAULT_BAUD)
        await_reset(link, deadline_s)
        link.drain(deadline_s=deadline_s)
        link.ask("INIT", deadline_s=deadline_s)


def _probe(link: CommandLink, deadline_s: float) -> tuple[bool, bytes]:
    """(a reply with a valid CRC came, the last bytes heard); raises NDI-003 when the line does not stop."""
    transport = link.transport
    try:
        link.drain(deadline_s=min(deadline_s, link.now_s() + PROBE_LIMIT_S))
    except MalformedReply as error:
        raise NotAPolaris("something talks unasked and does not stop talking", wire=error.wire) from error
    command = encode_command(PROBE_COMMAND)
    transfer_s = (len(command) + PROBE_REPLY_BYTES) * BITS_PER_BYTE_ON_LINE / (transport.baud or math.inf)
    rest_s = PROBE_LIMIT_S + transfer_s  # a reply that has begun is whole after this
    # over TCP there is nothing else to try: the unit gets all the time it may take
    limit_s = rest_s if transport.baud is not None else COMMAND_TIMEOUT_S[PROBE_COMMAND]
    transport.write(command)
    until_s = min(deadline_s, link.now_s() + limit_s)
    heard = b""
    while (left_s := until_s - link.now_s()) > 0:
        if not (data := transport.read(left_s)):
            continue
        if not heard:
            until_s = min(until_s, link.now_s() + rest_s)
        heard = (heard + data)[-LONGEST_REPLY_BYTES:]
        if any(trailing_text(line) for line in heard.split(CR)[:-1]):
            return True, heard
    return False, heard
