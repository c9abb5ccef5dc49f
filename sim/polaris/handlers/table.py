"""All commands of the unit: name, what carries it out, and in which modes it is allowed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

from sim.polaris.handlers import ports, settings, system, tracking
from sim.polaris.unit import Mode, Unit

ALWAYS = frozenset(Mode)
INITIALISED = frozenset({Mode.SETUP, Mode.TRACKING})
SETUP = frozenset({Mode.SETUP})
TRACKING = frozenset({Mode.TRACKING})


@dataclass(frozen=True)
class Command:
    """One command; `carry_out` gives a text still without CRC, or the complete bytes of a reply."""

    carry_out: Callable[[Unit, str], str | bytes]
    modes: frozenset[Mode]
    tells_frame: bool = False  # its answer depends on nothing but the frame
    restarts_line: bool = False  # its answer already goes out at the new rate


COMMANDS: MappingProxyType[str, Command] = MappingProxyType(
    {
        "INIT": Command(system.initialise, ALWAYS),
        "RESET": Command(system.reset, ALWAYS, restarts_line=True),
        "VER": Command(system.version, ALWAYS),
        "APIREV": Command(system.api_revision, ALWAYS),
        "COMM": Command(system.communication, ALWAYS),
        "ECHO": Command(system.echo, ALWAYS),
        "BEEP": Command(system.beep, ALWAYS),
        "SFLIST": Command(system.feature_list, SETUP),
        "SSTAT": Command(system.system_checks, SETUP),
        "GET": Command(settings.get, ALWAYS),
        "GETINFO": Command(settings.get_information, ALWAYS),
        "SET": Command(settings.set_parameter, INITIALISED),
        "VSEL": Command(settings.select_volume, SETUP),
        "IRATE": Command(settings.illuminator_rate, SETUP),
        "PHSR": Command(ports.search, SETUP),
        "PHRQ": Command(ports.request, SETUP),
        "PHF": Command(ports.free, SETUP),
        "PVWR": Command(ports.write_memory, SETUP),
        "PINIT": Command(ports.initialise, SETUP),
        "PENA": Command(ports.enable, SETUP),
        "PDIS": Command(ports.disable, SETUP),
        "PHINF": Command(ports.information, SETUP),
        "TSTART": Command(tracking.start, SETUP),
        "TSTOP": Command(tracking.stop, TRACKING),
        "TX": Command(tracking.text_frame, TRACKING, tells_frame=True),
        "BX": Command(tracking.binary_frame, TRACKING, tells_frame=True),
    }
)
