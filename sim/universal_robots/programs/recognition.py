"""Recognise a script by its name or its text; one that is not known has to be of plain statements.

External Control of the pendant asks its client for a script, and runs what it gets.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator
from typing import Final

from ronna_hw.wire.universal_robots import SCRIPT_NAME
from sim.universal_robots.programs.control_settings import read_external_control
from sim.universal_robots.programs.external_control import external_control
from sim.universal_robots.programs.outgoing import Outgoing
from sim.universal_robots.programs.program import UrProgram, Watchdog
from sim.universal_robots.programs.register_loop import register_loop
from sim.universal_robots.programs.statements import require_known, run_statements
from sim.universal_robots.programs.stream_script import stream_program
from sim.universal_robots.robot import Robot
from sim.universal_robots.variables import PLACES, index

REGISTER_LOOP_MARK: Final = "RTDE Control Script Loaded"  # in the text of the script that ur_rtde sends
LAST_OFFSET: Final = 24  # of its registers: it uses up to 24 of each kind, and there are 48
REQUEST: Final = b"request_program\n"
FIRST_WAIT_S: Final = 2.0  # for the first byte of the script (U)
QUIET_S: Final = 0.2  # without a byte, after which the script is complete (U): nothing marks its end
_NAME = re.compile(r"^\s*(?:def|sec)\s+(\w+)\s*\(")
_WATCHDOG = re.compile(
    r"^[^\S\n]*+rtde_set_watchdog\(\s*\"(\w+)\"\s*,\s*([0-9.]+)\s*,\s*\"(\w+)\"\s*\)", re.MULTILINE
)
_OFFSET = re.compile(r"^[^\S\n]*+global\s+reg_offset_int\s*=\s*(\d+)", re.MULTILINE)


def name_of(text: str) -> str:
    """Return the name of a script, or its first line if it has none."""
    found = _NAME.match(text)
    return found[1] if found else text.strip().partition("\n")[0].strip()


def recognise(text: str, cycle_s: float) -> UrProgram:
    """Return the program that a script is.

    Raises ArithmeticError or ValueError for numbers out of range, UnknownStatement for what is not simulated.
    """
    name = name_of(text)
    if name == SCRIPT_NAME:
        program = stream_program(name, text)
        program.watchdog = _read_watchdog(text, cycle_s)
        return program
    if REGISTER_LOOP_MARK in text:
        offset = _OFFSET.search(text)
        first = int(offset[1]) if offset else 0
        if first > LAST_OFFSET:
            raise ValueError(f"reg_offset_int is {first}, at most {LAST_OFFSET}")
        return UrProgram(name, lambda robot, program: register_loop(robot, program, first))
    settings = read_external_control(text)
    if settings is not None:
        return external_control(name, settings)
    require_known(text)
    return UrProgram(name, lambda robot, program: run_statements(robot, text))


def endless(name: str) -> UrProgram:
    """Return a program of the pendant that runs until it is stopped."""

    def steps(_robot: Robot, _program: UrProgram) -> Iterator[None]:
        while True:
            yield

    return UrProgram(name, steps)


def requested_program(name: str, host: str, port: int) -> UrProgram:
    """Return a program that fetches its script from a client of this computer when it starts."""

    def steps(robot: Robot, program: UrProgram) -> Iterator[None]:
        link = Outgoing()
        program.links.append(link)
        yield from link.dial(host, port, robot.cycle_s)
        if not link.is_open:
            program.failure = f"{name}: no connection to {host}:{port}"
            return
        text = yield from _fetch(link, robot)
        link.close()
        if not text.strip():
            program.failure = f"{name}: no script from {host}:{port}"
            return
        script = recognise(text.decode("utf-8", "replace"), robot.cycle_s)
        program.watchdog = script.watchdog
        yield from script.steps(robot, program)

    return UrProgram(name, steps)


def _fetch(link: Outgoing, robot: Robot) -> Generator[None, None, bytes]:
    """Ask for the script and return what arrives until a pause, a hang-up, or the longest script."""
    link.send(REQUEST)
    text, silent_s, limit_s = b"", 0.0, FIRST_WAIT_S
    while silent_s < limit_s and len(text) <= robot.parameters.longest_script_bytes:
        data = link.take_all()
        if data:
            text, silent_s, limit_s = text + data, 0.0, QUIET_S
        elif not link.is_open:
            break
        silent_s += robot.cycle_s
        yield
    return text


def _read_watchdog(text: str, cycle_s: float) -> Watchdog | None:
    found = _WATCHDOG.search(text)
    if found is None or found[1] not in PLACES or not float(found[2]):
        return None
    return Watchdog(index(found[1]), round(1.0 / float(found[2]) / cycle_s), found[3])
