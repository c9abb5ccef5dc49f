"""Unit discovery on a line, initialisation, and choice of baud rate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple

from drivers.ndi_polaris.command_link import (
    LONGEST_REPLY_BYTES,
    RESET_TEXT,
    CommandLink,
    encode_command,
    trailing_text,
)
from drivers.ndi_polaris.errors import (
    NOTHING_ANSWERS,
    LinkLost,
    MalformedReply,
    NoReply,
    NotAPolaris,
    PortUnavailable,
    UnitError,
)
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.wire import polaris as ndi

INQUIRY_COMMAND = "APIREV"  # every unit replies to it in some way
INQUIRY = encode_command(INQUIRY_COMMAND)
REPLY_BYTES = 32
REPLY_LIMIT_S = 0.3  # per rate: an idle unit replies within a few milliseconds
TRIES = 2  # the first command may be garbled by the remains of an earlier one
RESET_LIMIT_S = 7.0  # from a break to RESET: the longest wait of any client
# Rates at which a unit may have been left, likeliest first.
LIKELY_BAUDS = (ndi.DEFAULT_BAUD, 115200, 921600, 230400, 57600, 38400, 19200, 14400)
RATE_SETTLING_S = 0.1  # after OKAY to COMM, as other clients wait for the unit to switch


def find_unit(link: CommandLink) -> None:
    """Find the unit's baud rate and switch the line to it.

    Raises NDI-002 without any reply, NDI-003 when the device is not a Polaris unit.
    """
    transport = link.transport
    heard = bytearray()
    tried = []
    bauds = LIKELY_BAUDS if transport.baud is not None else (ndi.DEFAULT_BAUD,)
    for baud in bauds:
        if link.monotonic() >= link.deadline_s:
            break
        try:
            transport.set_baud(baud)
        except PortUnavailable:  # this adapter does not support that rate
            continue
        tried.append(f"{baud} baud" if transport.baud is not None else "the connection")
        inquiry = inquire(link)
        heard += inquiry.heard
        if inquiry.reply is not None:
            return
    if transport.baud is not None and link.monotonic() < link.deadline_s:
        transport.set_baud(ndi.DEFAULT_BAUD)
        transport.send_break()
        tried.append("a break")
        if await_reset(link):
            return
        inquiry = inquire(link)
        heard += inquiry.heard
        if inquiry.reply is not None:
            return
    if heard:
        raise NotAPolaris("bytes without a valid CRC", wire=bytes(heard))
    tried_text = ", ".join(tried) or "none: the time limit is too short"
    raise NOTHING_ANSWERS(f"no unit replied; tried {tried_text}", expected=f"a reply to {INQUIRY_COMMAND}")


def initialise(link: CommandLink) -> None:
    """Initialise the unit, with one RESET if INIT fails; raises NDI-03x, NDI-005 to NDI-008."""
    try:
        link.ask("INIT")
    except (UnitError, LinkTimeout, ProtocolError):
        if link.monotonic() >= link.deadline_s:
            raise
        link.transport.write(encode_command("RESET", "0"))
        if link.transport.baud is not None:
            link.transport.set_baud(ndi.DEFAULT_BAUD)
        await_reset(link)
        link.drain(until_s=link.deadline_s)
        link.ask("INIT")


def await_reset(link: CommandLink) -> bool:
    """Return whether the unit sends RESET in time, after a break or the RESET command."""
    until_s = min(link.deadline_s, link.monotonic() + RESET_LIMIT_S)
    heard = b""
    while (remaining_s := until_s - link.monotonic()) > 0:
        heard = heard[-len(RESET_TEXT) :] + link.transport.read(remaining_s)
        if RESET_TEXT in heard:
            return True
    return False


def raise_baud(link: CommandLink, maximum: int, pause: Callable[[float], None] = time.sleep) -> int | None:
    """Switch to the fastest baud rate that works and return it; None over TCP.

    If the cable does not carry a rate, the unit is searched for again, if necessary with a break. Then a
    slower rate is tried. Raises NDI-002 or NDI-003 when the unit cannot be found again.
    """
    if link.transport.baud is None:
        return None
    for code, baud in sorted(ndi.COMM_BAUD_CODES.items(), key=lambda item: -item[1]):
        if baud > maximum:
            continue
        if baud <= link.transport.baud:
            break
        try:
            if _switch_rate(link, code, baud, link.transport.baud, pause):
                break
        except LinkLost:
            find_unit(link)
            initialise(link)
    return link.transport.baud


def _switch_rate(
    link: CommandLink, code: str, baud: int, current: int, pause: Callable[[float], None]
) -> bool:
    try:  # our own end first: a unit at a rate we do not support would be lost
        link.transport.set_baud(baud)
        link.transport.set_baud(current)
    except PortUnavailable:
        link.transport.set_baud(current)
        return False
    try:
        link.ask("COMM", code + ndi.COMM_DEFAULT_ARGUMENT[1:], retry=False)
    except UnitError:
        return False
    except (ProtocolError, NoReply):
        pass  # the reply was lost: only a try shows whether the unit has switched
    pause(RATE_SETTLING_S)
    link.transport.set_baud(baud)
    if inquire(link).reply is not None:
        return True
    link.transport.set_baud(current)
    if inquire(link).reply is None:
        raise LinkLost(f"no reply at {baud} baud nor at {current}")
    return False


class Inquiry(NamedTuple):
    """Received bytes, with the text of a valid reply, if any."""

    heard: bytes
    reply: str | None = None


def inquire(link: CommandLink) -> Inquiry:
    """Send a command without side effects, repeated if the reply is garbled.

    Raises NDI-003 when the line never falls silent, NDI-008 when it is lost.
    """
    heard = b""
    for _ in range(TRIES):
        inquiry = _inquire_once(link)
        heard = inquiry.heard or heard
        if inquiry.reply is not None or not inquiry.heard:
            return Inquiry(heard, inquiry.reply)
    return Inquiry(heard)


def _inquire_once(link: CommandLink) -> Inquiry:
    transport = link.transport
    try:
        link.drain(until_s=min(link.deadline_s, link.monotonic() + REPLY_LIMIT_S))
    except MalformedReply as error:
        raise NotAPolaris("the line sends unsolicited data continuously", wire=error.wire) from error
    transfer_s = (len(INQUIRY) + REPLY_BYTES) * ndi.BITS_PER_BYTE_ON_LINE / (transport.baud or math.inf)
    rest_s = REPLY_LIMIT_S + transfer_s  # a reply that has begun is complete after this
    # over TCP there is no other rate to try: wait the full time limit
    limit_s = rest_s if transport.baud is not None else ndi.COMMAND_TIMEOUT_S[INQUIRY_COMMAND]
    transport.write(INQUIRY)
    until_s = min(link.deadline_s, link.monotonic() + limit_s)
    heard = b""
    while (remaining_s := until_s - link.monotonic()) > 0:
        if not (data := transport.read(remaining_s)):
            continue
        if not heard:
            until_s = min(until_s, link.monotonic() + rest_s)
        heard = (heard + data)[-LONGEST_REPLY_BYTES:]
        if (reply := _find_last_reply(heard)) is not None:
            return Inquiry(heard, reply)
    return Inquiry(heard)


def _find_last_reply(heard: bytes) -> str | None:
    """Return the text of the last valid reply, ignoring loop-back of our own command."""
    echo = f"{INQUIRY_COMMAND}:"
    texts = (trailing_text(line) for line in reversed(heard.split(ndi.CR)[:-1]))
    return next((text for text in texts if text and text != echo), None)
