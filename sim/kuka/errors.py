"""Errors of the robot controller when it is set up. What goes wrong later is a message on its pendant."""

from __future__ import annotations

from ronna_hw.errors import ConfigurationError


class EthernetFileInvalid(ConfigurationError):
    """The Ethernet file of the RSI link cannot be used."""

    code = "KRC-001"
    action = "Correct the file; its form is ROOT > CONFIG, SEND > ELEMENTS, RECEIVE > ELEMENTS."


class ClientAddressInvalid(ConfigurationError):
    """Telegrams cannot be sent to the address of the client."""

    code = "KRC-002"
    action = "Say where the client listens with --rsi udp://ADDRESS:PORT."


class UnknownParameter(ConfigurationError):
    """A parameter of the controller that is not there, or that cannot have this value."""

    code = "KRC-003"
    action = "Give --set NAME=VALUE; ronna-sim kuka --list-parameters tells all names."
