"""Probe a line for a unit with a command that changes nothing, keeping every byte received."""

from __future__ import annotations

import math
from typing import NamedTuple

from drivers.ndi_polaris.errors import MalformedReply, NotAPolaris
from drivers.ndi_polaris.line.codec import encode_command, trailing_text
from drivers.ndi_polaris.line.command_link import LONGEST_REPLY_BYTES, CommandLink
from ronna_hw.wire.polaris import BITS_PER_BYTE_ON_LINE, COMMAND_TIMEOUT_S, CR

INQUIRY_COMMAND = "APIREV"  # every unit replies to it in some way
INQUIRY = encode_command(INQUIRY_COMMAND)
REPLY_BYTES = 32
REPLY_LIMIT_S = 0.3  # per rate: an idle unit replies within a few milliseconds
TRIES = 2  # the first command may be garbled by the remains of an earlier one


class Inquiry(NamedTuple):
    """All bytes received, and the text of a reply with a valid CRC, if any."""

    heard: bytes
    reply: str | None = None

    @property
    def answered(self) -> bool:
        return self.reply is not None


def inquire(link: CommandLink, deadline_s: float) -> Inquiry:
    """Ask at the current rate, twice if the first reply is garbled.

    Raises NDI-003 when the line never falls silent, NDI-008 when it is lost.
    """
    heard = b""
    for _ in range(TRIES):
        inquiry = _inquire_once(link, deadline_s)
        heard = inquiry.heard or heard
        if inquiry.answered or not inquiry.heard:
            return Inquiry(heard, inquiry.reply)
    return Inquiry(heard)


def _inquire_once(link: CommandLink, deadline_s: float) -> Inquiry:
    transport = link.transport
    try:
        link.drain(deadline_s=min(deadline_s, link.now_s() + REPLY_LIMIT_S))
    except MalformedReply as error:
        raise NotAPolaris("the line sends unsolicited data continuously", wire=error.wire) from error
    transfer_s = (len(INQUIRY) + REPLY_BYTES) * BITS_PER_BYTE_ON_LINE / (transport.baud or math.inf)
    rest_s = REPLY_LIMIT_S + transfer_s  # a reply that has begun is complete after this
    # over TCP there is no other rate to try: wait the full time limit
    limit_s = rest_s if transport.baud is not None else COMMAND_TIMEOUT_S[INQUIRY_COMMAND]
    transport.write(INQUIRY)
    until_s = min(deadline_s, link.now_s() + limit_s)
    heard = b""
    while (left_s := until_s - link.now_s()) > 0:
        if not (data := transport.read(left_s)):
            continue
        if not heard:
            until_s = min(until_s, link.now_s() + rest_s)
        heard = (heard + data)[-LONGEST_REPLY_BYTES:]
        if (reply := _last_reply(heard)) is not None:
            return Inquiry(heard, reply)
    return Inquiry(heard)


def _last_reply(heard: bytes) -> str | None:
    """The text of the last reply with a valid CRC; our own command from a loop-back does not count."""
    echo = f"{INQUIRY_COMMAND}:"
    texts = (trailing_text(line) for line in reversed(heard.split(CR)[:-1]))
    return next((text for text in texts if text and text != echo), None)
