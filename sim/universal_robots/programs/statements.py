"""Single statements of URScript that need no interpreter: outputs, tool, payload, and motions to numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from sim.universal_robots.programs.motions import movej, movel, stopj
from sim.universal_robots.robot import Robot
from sim.universal_robots.variables import DIGITAL_OUTPUTS

_CALL = re.compile(r"^\s*(\w+)\((.*)\)\s*$")
_VECTOR = re.compile(r"(p?)\[([^\]]*)\]")
_NUMBER = re.compile(r"(?:(\w+)\s*=\s*)?([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?|True|False)")
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


def run_statements(robot: Robot, text: str) -> Iterator[None]:
    """Carry out the statements of a script that are known, in order; the others do nothing."""
    for line in text.splitlines():
        call = _CALL.match(line.partition("#")[0])
        if call:
            yield from _call(robot, call[1], call[2])
    yield


def run_at_once(robot: Robot, text: str) -> None:
    """Carry out the statements of a secondary program, which may not move the arm."""
    for line in text.splitlines():
        call = _CALL.match(line.partition("#")[0])
        if call and not call[1].startswith(("move", "servo", "speed", "stop")):
            for _ in _call(robot, call[1], call[2]):
                pass


def _call(robot: Robot, name: str, arguments: str) -> Iterator[None]:
    vector = _VECTOR.search(arguments)
    vectors = [float(number) for number in vector[2].split(",")] if vector and _is_numeric(vector[2]) else []
    rest = arguments[: vector.start()] + arguments[vector.end() :] if vector else arguments
    named: dict[str, float] = {}
    plain: list[float] = []
    for key, word in _NUMBER.findall(rest):
        value = float(word == "True") if word in ("True", "False") else float(word)
        if key:
            named[key] = value
        else:
            plain.append(value)
    if name in FIRST_OUTPUT and len(plain) == 2:
        number = int(plain[0])
        if not 0 <= number < OUTPUTS_OF_A_GROUP:
            return
        bit = 1 << FIRST_OUTPUT[name] + number
        bits = robot.values[DIGITAL_OUTPUTS]
        robot.values[DIGITAL_OUTPUTS] = bits | bit if plain[1] else bits & ~bit
    elif name == "set_tcp" and len(vectors) == 6:
        robot.set_tcp(vectors)
    elif name == "set_payload" and plain:
        robot.set_payload(plain[0], vectors or None)
    elif name in ("movej", "movel") and len(vectors) == 6:
        speed, acceleration = JOINT_DEFAULTS if name == "movej" else LINE_DEFAULTS
        speed, acceleration = named.get("v", speed), named.get("a", acceleration)
        is_pose = bool(vector and vector[1])
        if name == "movel":
            pose = vectors if is_pose else robot.tool_pose(vectors)
            yield from movel(robot, pose, speed, acceleration)
        elif not is_pose:
            yield from movej(robot, vectors, speed, acceleration)
    elif name in ("stopj", "stopl"):
        yield from stopj(robot, plain[0] if plain else STOP_DEFAULT)


def _is_numeric(text: str) -> bool:
    try:
        return bool([float(number) for number in text.split(",")])
    except ValueError:
        return False
