"""Arbitrary commands in arbitrary order: each gets one well-formed answer in any state."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from polaris_bench import Bench, MakeBench

from ronna_hw.wire.polaris import PVWR_BLOCK_BYTES, crc16
from sim.polaris.handlers.table import COMMANDS
from sim.polaris.tracker_unit import UnitMode
from sim.polaris.unit.model import SPECTRA
from sim.polaris.unit.ports import WiredPorts, WiredTool
from sim.polaris.unit.tool_definition import write_definition
from sim.polaris.unit.user_parameters import parameter_table
from sim.world.scene.model import TrackerTool

SOCKETS = 3
USER_BYTES = 1024
PARAMETERS = [parameter.name for parameter in parameter_table(SPECTRA, SOCKETS)] + ["*", "Info.*"]
NOISE = "0123456789ABCDEFabcdef*:= DSBxyz.\x00\xff\n"
HEX = "0123456789ABCDEFabcdef"
RARE = {"INIT": 0.1, "RESET": 0.05, "TSTOP": 0.5, "DSTOP": 0.5}  # commands that end a state


class Dice:
    """Random commands, most of them nearly right."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._weights = [RARE.get(name, 1.0) for name in COMMANDS]

    def chance(self, share: float) -> bool:
        return self._random.random() < share

    def choice(self, *values: object) -> str:
        return str(self._random.choice(values))

    def command(self) -> str:
        name = self._random.choices(list(COMMANDS), self._weights)[0]
        if self.chance(0.1):
            return f"{name} " + "".join(self._random.choices(NOISE, k=self._random.randrange(20)))
        return f"{name} {self._argument(name)}"

    def _argument(self, name: str) -> str:
        handle = f"{self._random.randrange(1, 6):02X}"
        choice, digits = self.choice, lambda count: "".join(self._random.choices(HEX, k=count))
        address = f"{PVWR_BLOCK_BYTES * self._random.randrange(33):04X}"
        options = choice("", "0001", "1801", "180E", "080F", digits(4))
        arguments = {
            "PVWR": handle + address + digits(128),
            "PPWR": handle + address + digits(128),
            "PUWR": handle + address + digits(128),
            "PPRD": handle + address,
            "PURD": handle + address,
            "PENA": handle + choice("S", "D", "B", "X"),
            "PHINF": handle + choice("", "0001", "007F", digits(4)),
            "PHRQ": choice(*(f"*********{rest}" for rest in ("1****", "1**01", "1**02", "0****", "003**"))),
            "PHSR": choice("00", "01", "02", "03", "04", "05"),
            "PFSEL": handle + digits(2),
            "PSEL": handle + digits(16),
            "TX": options,
            "BX": options,
            "TSTART": choice("", "80", "40", "C0", "01"),
            "GET": choice(*PARAMETERS),
            "GETINFO": choice(*PARAMETERS),
            "DFLT": choice(*PARAMETERS),
            "SET": choice(*PARAMETERS) + "=" + choice("0", "1", "2", "999999999", "x", ""),
            "COMM": choice("50000", "01110", "A0000", "61211"),
            "LED": handle + choice(*"1234") + choice(*"BFSX"),
            "PSOUT": handle + "NSP",
            "3D": handle + "5",
            "IRED": handle + digits(8),
            "IRCHK": choice("", "0001", "0003", "0004"),
            "SFLIST": digits(2),
            "SSTAT": choice("0001", "0007", "0008"),
            "HCWDOG": choice("0", "2"),
            "RESET": "0",
        }
        one_digit = ("VER", "VSEL", "IRATE", "BEEP")
        of_a_handle = ("PINIT", "PDIS", "PHF", "TCTST", "TTCFG", "PSRCH")
        if name in one_digit:
            return digits(1)
        return arguments.get(name, handle if name in of_a_handle else "")


@pytest.fixture
def well_equipped(make_bench: MakeBench, pointer: TrackerTool) -> Bench:
    """A unit with two wired tools, one without memory, that allows and reports as much as possible."""
    sockets = WiredPorts(SOCKETS)
    sockets.add(WiredTool.from_definition(write_definition(pointer), 1, USER_BYTES))
    sockets.add(WiredTool(None, bytearray(USER_BYTES)))
    return make_bench(
        wired=sockets,
        lists_disabled_handles=True,
        text_tool_markers=True,
        handles_in_diagnostic=True,
        starts_with_hardware_fault=True,
    )


def check(reply: bytes, seen: Counter[str], line: str) -> None:
    """Check form and CRC of a reply, and count it."""
    if reply.startswith(b"\xc4\xa5"):
        assert len(reply) == int.from_bytes(reply[2:4], "little") + 8
        assert crc16(reply[:6]) == crc16(reply[6:]) == 0
    else:
        assert reply[-1:] == b"\r", line
        assert reply[-5:-1] == b"%04X" % crc16(reply[:-5]), line
    text = reply[:7].decode("latin-1")
    seen[text if text.startswith("ERROR") else line.partition(" ")[0]] += 1


def converse(bench: Bench, tool: TrackerTool, lines: int, seed: int) -> Counter[str]:
    dice, seen = Dice(seed), Counter[str]()
    for _ in range(lines):
        if bench.unit.mode is UnitMode.NOT_INITIALISED and dice.chance(0.2):
            bench.raw("INIT ")
        if bench.unit.mode is UnitMode.SETUP and dice.chance(0.02) and len(list(bench.unit.ports)) < 10:
            bench.enable(tool)
        if dice.chance(0.005):
            change = bench.unit.plug if dice.chance(0.5) else bench.unit.unplug
            change(int(dice.choice(1, 2, 3)))
        if dice.chance(0.005):
            bench.world.clock.sleep(3.0)
        line = dice.command()
        check(bench.raw(line), seen, line)
    return seen


def test_any_command_in_any_state_gets_one_answer(well_equipped: Bench, pointer: TrackerTool) -> None:
    seen = converse(well_equipped, pointer, 8_000, seed=20181)
    assert {"BX", "TX", "3D", "PINIT", "PENA", "PHINF", "PPRD", "ERROR0C", "ERROR2B"} <= set(seen)


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(5))
def test_a_long_conversation_of_random_commands_gets_one_answer_each(
    well_equipped: Bench, pointer: TrackerTool, seed: int
) -> None:
    seen = converse(well_equipped, pointer, 100_000, seed)
    assert len(seen) > 60
