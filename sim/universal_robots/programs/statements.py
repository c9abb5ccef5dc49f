"""Single statements of URScript that need no interpreter: outputs, tool, payload, texts, motions to numbers.

A program with any other statement does not run, as one that a controller cannot compile.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from sim.universal_robots.kinematics import frame_of_pose
from sim.universal_robots.programs.motions import movej, movel, stopj
from sim.universal_robots.programs.program import ScriptPlace
from sim.universal_robots.robot import COMMANDED_STOP, Robot
from sim.universal_robots.variables import DIGITAL_OUTPUTS

_CALL = re.compile(r"^\s*(\w+)\((.*)\)\s*$")
# Whatever a client sends, each pattern looks at a character a bounded number of times.
_VECTOR = re.compile(r"[^\[]*?(p?)\[([^\]]*)\]")  # matched from the start: only the first bracket counts
_NUMBER = re.compile(r"(?:(?<!\w)(\w++)\s*+=\s*+)?([-+]?[0-9.]++(?:[eE][-+]?[0-9]++)?|True|False)")
FIRST_OUTPUT: Final = {  # bit of output 0
    "set_digital_out": 0,
    "set_standard_digital_out": 0,
    "set_configurable_digital_out": 8,
    "set_tool_digital_out": 16,
}
OUTPUTS_OF_A_GROUP: Final = 8
JOINT_DEFAULTS: Final = (1.05, 1.4)  # v (rad/s), a (rad/s2) of movej
LINE_DEFAULTS: Final = (0.25, 1.2)  # v (m/s), a (m/s2) of movel
STOP_DEFAULT: Final = 2.0
MOST_TOLD: Final = 100  # texts in a cycle (U)
NOT_AT_ONCE: Final = ("move", "servo", "speed", "stop", "sleep")  # begin what takes time
LOADS: Final = ("set_payload", "set_target_payload")  # inertia and transition time are ignored (U)
MOTIONS: Final = ("movej", "movel")
STOPS: Final = ("stopj", "stopl")
SINGLE: Final = frozenset({*STOPS, *LOADS, "set_tcp", "sync", "textmsg", "protective_stop"})
# What a controller says of a name that it does not know, and of a line that it cannot read (U).
NAME_NOT_FOUND, SYNTAX_ERROR = "compile_error_name_not_found:{}:", "syntax_error_on_line:{}:{}"
NO_INVERSE: Final = "get_inverse_kin: no solution"
_FRAME = re.compile(r"^\s*(?:(?:def|sec)\s+\w+\s*\(\s*\)\s*:|end|halt)?\s*$")
_TEXT = re.compile(r'"([^"]*)"')


class UnknownStatement(ValueError):
    """A statement that is not carried out, with its place."""

    def __init__(self, text: str, place: ScriptPlace) -> None:
        super().__init__(text)
        self.place = place


class _Arguments(NamedTuple):
    """Numbers of a call: its first vector, and the others."""

    vector: list[float]
    is_pose: bool
    plain: list[float]
    named: dict[str, float]


def require_known(text: str) -> None:
    """Raise `UnknownStatement` for the first line of a script that would not be carried out."""
    for number, line in enumerate(text.splitlines(), start=1):
        code = line.partition("#")[0]
        call = _CALL.match(code)
        place = ScriptPlace(number, len(code) - len(code.lstrip()) + 1)
        if call is None:
            if not _FRAME.match(code):
                raise UnknownStatement(SYNTAX_ERROR.format(number, code.strip()), place)
        elif not _is_known(call[1], _read_arguments(call[2])):
            raise UnknownStatement(NAME_NOT_FOUND.format(call[1]), place)


def _is_known(name: str, given: _Arguments) -> bool:
    """Return whether a call is carried out with these arguments."""
    if name in MOTIONS:
        return len(given.vector) == 6
    if name in FIRST_OUTPUT:
        return len(given.plain) == 2
    return name in SINGLE or (name == "sleep" and len(given.plain) == 1)


def run_statements(robot: Robot, text: str) -> Iterator[None]:
    """Carry out the statements of a script that are known, in order; the others do nothing."""
    for line in text.splitlines():
        call = _CALL.match(line.partition("#")[0])
        if call:
            yield from _call(robot, call[1], call[2])
    if not robot.stop_request:  # else it has ended before the stop could pause it
        yield


def run_at_once(robot: Robot, text: str) -> None:
    """Carry out the statements of a secondary program, which may not move the arm."""
    for line in text.splitlines():
        call = _CALL.match(line.partition("#")[0])
        if call and not call[1].startswith(NOT_AT_ONCE):
            for _ in _call(robot, call[1], call[2]):
                pass


def _call(robot: Robot, name: str, arguments: str) -> Iterator[None]:
    vector, is_pose, plain, named = _read_arguments(arguments)
    if name in FIRST_OUTPUT and len(plain) == 2:
        number = int(plain[0])
        if not 0 <= number < OUTPUTS_OF_A_GROUP:
            return
        bit = 1 << FIRST_OUTPUT[name] + number
        bits = robot.values[DIGITAL_OUTPUTS]
        robot.values[DIGITAL_OUTPUTS] = bits | bit if plain[1] else bits & ~bit
    elif name == "set_tcp" and len(vector) == 6:
        robot.set_tcp(vector)
    elif name in LOADS and plain:
        robot.set_payload(plain[0], vector or None)
    elif name in MOTIONS and len(vector) == 6:
        speed, acceleration = JOINT_DEFAULTS if name == "movej" else LINE_DEFAULTS
        speed, acceleration = named.get("v", speed), named.get("a", acceleration)
        if name == "movel":
            pose = vector if is_pose else robot.tool_pose(vector)
            yield from movel(robot, pose, speed, acceleration)
        else:
            yield from movej(robot, _joints_at(robot, vector) if is_pose else vector, speed, acceleration)
    elif name in STOPS:
        yield from stopj(robot, plain[0] if plain else STOP_DEFAULT)
    elif name == "sleep" and plain:
        for _ in range(round(plain[0] / robot.cycle_s)):
            yield
    elif name == "textmsg" and len(robot.told) < MOST_TOLD:
        robot.told.append("".join(_TEXT.findall(arguments)))
    elif name == "protective_stop":
        robot.stop_request = COMMANDED_STOP


def _joints_at(robot: Robot, pose: list[float]) -> list[float]:
    joints = robot.joints_at(frame_of_pose(pose), robot.drives.target)
    if joints is None:
        raise ValueError(NO_INVERSE)
    return joints


def _read_arguments(arguments: str) -> _Arguments:
    vector = _VECTOR.match(arguments)
    numbers = [float(number) for number in vector[2].split(",")] if vector and _is_numeric(vector[2]) else []
    rest = arguments[: vector.start(1)] + arguments[vector.end() :] if vector else arguments
    named: dict[str, float] = {}
    plain: list[float] = []
    for key, word in _NUMBER.findall(rest):
        value = float(word == "True") if word in ("True", "False") else float(word)
        if key:
            named[key] = value
        else:
            plain.append(value)
    return _Arguments(numbers, bool(vector and vector[1]), plain, named)


def _is_numeric(text: str) -> bool:
    try:
        return bool([float(number) for number in text.split(",")])
    except ValueError:
        return False
