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
from sim.polaris.tracker_unit import SimulatedUnit, UnitMode
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, hexadecimal

CarryOut = Callable[[SimulatedUnit, str], str | bytes | None]
NOTHING = (0,)
OPTIONS = (0, 4)  # four digits, optional
ADDRESSED_BLOCK = ADDRESS_DIGITS + BLOCK_DIGITS
TEXT = range(1, sys.maxsize)
ANYTHING = range(sys.maxsize)


class CommandGroup(Enum):
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
class CommandEntry:
    """A command, whose `carry_out` returns text without CRC, a complete reply in bytes, or None for OKAY."""

    carry_out: CarryOut
    group: CommandGroup
    lengths: Container[int] = NOTHING  # of the argument
    starts_with_handle: bool = False
    reads_frame: bool = False  # the reply depends on the frame only
    restarts_line: bool = False  # the reply has the new line settings

    def check(self, argument: str) -> None:
        """Check the format of an argument; raises CommandRefusal if it is wrong."""
        length = len(argument.strip() if self.lengths is NOTHING else argument)
        if length not in self.lengths:
            raise CommandRefusal(NdiErrorCode.PARAMETER_COUNT)
        if self.starts_with_handle:
            hexadecimal(argument[:HANDLE_DIGITS], NdiErrorCode.BAD_HANDLE)


def _handle_command(
    carry_out: CarryOut, *more: int, group: CommandGroup = CommandGroup.HANDLES
) -> CommandEntry:
    """Define a command whose argument is a handle and `more` further characters."""
    lengths = tuple(HANDLE_DIGITS + count for count in more or NOTHING)
    return CommandEntry(carry_out, group, lengths, starts_with_handle=True)


COMMANDS: MappingProxyType[str, CommandEntry] = MappingProxyType(
    {
        "INIT": CommandEntry(system.initialise, CommandGroup.RESTART),
        "RESET": CommandEntry(system.reset, CommandGroup.RESTART, (0, 1), restarts_line=True),
        "VER": CommandEntry(system.version, CommandGroup.IDENTITY, (1,)),
        "APIREV": CommandEntry(system.api_revision, CommandGroup.READING),
        "COMM": CommandEntry(system.communication, CommandGroup.IDENTITY, (COMM_ARGUMENT_DIGITS,)),
        "ECHO": CommandEntry(system.echo, CommandGroup.READING, ANYTHING),
        "BEEP": CommandEntry(system.beep, CommandGroup.READING, (1,)),
        "HCWDOG": CommandEntry(system.watch_dog, CommandGroup.SETTINGS, TEXT),
        "SFLIST": CommandEntry(system.feature_list, CommandGroup.SETTINGS, (2,)),
        "SSTAT": CommandEntry(system.system_checks, CommandGroup.SETTINGS, (4,)),
        "GET": CommandEntry(system.get, CommandGroup.READING, TEXT),
        "GETINFO": CommandEntry(system.get_information, CommandGroup.READING, TEXT),
        "SET": CommandEntry(system.set_parameter, CommandGroup.ADJUSTING, ANYTHING),
        "DFLT": CommandEntry(system.set_default, CommandGroup.SETTINGS, TEXT),
        "SAVE": CommandEntry(system.save, CommandGroup.SETTINGS),
        "VSEL": CommandEntry(system.select_volume, CommandGroup.SETTINGS, (1,)),
        "IRATE": CommandEntry(system.illuminator_rate, CommandGroup.SETTINGS, (1,)),
        "PHSR": CommandEntry(ports.search, CommandGroup.HANDLES, (0, 2)),
        "PHRQ": CommandEntry(ports.request, CommandGroup.HANDLES, (PHRQ_ARGUMENT_CHARACTERS,)),
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
        "PSEL": CommandEntry(tool_memory.select, CommandGroup.HANDLES, range(HANDLE_DIGITS + 1, sys.maxsize)),
        "TTCFG": _handle_command(tool_memory.use_test_definition),
        "TCTST": _handle_command(tool_memory.test_current),
        "LED": _handle_command(tool_memory.light, 2, group=CommandGroup.OUTPUTS),
        "PSOUT": _handle_command(
            tool_memory.general_purpose, tool_memory.OUTPUTS, group=CommandGroup.OUTPUTS
        ),
        "TSTART": CommandEntry(tracking.start, CommandGroup.STARTING, (0, 2)),
        "TSTOP": CommandEntry(tracking.stop, CommandGroup.FRAMES),
        "TX": CommandEntry(tracking.text_frame, CommandGroup.FRAMES, OPTIONS, reads_frame=True),
        "BX": CommandEntry(tracking.binary_frame, CommandGroup.FRAMES, OPTIONS, reads_frame=True),
        "GX": CommandEntry(system.absent, CommandGroup.FRAMES, ANYTHING),
        "DSTART": CommandEntry(tracking.start_diagnostic, CommandGroup.STARTING),
        "DSTOP": CommandEntry(tracking.stop, CommandGroup.DIAGNOSTICS),
        "IRED": _handle_command(tracking.fire, tracking.FIRING_DIGITS, group=CommandGroup.DIAGNOSTICS),
        "3D": _handle_command(tracking.markers, 1, group=CommandGroup.DIAGNOSTICS),
        "IRINIT": CommandEntry(tracking.prepare_infrared_check, CommandGroup.DIAGNOSTICS),
        "IRCHK": CommandEntry(tracking.check_infrared, CommandGroup.DIAGNOSTICS, OPTIONS),
        **dict.fromkeys(system.ABSENT, CommandEntry(system.absent, CommandGroup.READING, ANYTHING)),
    }
)


@cache
def modes_of_commands(behaviour: UnitBehaviour) -> dict[str, frozenset[UnitMode]]:
    """Return the permitted modes of each command, by name."""
    return {name: modes_of(command.group, behaviour) for name, command in COMMANDS.items()}


def modes_of(group: CommandGroup, behaviour: UnitBehaviour) -> frozenset[UnitMode]:
    """Return the modes in which a group's commands are allowed."""
    early = {UnitMode.NOT_INITIALISED} if behaviour.answers_before_init else set()
    settings = {UnitMode.DIAGNOSTIC} if behaviour.settings_in_diagnostic else set()
    settings |= {UnitMode.TRACKING} if behaviour.settings_while_tracking else set()
    handles = {UnitMode.DIAGNOSTIC} if behaviour.handles_in_diagnostic else set()
    identity = {UnitMode.TRACKING} if behaviour.identity_while_tracking else set()
    running = {UnitMode.SETUP, UnitMode.TRACKING, UnitMode.DIAGNOSTIC}
    modes: dict[CommandGroup, set[UnitMode]] = {
        CommandGroup.RESTART: set(UnitMode),
        CommandGroup.READING: running | early,
        CommandGroup.IDENTITY: {UnitMode.SETUP, UnitMode.DIAGNOSTIC} | identity | early,
        CommandGroup.ADJUSTING: {UnitMode.SETUP, UnitMode.TRACKING} | settings,
        CommandGroup.SETTINGS: {UnitMode.SETUP} | settings,
        CommandGroup.HANDLES: {UnitMode.SETUP} | handles,
        CommandGroup.STARTING: {UnitMode.SETUP},
        CommandGroup.FRAMES: {UnitMode.TRACKING},
        CommandGroup.OUTPUTS: running,
        CommandGroup.DIAGNOSTICS: {UnitMode.DIAGNOSTIC},
    }
    return frozenset(modes[group])
