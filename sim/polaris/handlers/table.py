"""The command table: name, handler, and the modes in which it is allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

from sim.polaris.handlers import (
    diagnostic,
    features,
    line,
    outputs,
    port_requests,
    ports,
    settings,
    system,
    tool_memory,
    tracking,
)
from sim.polaris.unit.behaviour import UnitBehaviour
from sim.polaris.unit.mode import Group, Mode, modes_of
from sim.polaris.unit.unit import Unit

CarryOut = Callable[[Unit, str], str | bytes]


@dataclass(frozen=True)
class Command:
    """One command; `carry_out` returns a text without CRC, or the complete bytes of a reply."""

    carry_out: CarryOut
    group: Group
    reads_frame: bool = False  # its reply depends on nothing but the frame
    restarts_line: bool = False  # its reply is sent at the new settings


COMMANDS: MappingProxyType[str, Command] = MappingProxyType(
    {
        "INIT": Command(system.initialise, Group.RESTART),
        "RESET": Command(system.reset, Group.RESTART, restarts_line=True),
        "VER": Command(system.version, Group.IDENTITY),
        "APIREV": Command(system.api_revision, Group.READING),
        "COMM": Command(line.communication, Group.IDENTITY),
        "ECHO": Command(line.echo, Group.READING),
        "BEEP": Command(system.beep, Group.READING),
        "HCWDOG": Command(settings.watch_dog, Group.SETTINGS),
        "SFLIST": Command(features.feature_list, Group.SETTINGS),
        "SSTAT": Command(features.system_checks, Group.SETTINGS),
        "GET": Command(settings.get, Group.READING),
        "GETINFO": Command(settings.get_information, Group.READING),
        "SET": Command(settings.set_parameter, Group.ADJUSTING),
        "DFLT": Command(settings.set_default, Group.SETTINGS),
        "SAVE": Command(settings.save, Group.SETTINGS),
        "VSEL": Command(settings.select_volume, Group.SETTINGS),
        "IRATE": Command(settings.illuminator_rate, Group.SETTINGS),
        "PHSR": Command(port_requests.search, Group.HANDLES),
        "PHRQ": Command(port_requests.request, Group.HANDLES),
        "PHF": Command(port_requests.free, Group.HANDLES),
        "PINIT": Command(ports.initialise, Group.HANDLES),
        "PENA": Command(ports.enable, Group.HANDLES),
        "PDIS": Command(ports.disable, Group.HANDLES),
        "PHINF": Command(ports.information, Group.HANDLES),
        "PFSEL": Command(ports.select_faces, Group.HANDLES),
        "PVWR": Command(tool_memory.write_virtual, Group.HANDLES),
        "PPRD": Command(tool_memory.read, Group.HANDLES),
        "PPWR": Command(tool_memory.write, Group.HANDLES),
        "PURD": Command(tool_memory.read_user_area, Group.HANDLES),
        "PUWR": Command(tool_memory.write_user_area, Group.HANDLES),
        "PSRCH": Command(tool_memory.search, Group.HANDLES),
        "PSEL": Command(tool_memory.select, Group.HANDLES),
        "TTCFG": Command(tool_memory.use_test_definition, Group.HANDLES),
        "TCTST": Command(tool_memory.test_current, Group.HANDLES),
        "LED": Command(outputs.light, Group.OUTPUTS),
        "PSOUT": Command(outputs.general_purpose, Group.OUTPUTS),
        "TSTART": Command(tracking.start, Group.STARTING),
        "TSTOP": Command(tracking.stop, Group.FRAMES),
        "TX": Command(tracking.text_frame, Group.FRAMES, reads_frame=True),
        "BX": Command(tracking.binary_frame, Group.FRAMES, reads_frame=True),
        "GX": Command(outputs.absent, Group.FRAMES),
        "DSTART": Command(diagnostic.start, Group.STARTING),
        "DSTOP": Command(diagnostic.stop, Group.DIAGNOSTICS),
        "IRED": Command(diagnostic.fire, Group.DIAGNOSTICS),
        "3D": Command(diagnostic.markers, Group.DIAGNOSTICS),
        "IRINIT": Command(diagnostic.prepare_infrared_check, Group.DIAGNOSTICS),
        "IRCHK": Command(diagnostic.check_infrared, Group.DIAGNOSTICS),
        **dict.fromkeys(outputs.ABSENT, Command(outputs.absent, Group.READING)),
    }
)


def modes_of_commands(behaviour: UnitBehaviour) -> dict[str, frozenset[Mode]]:
    """The modes in which each command is allowed."""
    return {name: modes_of(command.group, behaviour) for name, command in COMMANDS.items()}
