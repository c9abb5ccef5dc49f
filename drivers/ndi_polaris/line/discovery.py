"""Finds a unit on a line, at its power-up rate or another, if necessary with a break; then INIT."""

from __future__ import annotations

from drivers.ndi_polaris.errors import NotAPolaris, NothingAnswers, PortUnavailable, UnitError
from drivers.ndi_polaris.line.codec import encode_command
from drivers.ndi_polaris.line.command_link import RESET_TEXT, CommandLink
from drivers.ndi_polaris.line.inquiry import INQUIRY_COMMAND, inquire
from ronna_hw.errors import LinkTimeout, ProtocolError
from ronna_hw.wire.polaris import DEFAULT_BAUD

RESET_LIMIT_S = 7.0  # from a break to RESET: the longest wait of any client
# Rates at which a unit may have been left, likeliest first.
LIKELY_BAUDS = (DEFAULT_BAUD, 115200, 921600, 230400, 57600, 38400, 19200, 14400)


def find_unit(link: CommandLink, deadline_s: float) -> None:
    """Set the line to a rate at which the unit replies.

    Raises NDI-002 when nothing replies, NDI-003 when what replies is not a Polaris unit.
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
        except PortUnavailable:  # this adapter does not support that rate
            continue
        tried.append(f"{baud} baud" if transport.baud is not None else "the connection")
        inquiry = inquire(link, deadline_s)
        heard += inquiry.heard
        if inquiry.answered:
            return
    if transport.baud is not None and link.now_s() < deadline_s:
        transport.set_baud(DEFAULT_BAUD)
        transport.send_break()
        tried.append("a break")
        if await_reset(link, deadline_s):
            return
        inquiry = inquire(link, deadline_s)
        heard += inquiry.heard
        if inquiry.answered:
            return
    if heard:
        raise NotAPolaris("bytes without a valid CRC", wire=bytes(heard))
    what = ", ".join(tried) or "none: the time limit is too short"
    raise NothingAnswers(f"no unit replied; tried {what}", expected=f"a reply to {INQUIRY_COMMAND}")


def await_reset(link: CommandLink, deadline_s: float) -> bool:
    """Whether the unit sends RESET in time after a break or the RESET command."""
    until_s = min(deadline_s, link.now_s() + RESET_LIMIT_S)
    heard = b""
    while (left_s := until_s - link.now_s()) > 0:
        heard = heard[-len(RESET_TEXT) :] + link.transport.read(left_s)
        if RESET_TEXT in heard:
            return True
    return False


def initialise(link: CommandLink, deadline_s: float) -> None:
    """INIT; if the unit cannot, RESET it once and try again. Raises NDI-03x, NDI-005 to NDI-008."""
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
