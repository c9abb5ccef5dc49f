"""Command table: name, handler, argument format and permitted modes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container
from dataclasses import dataclass
from enum import Enum, auto
from functools import cache
from types import MappingProxyType

from ronna_hw.wire.polaris import COMM_ARGUMENT_DIGITS, HANDLE_DIGITS, PHRQ_ARGUMENT_CHARACTERS
from sim.polaris.handlers import ports, system, tool_memory, tracking
from sim.polaris.handlers.tool_memory import ADDRESS_DIGITS, BLOCK_DIGITS
from sim.polaris.tracker_unit import Mode, Unit
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.refusal import ErrorCode, Refusal, hexadecimal

CarryOut = Callable[[Unit, str], str | bytes | None]
NOTHING = (0,)
OPTIONS = (0, 4)  # four digits, optional
ADDRESSED_BLOCK = ADDRESS_DIGITS + BLOCK_DIGITS
TEXT = range(1, sys.maxsize)
ANYTHING = range(sys.maxsize)


class Group(Enum):
    """Groups of commands allowed in the same modes."""

    RESTART = auto()  # INIT, RESET
    READING = auto()  # APIREV, GET, GETINFO, ECHO, BEEP
    IDENTITY = auto()  # VER, COMM
    ADJUSTING = auto()  # SET: some parameters may change while tracking
    SETTINGS = auto()
    HANDLES = auto()
    STARTING = auto()
    FRAMES = auto()
    OUTPUTS = auto()
    DIAGNOSTICS = auto()


@dataclass(frozen=True)
class Command:
    """A command, whose `carry_out` returns text without CRC, a complete reply in bytes, or None for OKAY."""

    carry_out: CarryOut
    group: Group
    lengths: Container[int] = NOTHING  # of the argument
    starts_with_handle: bool = False
    reads_frame: bool = False  # the reply depends on the frame only
    restarts_line: bool = False  # the reply has the new line settings

    def check(self, argument: str) -> None:
        """Check the format of an argument; raises Refusal if it is wrong."""
        length = len(argument.strip() if self.lengths is NOTHING else argument)
        if length not in self.lengths:
            raise Refusal(ErrorCode.PARAMETER_COUNT)
        if self.starts_with_handle:
            hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)


def _handle_command(carry_out: CarryOut, *more: int, group: Group = Group.HANDLES) -> Command:
    """Define a command whose argument is a handle and `more` further characters."""
    lengths = tuple(HANDLE_DIGITS + count for count in more or NOTHING)
    return Command(carry_out, group, lengths, starts_with_handle=True)


COMMANDS: MappingProxyType[str, Command] = MappingProxyType(
    {
        "INIT": Command(system.initialise, Group.RESTART),
        "RESET": Command(system.reset, Group.RESTART, (0, 1), restarts_line=True),
        "VER": Command(system.version, Group.IDENTITY, (1,)),
        "APIREV": Command(system.api_revision, Group.READING),
        "COMM": Command(system.communication, Group.IDENTITY, (COMM_ARGUMENT_DIGITS,)),
        "ECHO": Command(system.echo, Group.READING, ANYTHING),
        "BEEP": Command(system.beep, Group.READING, (1,)),
        "HCWDOG": Command(system.watch_dog, Group.SETTINGS, TEXT),
        "SFLIST": Command(system.feature_list, Group.SETTINGS, (2,)),
        "SSTAT": Command(system.system_checks, Group.SETTINGS, (4,)),
        "GET": Command(system.get, Group.READING, TEXT),
        "GETINFO": Command(system.get_information, Group.READING, TEXT),
        "SET": Command(system.set_parameter, Group.ADJUSTING, ANYTHING),
        "DFLT": Command(system.set_default, Group.SETTINGS, TEXT),
        "SAVE": Command(system.save, Group.SETTINGS),
        "VSEL": Command(system.select_volume, Group.SETTINGS, (1,)),
        "IRATE": Command(system.illuminator_rate, Group.SETTINGS, (1,)),
        "PHSR": Command(ports.search, Group.HANDLES, (0, 2)),
        "PHRQ": Command(ports.request, Group.HANDLES, (PHRQ_ARGUMENT_CHARACTERS,)),
        "PHF": _handle_command(ports.free),
        "PINIT": _handle_command(ports.initialise),
        "PENA": _handle_command(ports.enable, 1),
        "PDIS": _handle_command(ports.disable),
        "PHINF": _handle_command(ports.information, *OPTIONS),
        "PFSEL": _handle_command(ports.select_faces, 2),
        "PVWR": _handle_command(tool_memory.write_virtual, ADDRESSED_BLOCK),
        "PPRD": _handle_command(tool_memory.read, ADDRESS_DIGITS),
        "PPWR": _handle_command(tool_memory.write, ADDRESSED_BLOCK),
        "PURD": _handle_command(tool_memory.read_user_area, ADDRESS_DIGITS),
        "PUWR": _handle_command(tool_memory.write_user_area, ADDRESSED_BLOCK),
        "PSRCH": _handle_command(tool_memory.search),
        "PSEL": Command(tool_memory.select, Group.HANDLES, range(HANDLE_DIGITS + 1, sys.maxsize)),
        "TTCFG": _handle_command(tool_memory.use_test_definition),
        "TCTST": _handle_command(tool_memory.test_current),
        "LED": _handle_command(tool_memory.light, 2, group=Group.OUTPUTS),
        "PSOUT": _handle_command(tool_memory.general_purpose, tool_memory.OUTPUTS, group=Group.OUTPUTS),
        "TSTART": Command(tracking.start, Group.STARTING, (0, 2)),
        "TSTOP": Command(tracking.stop, Group.FRAMES),
        "TX": Command(tracking.text_frame, Group.FRAMES, OPTIONS, reads_frame=True),
        "BX": Command(tracking.binary_frame, Group.FRAMES, OPTIONS, reads_frame=True),
        "GX": Command(system.absent, Group.FRAMES, ANYTHING),
        "DSTART": Command(tracking.start_diagnostic, Group.STARTING),
        "DSTOP": Command(tracking.stop, Group.DIAGNOSTICS),
        "IRED": _handle_command(tracking.fire, tracking.FIRING_DIGITS, group=Group.DIAGNOSTICS),
        "3D": _handle_command(tracking.markers, 1, group=Group.DIAGNOSTICS),
        "IRINIT": Command(tracking.prepare_infrared_check, Group.DIAGNOSTICS),
        "IRCHK": Command(tracking.check_infrared, Group.DIAGNOSTICS, OPTIONS),
        **dict.fromkeys(system.ABSENT, Command(system.absent, Group.READING, ANYTHING)),
    }
)


@cache
def modes_of_commands(behaviour: UnitBehaviour) -> dict[str, frozenset[Mode]]:
    """Return the permitted modes of each command, by name."""
    return {name: modes_of(command.group, behaviour) for name, command in COMMANDS.items()}


def modes_of(group: Group, behaviour: UnitBehaviour) -> frozenset[Mode]:
    """Return the modes in which a group's commands are allowed."""
    early = {Mode.NOT_INITIALISED} if behaviour.answers_before_init else set()
    settings = {Mode.DIAGNOSTIC} if behaviour.settings_in_diagnostic else set()
    settings |= {Mode.TRACKING} if behaviour.settings_while_tracking else set()
    handles = {Mode.DIAGNOSTIC} if behaviour.handles_in_diagnostic else set()
    identity = {Mode.TRACKING} if behaviour.identity_while_tracking else set()
    running = {Mode.SETUP, Mode.TRACKING, Mode.DIAGNOSTIC}
    modes: dict[Group, set[Mode]] = {
        Group.RESTART: set(Mode),
        Group.READING: running | early,
        Group.IDENTITY: {Mode.SETUP, Mode.DIAGNOSTIC} | identity | early,
        Group.ADJUSTING: {Mode.SETUP, Mode.TRACKING} | settings,
        Group.SETTINGS: {Mode.SETUP} | settings,
        Group.HANDLES: {Mode.SETUP} | handles,
        Group.STARTING: {Mode.SETUP},
        Group.FRAMES: {Mode.TRACKING},
        Group.OUTPUTS: running,
        Group.DIAGNOSTICS: {Mode.DIAGNOSTIC},
    }
    return frozenset(modes[group])
