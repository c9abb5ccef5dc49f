"""Handlers for commands concerning the memory and outputs of a tool.

PVWR, PPRD, PPWR, PURD, PUWR, PSRCH, PSEL, TTCFG, TCTST, LED, PSOUT.
"""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.ports import WiredTool
from sim.polaris.unit.refusal import CommandRefusal, NdiErrorCode, hexadecimal
from sim.polaris.unit.tool_definition import build_test_definition

ADDRESS_DIGITS = 4
BLOCK_DIGITS = 2 * wire.PVWR_BLOCK_BYTES
ADDRESSED = HANDLE_DIGITS + ADDRESS_DIGITS
LIGHTS = "123"
LIGHT_STATES = "BFS"  # blank, flash, solid
OUTPUTS = 3
OUTPUT_STATES = frozenset("NSPO")  # no change, solid, pulse, off


def write_virtual(unit: SimulatedUnit, argument: str) -> None:
    """PVWR hh aaaa and 64 bytes: load without checking, which PINIT does later"""
    address, content = _parse_block(argument, wire.PVWR_SPACE_BYTES)
    port = unit.ports.require_port(argument)
    if port.unoccupied:
        raise CommandRefusal(NdiErrorCode.HANDLE_UNOCCUPIED)
    if port.dummy:
        raise CommandRefusal(NdiErrorCode.NOT_FOR_THIS_DEVICE)
    port.memory[address : address + len(content)] = content
    port.written = True


def read(unit: SimulatedUnit, argument: str) -> str:
    """PPRD hh aaaa: read 64 bytes of a wired tool's memory"""
    address = _parse_address(argument, wire.PVWR_SPACE_BYTES)
    tool = _require_tool(unit, argument, NdiErrorCode.CANNOT_READ_MEMORY)
    if tool.memory is None:
        raise CommandRefusal(NdiErrorCode.CANNOT_READ_MEMORY)
    return tool.memory[address : address + wire.PVWR_BLOCK_BYTES].hex().upper()


def write(unit: SimulatedUnit, argument: str) -> None:
    """PPWR hh aaaa and 64 bytes: store in the tool"""
    address, content = _parse_block(argument, wire.PVWR_SPACE_BYTES)
    tool = _require_tool(unit, argument, NdiErrorCode.CANNOT_WRITE_MEMORY)
    if tool.memory is None:
        raise CommandRefusal(NdiErrorCode.CANNOT_WRITE_MEMORY)
    tool.memory[address : address + len(content)] = content
    unit.ports.require_port(argument).memory[:] = tool.memory


def read_user_area(unit: SimulatedUnit, argument: str) -> str:
    """PURD hh aaaa"""
    address = _parse_address(argument, unit.behaviour.user_memory_bytes)
    tool = _require_tool(unit, argument, NdiErrorCode.CANNOT_READ_MEMORY)
    return tool.user_memory[address : address + wire.PVWR_BLOCK_BYTES].hex().upper()


def write_user_area(unit: SimulatedUnit, argument: str) -> None:
    """PUWR hh aaaa and 64 bytes"""
    address, content = _parse_block(argument, unit.behaviour.user_memory_bytes)
    tool = _require_tool(unit, argument, NdiErrorCode.CANNOT_WRITE_MEMORY)
    tool.user_memory[address : address + len(content)] = content


def search(unit: SimulatedUnit, argument: str) -> str:
    """PSRCH hh: count and identifiers of the tool's memory devices"""
    tool = unit.ports.require_wired(argument).tool
    return "0" if tool is None or tool.memory is None else f"1{tool.identifier}"


def select(unit: SimulatedUnit, argument: str) -> None:
    """PSEL hh d...: select a memory device by its identifier"""
    if len(argument) <= HANDLE_DIGITS:
        raise CommandRefusal(NdiErrorCode.PARAMETER_COUNT)
    tool = unit.ports.require_wired(argument).tool
    if tool is None or tool.memory is None or argument[HANDLE_DIGITS:].upper() != tool.identifier:
        raise CommandRefusal(NdiErrorCode.CANNOT_SELECT_MEMORY)


def use_test_definition(unit: SimulatedUnit, argument: str) -> None:
    """TTCFG hh: load the test definition for a tool without memory"""
    port = unit.ports.require_wired(argument)
    if port.written and not unit.behaviour.replaces_definition_by_test:
        raise CommandRefusal(NdiErrorCode.NOT_FOR_THIS_DEVICE)
    content = build_test_definition()
    port.memory[: len(content)] = content
    port.written = True


def test_current(unit: SimulatedUnit, argument: str) -> None:
    """TCTST hh: test the marker current, with the result read by PHINF 0002"""
    port = unit.ports.require_wired(argument)
    definition = unit.ports.require_initialised(argument).definition
    if definition is None:  # a dummy draws no current
        raise CommandRefusal(NdiErrorCode.CURRENT_TEST_FAILED)
    port.current_test = (1 << len(definition.markers_mm)) - 1  # every marker passes


def light(unit: SimulatedUnit, argument: str) -> None:
    """LED hh n s"""
    number, state = argument[HANDLE_DIGITS], argument[HANDLE_DIGITS + 1]
    if number not in LIGHTS:
        raise CommandRefusal(NdiErrorCode.BAD_LED_NUMBER)
    if state not in LIGHT_STATES:
        raise CommandRefusal(NdiErrorCode.BAD_LED_STATE)
    unit.ports.require_wired(argument)
    unit.ports.require_initialised(argument)


def general_purpose(unit: SimulatedUnit, argument: str) -> None:
    """PSOUT hh abc"""
    if not OUTPUT_STATES.issuperset(argument[HANDLE_DIGITS:]):
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    unit.ports.require_wired(argument)
    unit.ports.require_initialised(argument)


def _parse_address(argument: str, space_bytes: int) -> int:
    address = hexadecimal(argument[HANDLE_DIGITS:ADDRESSED])
    if address % wire.PVWR_BLOCK_BYTES or address + wire.PVWR_BLOCK_BYTES > space_bytes:
        raise CommandRefusal(NdiErrorCode.OUT_OF_RANGE)
    return address


def _parse_block(argument: str, space_bytes: int) -> tuple[int, bytes]:
    address = _parse_address(argument, space_bytes)
    hexadecimal(argument[ADDRESSED:])
    return address, bytes.fromhex(argument[ADDRESSED:])


def _require_tool(unit: SimulatedUnit, argument: str, without_memory: NdiErrorCode) -> WiredTool:
    port = unit.ports.require_port(argument)
    if not port.wired_port and unit.behaviour.memory_of_passive == "1E/1F":
        raise CommandRefusal(without_memory)
    tool = unit.ports.require_wired(argument).tool
    if tool is None:
        raise CommandRefusal(without_memory)
    return tool
