"""The fastest rate of a serial line that both ends and the cable can do."""

from __future__ import annotations

import time
from collections.abc import Callable

from drivers.ndi_polaris.discovery import answers, find_unit, initialise
from drivers.ndi_polaris.errors import LinkLost, NoReply, PortUnavailable, UnitError
from drivers.ndi_polaris.session import Session
from ronna_hw.errors import ProtocolError
from ronna_hw.wire.polaris import COMM_BAUD_CODES, COMM_DEFAULT_ARGUMENT

RATE_SETTLING_S = 0.1  # from OKAY to COMM until the unit listens at the new rate, as other clients wait


def raise_baud(
    session: Session, maximum: int, deadline_s: float, pause: Callable[[float], None] = time.sleep
) -> int | None:
    """Go to the fastest rate that both ends can do, and prove it by a command; None over TCP.

    A unit that is lost at a rate which the cable does not carry is looked for again, if need be by a break,
    and a slower rate tried. Raises NDI-002 or NDI-003 when it is not found any more.
    """
    if session.transport.baud is None:
        return None
    for code, baud in sorted(COMM_BAUD_CODES.items(), key=lambda item: -item[1]):
        if baud > maximum:
            continue
        if baud <= session.transport.baud:
            break
        try:
            if _switch(session, code, baud, session.transport.baud, deadline_s, pause):
                break
        except LinkLost:
            find_unit(session, deadline_s)
            initialise(session, deadline_s)
    return session.transport.baud


def _switch(
    session: Session, code: str, baud: int, present: int, deadline_s: float, pause: Callable[[float], None]
) -> bool:
    try:  # our own end first: a unit that has switched to a rate we cannot do would be lost
        session.transport.set_baud(baud)
        session.transport.set_baud(present)
    except PortUnavailable:
        session.transport.set_baud(present)
        return False
    try:
        session.ask("COMM", code + COMM_DEFAULT_ARGUMENT[1:], deadline_s=deadline_s, retry=False)
    except UnitError:
        return False
    except (ProtocolError, NoReply):
        pass  # the answer was lost: only trying tells whether the unit has switched
    pause(RATE_SETTLING_S)
    session.transport.set_baud(baud)
    if answers(session, deadline_s):
        return True
    session.transport.set_baud(present)
    if not answers(session, deadline_s):
        raise LinkLost(f"the unit answers neither at {baud} baud nor at {present}")
    return False
