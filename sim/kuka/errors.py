"""Start-up errors of the robot controller; later problems appear as pendant messages."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError


class EthernetFileInvalid(ConfigurationError):
    """The Ethernet file of the RSI link is unusable."""

    code = "KRC-001"
    action = "Correct the file; its form is ROOT > CONFIG, SEND > ELEMENTS, RECEIVE > ELEMENTS."


class ClientAddressInvalid(ConfigurationError):
    """Telegrams cannot be sent to the client's address."""

    code = "KRC-002"
    action = "Give the address where the client listens: --rsi udp://ADDRESS:PORT."


class UnknownParameter(ConfigurationError):
    """The controller parameter does not exist or does not accept the value."""

    code = "KRC-003"
    action = "Give --set NAME=VALUE; ronna-sim kuka --list-parameters lists all names."
