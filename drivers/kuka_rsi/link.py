"""Start of the real-time process that answers the controller's telegrams."""

from __future__ import annotations

import errno
import os

from drivers.kuka_rsi.errors import STREAM_ERRORS
from drivers.kuka_rsi.realtime.settings import LinkSettings
from ronna_hw.arm_stream.client import START_TIMEOUT_S, LinkClient, StartRefused, TrafficHandler
from ronna_hw.clock import Clock

PROCESS = "drivers.kuka_rsi.realtime.process"
ADDRESS_ADVICE = (
    "Give endpoint rsi, and the Ethernet file, the address that this computer has in the subnet of the "
    "controller's RSI interface; check that the cable is connected and the interface is up."
)


def start_link(
    settings: LinkSettings,
    timeout_s: float = START_TIMEOUT_S,
    on_traffic: TrafficHandler | None = None,
    clock: Clock | None = None,
) -> LinkClient:
    """Start the real-time process, which listens on the RSI port; raises RSI-001."""
    try:
        return LinkClient(settings, PROCESS, STREAM_ERRORS, timeout_s, on_traffic, clock)
    except StartRefused as refusal:
        known = os.strerror(refusal.errno) if refusal.errno > 0 else "no such address"
        reason = f"cannot listen on udp://{settings.host}:{settings.port}: {known}"
        if refusal.errno <= 0 or refusal.errno == errno.EADDRNOTAVAIL:
            raise STREAM_ERRORS.not_started(
                reason, expected="an address of this computer", action=ADDRESS_ADVICE
            ) from None
        raise STREAM_ERRORS.not_started(reason) from None
