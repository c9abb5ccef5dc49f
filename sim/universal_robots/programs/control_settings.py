"""Settings of External Control, read from the text of its script.

The script is recognised by the connections that it opens; it is not interpreted. Its constants are read, and
which of two statements are in it: one that shows the time of a spline, and one that reports a cancellation.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

from sim.universal_robots.model import JOINTS

TRAJECTORY, SCRIPT_COMMANDS, REVERSE = "trajectory_socket", "script_command_socket", "reverse_socket"
MILLISECONDS: Final = 1000.0
LEAST_LAG_S: Final = 0.03  # of servoj
MOST_NUMBERS: Final = 64  # in one message
LEAST_COMMAND_NUMBERS: Final = 7

_DIALS = re.compile(r'\(\s*"([^"\s]+)"\s*,\s*(\d+)\s*,\s*"(\w+_socket)"')
_CONSTANT = re.compile(r"^\s*+(?:global\s+)?(\w+)\s*=\s*(-?[0-9.]+)\s*$")
_SERVOJ: Final = "servoj("
_LOOKAHEAD = re.compile(r"lookahead_time\s*=\s*([0-9.]+)")
_TIME_OUTPUT = re.compile(
    r"^[^\S\n]*+write_output_float_register\(([0-9]|[1-3][0-9]|4[0-7]),\s*splineTimerTraveled\)", re.MULTILINE
)
_CANCEL_REPORT: Final = "socket_send_int(TRAJECTORY_RESULT_CANCELED"


@dataclass(frozen=True)
class ControlSettings:
    """Constants at the head of the script, and whom it dials."""

    endpoints: dict[str, tuple[str, int]]  # by the name of the socket
    units: float  # of a rad, m, or kg
    time_units: float  # of a second on the trajectory interface
    stop_rad_s2: float
    ignored_rad_s: float  # a step that needs a higher speed is ignored
    reverse_numbers: int
    command_numbers: int
    lookahead_s: float
    time_output: int | None  # double register that shows the time of a spline
    reports_cancelled: bool  # a trajectory that was cancelled


def read_external_control(text: str) -> ControlSettings | None:
    """Return the settings of a script, or None if it is another one."""
    endpoints = {name: (host, int(port)) for host, port, name in _DIALS.findall(text)}
    constants = _read_constants(text)
    units = constants.get("MULT_jointstate", 0.0)
    numbers = int(constants.get("REVERSE_INTERFACE_DATA_DIMENSION", JOINTS + 2))
    if REVERSE not in endpoints or units <= 0.0 or not JOINTS + 2 <= numbers <= MOST_NUMBERS:
        return None
    time_output = _TIME_OUTPUT.search(text)
    commands = int(constants.get("SCRIPT_COMMAND_DATA_DIMENSION", LEAST_COMMAND_NUMBERS))
    return ControlSettings(
        endpoints,
        units,
        constants.get("MULT_time", MILLISECONDS) or MILLISECONDS,
        constants.get("STOPJ_ACCELERATION", 4.0),
        constants.get("JOINT_IGNORE_SPEED", 20.0),
        numbers,
        min(max(commands, LEAST_COMMAND_NUMBERS), MOST_NUMBERS),
        _read_lookahead_s(text),
        None if time_output is None else int(time_output[1]),
        _CANCEL_REPORT in text,
    )


def _read_constants(text: str) -> dict[str, float]:
    found = filter(None, map(_CONSTANT.match, text.splitlines()))
    return {name: float(value) for name, value in map(re.Match.groups, found) if _is_number(value)}


def _read_lookahead_s(text: str) -> float:
    """Return the look-ahead of the first servoj that states one."""
    for line in text.splitlines():
        place = line.find(_SERVOJ)
        found = None if place < 0 else _LOOKAHEAD.search(line, place)
        if found:
            return float(found[1]) if _is_number(found[1]) else LEAST_LAG_S
    return LEAST_LAG_S


def _is_number(text: str) -> bool:
    return text.count(".") < 2 and any(map(str.isdigit, text))
