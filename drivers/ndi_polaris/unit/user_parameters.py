"""User parameters by GET; the reply must name the parameter requested."""

from __future__ import annotations

from drivers.ndi_polaris.errors import MalformedReply
from drivers.ndi_polaris.line.command_link import CommandLink

PARAMETER_REPLY_BYTES = 256
MOST_DIGITS = 10  # of 32 bits


def read_parameter(link: CommandLink, name: str, deadline_s: float | None) -> str:
    """Value of one parameter; raises NDI-036 if the unit does not have it, NDI-006 for another one."""
    for _ in range(2):
        text = link.ask("GET", name, deadline_s=deadline_s, reply_bytes=PARAMETER_REPLY_BYTES)
        answered, _, value = text.partition("=")
        if answered.endswith(name):  # some firmware prefixes the name with the device
            return value.strip()
        link.distrust()  # a late copy of another reply
    raise MalformedReply(f"GET {name} returned another parameter", wire=text.encode())


def whole_number(value: str) -> int | None:
    """The number that a parameter is; None if it is no whole number of 32 bits."""
    return int(value) if value.isdecimal() and len(value) <= MOST_DIGITS else None
