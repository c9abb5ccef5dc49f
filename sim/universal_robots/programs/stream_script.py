"""Our own script `ronna_stream`: set-points in registers, one per cycle, with a sequence number.

Its text is not interpreted. It is recognised by its name, and its settings are the lines at its head.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from math import isfinite
from typing import Any, Final

from ronna_hw.wire import universal_robots as wire
from ronna_hw.wire.universal_robots import ScriptOrder, ScriptSettings, ScriptState
from sim.universal_robots.programs.motions import stopj
from sim.universal_robots.programs.program import UrProgram
from sim.universal_robots.programs.statements import run_at_once
from sim.universal_robots.robot import Robot
from sim.universal_robots.variables import index

_SETTING = re.compile(
    r"^[^\S\n]*+(?:global\s+|local\s+)?([A-Z0-9_a-z]++)\s*+=\s*+([-+0-9.eE]++)[^\S\n]*+(?:#.*)?$",
    re.MULTILINE,
)
_SEQUENCE, _ORDER, _RUN = index(wire.SEQUENCE_INPUT), index(wire.ORDER_INPUT), index(wire.RUN_INPUT)
_SET_POINT: Final = slice(index(wire.SET_POINT_INPUTS[0]), index(wire.SET_POINT_INPUTS[-1]) + 1)
_USED, _STATE, _RUN_ECHO = map(index, (wire.SEQUENCE_OUTPUT, wire.STATE_OUTPUT, wire.RUN_OUTPUT))
NO_SET_POINT: Final = 0
LOAD_CALLS: Final = ("set_payload(", "set_tcp(")  # carried out at the start
_RANGES: Final = {"LOOKAHEAD_S": (0.03, 0.2), "GAIN": (100.0, 2000.0)}  # of servoj


def read_settings(text: str) -> ScriptSettings | str:
    """Return the settings of the script's text, or why it cannot run."""
    found = {name: value for name, value in _SETTING.findall(text) if name in ScriptSettings._fields}
    missing = [name for name in ScriptSettings._fields if name not in found]
    if missing:
        return f"variable {missing[0]} is not defined"
    try:
        numbers = {name: float(value) for name, value in found.items()}
    except ValueError:
        return "syntax error in a number"
    for name, (least, most) in _RANGES.items():
        if not least <= numbers[name] <= most:
            return f"servoj: {name} is {numbers[name]:g}, expected {least:g} to {most:g}"
    for name, value in numbers.items():
        if not (isfinite(value) and value > 0.0):
            return f"{name} is {value:g}"
    whole: dict[str, Any] = {"STARVED_CYCLES": int(numbers["STARVED_CYCLES"])}
    return ScriptSettings(**numbers | whole)


def stream_program(name: str, text: str) -> UrProgram:
    """Return the script as a program."""
    settings = read_settings(text)
    load = "\n".join(line for line in text.splitlines() if line.strip().startswith(LOAD_CALLS))

    def steps(robot: Robot, program: UrProgram) -> Iterator[None]:
        if isinstance(settings, str):
            program.failure = settings
            return
        run_at_once(robot, load)
        yield from _stream(robot, program, settings)

    return UrProgram(name, steps)


def _stream(robot: Robot, program: UrProgram, settings: ScriptSettings) -> Iterator[None]:
    values, drives = robot.values, robot.drives
    lag_s = settings.LOOKAHEAD_S + robot.parameters.servoj_lag_s
    slows = robot.parameters.slider_slows_servoj
    cycles = max(1, round(settings.CYCLE_S / robot.cycle_s))  # that servoj blocks
    largest = settings.LARGEST_STEP_RAD
    used, unchanged, state = NO_SET_POINT, 0, ScriptState.WAITING
    goal: list[float] = drives.target
    values[_USED], values[_STATE] = used, state.value
    while True:
        values[_RUN_ECHO] = values[_RUN]
        if values[_ORDER] == ScriptOrder.END:
            state = ScriptState.ENDED
            break
        sequence = values[_SEQUENCE]
        if sequence != used:
            wanted = values[_SET_POINT]
            if max(abs(a - b) for a, b in zip(wanted, goal, strict=True)) > largest:
                state = ScriptState.TOO_FAR
                break
            state = ScriptState.STREAMING
            used, unchanged, goal = sequence, 0, wanted
        elif state is ScriptState.WAITING:
            yield
            continue
        else:
            unchanged += 1
            if unchanged >= settings.STARVED_CYCLES:
                state = ScriptState.STARVED
                break
        values[_USED], values[_STATE], program.awaits_client = used, state.value, True
        for _ in range(cycles):
            drives.servo(goal, lag_s / max(robot.speed_fraction, 1e-3) if slows else lag_s)
            yield
    program.awaits_client = False
    values[_STATE] = state.value
    yield from stopj(robot, settings.STOP_DECELERATION_RAD_S2)
