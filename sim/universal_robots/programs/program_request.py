"""External Control of the pendant: the program asks its client for a script, and runs what it gets."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from typing import Final

from sim.universal_robots.programs.outgoing import Outgoing, is_this_computer
from sim.universal_robots.programs.program import UrProgram
from sim.universal_robots.programs.recognition import recognise
from sim.universal_robots.robot import Robot

REQUEST: Final = b"request_program\n"
FIRST_WAIT_S: Final = 2.0  # for the first byte of the script (U)
QUIET_S: Final = 0.2  # without a byte, after which the script is complete (U): nothing marks its end


def requested_program(name: str, host: str, port: int) -> UrProgram:
    """Return a program that fetches its script from a client of this computer when it starts."""

    def steps(robot: Robot, program: UrProgram) -> Iterator[None]:
        link = Outgoing()
        program.links.append(link)
        if is_this_computer(host):
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
