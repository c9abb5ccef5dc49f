"""The fastest baud rate that both ends and the cable support."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.ndi_polaris.errors import LinkLost, NoReply, PortUnavailable, UnitError
from drivers.ndi_polaris.line.command_link import CommandLink
from drivers.ndi_polaris.line.discovery import find_unit, initialise
from drivers.ndi_polaris.line.inquiry import inquire
from ronna_hw.errors import ProtocolError
from ronna_hw.wire.polaris import COMM_BAUD_CODES, COMM_DEFAULT_ARGUMENT

RATE_SETTLING_S = 0.1  # after OKAY to COMM, as other clients wait for the unit to switch


def raise_baud(
    link: CommandLink, maximum: int, deadline_s: float, pause: Callable[[float], None] = time.sleep
) -> int | None:
    """Switch to the fastest rate that both ends support, verified by a command; None over TCP.

    A unit lost at a rate that the cable does not carry is searched for again, if necessary with a break, and
    a slower rate is tried. Raises NDI-002 or NDI-003 when it cannot be found again.
    """
    if link.transport.baud is None:
        return None
    for code, baud in sorted(COMM_BAUD_CODES.items(), key=lambda item: -item[1]):
        if baud > maximum:
            continue
        if baud <= link.transport.baud:
            break
        try:
            if _switch(link, code, baud, link.transport.baud, deadline_s, pause):
                break
        except LinkLost:
            find_unit(link, deadline_s)
            initialise(link, deadline_s)
    return link.transport.baud


def _switch(
    link: CommandLink, code: str, baud: int, current: int, deadline_s: float, pause: Callable[[float], None]
) -> bool:
    try:  # our own end first: a unit at a rate we do not support would be lost
        link.transport.set_baud(baud)
        link.transport.set_baud(current)
    except PortUnavailable:
        link.transport.set_baud(current)
        return False
    try:
        link.ask("COMM", code + COMM_DEFAULT_ARGUMENT[1:], deadline_s=deadline_s, retry=False)
    except UnitError:
        return False
    except (ProtocolError, NoReply):
        pass  # the reply was lost: only a try shows whether the unit has switched
    pause(RATE_SETTLING_S)
    link.transport.set_baud(baud)
    if inquire(link, deadline_s).answered:
        return True
    link.transport.set_baud(current)
    if not inquire(link, deadline_s).answered:
        raise LinkLost(f"no reply at {baud} baud nor at {current}")
    return False
