"""Time limit of each command, read from the unit."""

from __future__ import annotations

import math

from drivers.ndi_polaris.errors import UnitError
from drivers.ndi_polaris.line.command_link import CommandLink
from ronna_hw.wire.polaris import COMMAND_TIMEOUT_S, LF, PARAMETER_TIMEOUT_PREFIX

REPLY_BYTES = 2048  # about sixty lines of thirty characters
LONGEST_BELIEVED_S = 60.0  # no command takes longer; a longer limit would only hide a dead link


def read_time_limits(link: CommandLink, deadline_s: float) -> dict[str, float]:
    """The unit's time limits in seconds by command; empty when it has none to report."""
    try:
        text = link.ask("GET", f"{PARAMETER_TIMEOUT_PREFIX}*", deadline_s=deadline_s, reply_bytes=REPLY_BYTES)
    except UnitError:
        return {}
    limits_s = {}
    for line in text.split(LF):
        parameter, _, value = line.partition("=")
        _, found, command = parameter.rpartition(PARAMETER_TIMEOUT_PREFIX)
        limit_s = _seconds(value)
        if found and command in COMMAND_TIMEOUT_S and 0.0 < limit_s <= LONGEST_BELIEVED_S:
            limits_s[command] = limit_s
    return limits_s


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
