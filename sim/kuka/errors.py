"""Start-up errors of the robot controller; later problems appear as pendant messages."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError, ErrorCode

ETHERNET_FILE_INVALID = ErrorCode(
    "KRC-001",
    ConfigurationError,
    "The Ethernet file of the RSI link is unusable.",
    "Correct the file; its form is ROOT > CONFIG, SEND > ELEMENTS, RECEIVE > ELEMENTS.",
)


CLIENT_ADDRESS_INVALID = ErrorCode(
    "KRC-002",
    ConfigurationError,
    "Telegrams cannot be sent to the client's address.",
    "Give the address where the client listens: --rsi udp://ADDRESS:PORT.",
)


UNKNOWN_PARAMETER = ErrorCode(
    "KRC-003",
    ConfigurationError,
    "The controller parameter does not exist or does not accept the value.",
    "Give --set NAME=VALUE; ronna-sim kuka --list-parameters lists all names.",
)
