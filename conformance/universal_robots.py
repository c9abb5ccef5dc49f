"""Simulator for the suite of a Universal Robots arm; it has no cases of its wire protocol."""

from __future__ import annotations

from conformance.protocol import ProtocolCases
from ronna_hw.host.network import own_address


def simulator() -> tuple[str, ...]:
    """Return the `ronna-sim` arguments for a controller that waits for the driver, however busy the host."""
    return ("ur", "--lock-step", "--address", own_address())


PROTOCOL = ProtocolCases(simulator=simulator)
