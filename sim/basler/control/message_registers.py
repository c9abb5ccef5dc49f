"""The standard's registers of the message channel."""

from __future__ import annotations

import socket

from ronna_hw.wire.gige_vision import MCP_PORT_MASK, Bootstrap, GevStatus
from sim.basler.control.registers import Refusal, RegisterMap, Word
from sim.basler.message.channel import MessageChannel

LONGEST_TIMEOUT_MS = 60_000
MOST_RETRIES = 100


def add_message_channel(registers: RegisterMap, channel: MessageChannel) -> None:
    """Add port, destination, time-out, repetitions and source port of one camera's channel."""

    def set_port(value: int) -> None:
        channel.port = value & MCP_PORT_MASK

    def destination() -> int:
        return int.from_bytes(socket.inet_aton(channel.destination), "big")

    def set_destination(value: int) -> None:
        channel.destination = socket.inet_ntoa(value.to_bytes(4, "big"))

    def set_timeout(value: int) -> None:
        channel.timeout_ms = _within(value, LONGEST_TIMEOUT_MS)

    def set_retries(value: int) -> None:
        channel.retries = _within(value, MOST_RETRIES)

    registers.add(Bootstrap.MCP, Word(lambda: channel.port, set_port))
    registers.add(Bootstrap.MCDA, Word(destination, set_destination))
    registers.add(Bootstrap.MCTT_MS, Word(lambda: channel.timeout_ms, set_timeout))
    registers.add(Bootstrap.MCRC, Word(lambda: channel.retries, set_retries))
    registers.add(Bootstrap.MCSP, Word(lambda: channel.source_port))


def _within(value: int, most: int) -> int:
    if value > most:
        raise Refusal(GevStatus.INVALID_PARAMETER)
    return value
