"""The command table: name, handler, form of the argument, and the modes in which it is allowed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Container
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

from ronna_hw.wire.polaris import COMM_ARGUMENT_DIGITS, HANDLE_DIGITS, PHRQ_ARGUMENT_CHARACTERS
from sim.polaris.handlers import diagnostic, features, ports, settings, system, tool_memory, tracking
from sim.polaris.handlers.arguments import hexadecimal
from sim.polaris.handlers.tool_memory import ADDRESS_DIGITS, BLOCK_DIGITS
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.mode import Group, Mode, modes_of
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

CarryOut = Callable[[Unit, str], str | bytes | None]
NOTHING = (0,)
OPTIONS = (0, 4)  # four digits, optional
ADDRESSED_BLOCK = ADDRESS_DIGITS + BLOCK_DIGITS
TEXT = range(1, sys.maxsize)
ANYTHING = range(sys.maxsize)


@dataclass(frozen=True)
class Command:
    """One command; `carry_out` returns text without CRC, all bytes of a reply, or None for OKAY."""

    carry_out: CarryOut
    group: Group
    lengths: Container[int] = NOTHING  # of the argument
    starts_with_handle: bool = False
    reads_frame: bool = False  # its reply depends only on the frame
    restarts_line: bool = False  # its reply is sent with the new settings

    def check(self, argument: str) -> None:
        """Raise Refusal for an argument that does not have this command's form."""
        length = len(argument.strip() if self.lengths is NOTHING else argument)
        if length not in self.lengths:
            raise Refusal(ErrorCode.PARAMETER_COUNT)
        if self.starts_with_handle:
            hexadecimal(argument[:HANDLE_DIGITS], ErrorCode.BAD_HANDLE)


def _of_handle(carry_out: CarryOut, *more: int, group: Group = Group.HANDLES) -> Command:
    """A command whose argument is a handle plus as many further characters."""
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
        "HCWDOG": Command(settings.watch_dog, Group.SETTINGS, TEXT),
        "SFLIST": Command(features.feature_list, Group.SETTINGS, (2,)),
        "SSTAT": Command(features.system_checks, Group.SETTINGS, (4,)),
        "GET": Command(settings.get, Group.READING, TEXT),
        "GETINFO": Command(settings.get_information, Group.READING, TEXT),
        "SET": Command(settings.set_parameter, Group.ADJUSTING, ANYTHING),
        "DFLT": Command(settings.set_default, Group.SETTINGS, TEXT),
        "SAVE": Command(settings.save, Group.SETTINGS),
        "VSEL": Command(settings.select_volume, Group.SETTINGS, (1,)),
        "IRATE": Command(settings.illuminator_rate, Group.SETTINGS, (1,)),
        "PHSR": Command(ports.search, Group.HANDLES, (0, 2)),
        "PHRQ": Command(ports.request, Group.HANDLES, (PHRQ_ARGUMENT_CHARACTERS,)),
        "PHF": _of_handle(ports.free),
        "PINIT": _of_handle(ports.initialise),
        "PENA": _of_handle(ports.enable, 1),
        "PDIS": _of_handle(ports.disable),
        "PHINF": _of_handle(ports.information, *OPTIONS),
        "PFSEL": _of_handle(ports.select_faces, 2),
        "PVWR": _of_handle(tool_memory.write_virtual, ADDRESSED_BLOCK),
        "PPRD": _of_handle(tool_memory.read, ADDRESS_DIGITS),
        "PPWR": _of_handle(tool_memory.write, ADDRESSED_BLOCK),
        "PURD": _of_handle(tool_memory.read_user_area, ADDRESS_DIGITS),
        "PUWR": _of_handle(tool_memory.write_user_area, ADDRESSED_BLOCK),
        "PSRCH": _of_handle(tool_memory.search),
        "PSEL": Command(tool_memory.select, Group.HANDLES, range(HANDLE_DIGITS + 1, sys.maxsize)),
        "TTCFG": _of_handle(tool_memory.use_test_definition),
        "TCTST": _of_handle(tool_memory.test_current),
        "LED": _of_handle(tool_memory.light, 2, group=Group.OUTPUTS),
        "PSOUT": _of_handle(tool_memory.general_purpose, tool_memory.OUTPUTS, group=Group.OUTPUTS),
        "TSTART": Command(tracking.start, Group.STARTING, (0, 2)),
        "TSTOP": Command(tracking.stop, Group.FRAMES),
        "TX": Command(tracking.text_frame, Group.FRAMES, OPTIONS, reads_frame=True),
        "BX": Command(tracking.binary_frame, Group.FRAMES, OPTIONS, reads_frame=True),
        "GX": Command(system.absent, Group.FRAMES, ANYTHING),
        "DSTART": Command(diagnostic.start, Group.STARTING),
        "DSTOP": Command(diagnostic.stop, Group.DIAGNOSTICS),
        "IRED": _of_handle(diagnostic.fire, diagnostic.FIRING_DIGITS, group=Group.DIAGNOSTICS),
        "3D": _of_handle(diagnostic.markers, 1, group=Group.DIAGNOSTICS),
        "IRINIT": Command(diagnostic.prepare_infrared_check, Group.DIAGNOSTICS),
        "IRCHK": Command(diagnostic.check_infrared, Group.DIAGNOSTICS, OPTIONS),
        **dict.fromkeys(system.ABSENT, Command(system.absent, Group.READING, ANYTHING)),
    }
)


@cache
def modes_of_commands(behaviour: UnitBehaviour) -> dict[str, frozenset[Mode]]:
    """The modes in which each command is allowed."""
    return {name: modes_of(command.group, behaviour) for name, command in COMMANDS.items()}
