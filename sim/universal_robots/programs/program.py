"""A program: its name, and what it does, cycle by cycle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from sim.universal_robots.programs.outgoing import Outgoing
from sim.universal_robots.robot import Robot


class ScriptPlace(NamedTuple):
    """Place in the text of a program, both from 1."""

    line: int = 1
    column: int = 1


FIRST_PLACE: Final = ScriptPlace()


@dataclass
class Watchdog:
    """`rtde_set_watchdog`: an input that a client must write at least every `cycles`."""

    place: int  # of the input among the variables
    cycles: int
    action: str  # stop, pause or ignore


@dataclass
class UrProgram:
    """A program. `steps` moves the robot once for each of its steps; the arm brakes when it has ended."""

    name: str
    steps: Callable[[Robot, UrProgram], Iterator[None]]
    watchdog: Watchdog | None = None
    awaits_client: bool = field(default=False, init=False)  # streams now: lock-step waits for each set-point
    links: list[Outgoing] = field(default_factory=list, init=False)  # closed when the program stops
    failure: str = field(default="", init=False)  # a runtime exception, and why
