"""Memory and outputs of a tool: PVWR, PPRD, PPWR, PURD, PUWR, PSRCH, PSEL, TTCFG, TCTST, LED, PSOUT."""

from __future__ import annotations

from ronna_hw.wire import polaris as wire
from ronna_hw.wire.polaris import HANDLE_DIGITS
from sim.polaris.handlers.arguments import (
    hexadecimal,
    initialised_port_of,
    port_of,
    wired_port_of,
)
from sim.polaris.tools.definition import wiring_definition
from sim.polaris.tools.ports import Port
from sim.polaris.tools.wired_tools import WiredTool
from sim.polaris.unit.refusal import ErrorCode, Refusal
from sim.polaris.unit.unit import Unit

ADDRESS_DIGITS = 4
BLOCK_DIGITS = 2 * wire.PVWR_BLOCK_BYTES
ADDRESSED = HANDLE_DIGITS + ADDRESS_DIGITS
LIGHTS = "123"
LIGHT_STATES = "BFS"  # blank, flash, solid
OUTPUTS = 3
OUTPUT_STATES = frozenset("NSPO")  # no change, solid, pulse, off


def write_virtual(unit: Unit, argument: str) -> None:
    """PVWR hh aaaa and 64 bytes: the content is checked by PINIT."""
    address, content = _block(argument, wire.PVWR_SPACE_BYTES)
    port = port_of(unit, argument)
    if port.unoccupied:
        raise Refusal(ErrorCode.HANDLE_UNOCCUPIED)
    if port.dummy:
        raise Refusal(ErrorCode.NOT_FOR_THIS_DEVICE)
    port.memory[address : address + len(content)] = content
    port.written = True


def read(unit: Unit, argument: str) -> str:
    """PPRD hh aaaa: 64 bytes of a wired tool's memory."""
    address = _address(argument, wire.PVWR_SPACE_BYTES)
    tool = _tool(unit, argument, ErrorCode.CANNOT_READ_MEMORY)
    if tool.memory is None:
        raise Refusal(ErrorCode.CANNOT_READ_MEMORY)
    return tool.memory[address : address + wire.PVWR_BLOCK_BYTES].hex().upper()


def write(unit: Unit, argument: str) -> None:
    """PPWR hh aaaa and 64 bytes: kept in the tool."""
    address, content = _block(argument, wire.PVWR_SPACE_BYTES)
    tool = _tool(unit, argument, ErrorCode.CANNOT_WRITE_MEMORY)
    if tool.memory is None:
        raise Refusal(ErrorCode.CANNOT_WRITE_MEMORY)
    tool.memory[address : address + len(content)] = content
    port_of(unit, argument).memory[:] = tool.memory


def read_user_area(unit: Unit, argument: str) -> str:
    """PURD hh aaaa"""
    address = _address(argument, unit.behaviour.user_memory_bytes)
    tool = _tool(unit, argument, ErrorCode.CANNOT_READ_MEMORY)
    return tool.user_memory[address : address + wire.PVWR_BLOCK_BYTES].hex().upper()


def write_user_area(unit: Unit, argument: str) -> None:
    """PUWR hh aaaa and 64 bytes"""
    address, content = _block(argument, unit.behaviour.user_memory_bytes)
    tool = _tool(unit, argument, ErrorCode.CANNOT_WRITE_MEMORY)
    tool.user_memory[address : address + len(content)] = content


def search(unit: Unit, argument: str) -> str:
    """PSRCH hh: number and identifiers of the tool's memory devices."""
    tool = wired_port_of(unit, argument).tool
    return "0" if tool is None or tool.memory is None else f"1{tool.identifier}"


def select(unit: Unit, argument: str) -> None:
    """PSEL hh and the identifier of a memory device"""
    if len(argument) <= HANDLE_DIGITS:
        raise Refusal(ErrorCode.PARAMETER_COUNT)
    tool = wired_port_of(unit, argument).tool
    if tool is None or tool.memory is None or argument[HANDLE_DIGITS:].upper() != tool.identifier:
        raise Refusal(ErrorCode.CANNOT_SELECT_MEMORY)


def use_test_definition(unit: Unit, argument: str) -> None:
    """TTCFG hh: test definition for a tool without memory."""
    port = wired_port_of(unit, argument)
    if port.written and not unit.behaviour.replaces_definition_by_test:
        raise Refusal(ErrorCode.NOT_FOR_THIS_DEVICE)
    content = wiring_definition()
    port.memory[: len(content)] = content
    port.written = True


def test_current(unit: Unit, argument: str) -> None:
    """TCTST hh: the result is read by PHINF 0002."""
    port = wired_port_of(unit, argument)
    if initialised_port_of(unit, argument).definition is None:  # a dummy draws no current
        raise Refusal(ErrorCode.CURRENT_TEST_FAILED)
    port.current_test = _all_markers(port)


def light(unit: Unit, argument: str) -> None:
    """LED hh n s"""
    number, state = argument[HANDLE_DIGITS], argument[HANDLE_DIGITS + 1]
    if number not in LIGHTS:
        raise Refusal(ErrorCode.BAD_LED_NUMBER)
    if state not in LIGHT_STATES:
        raise Refusal(ErrorCode.BAD_LED_STATE)
    wired_port_of(unit, argument)
    initialised_port_of(unit, argument)


def general_purpose(unit: Unit, argument: str) -> None:
    """PSOUT hh abc"""
    if not OUTPUT_STATES.issuperset(argument[HANDLE_DIGITS:]):
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    wired_port_of(unit, argument)
    initialised_port_of(unit, argument)


def _all_markers(port: Port) -> int:
    return 0 if port.definition is None else (1 << len(port.definition.markers_mm)) - 1


def _address(argument: str, space_bytes: int) -> int:
    address = hexadecimal(argument[HANDLE_DIGITS:ADDRESSED])
    if address % wire.PVWR_BLOCK_BYTES or address + wire.PVWR_BLOCK_BYTES > space_bytes:
        raise Refusal(ErrorCode.OUT_OF_RANGE)
    return address


def _block(argument: str, space_bytes: int) -> tuple[int, bytes]:
    address = _address(argument, space_bytes)
    hexadecimal(argument[ADDRESSED:])
    return address, bytes.fromhex(argument[ADDRESSED:])


def _tool(unit: Unit, argument: str, without_memory: ErrorCode) -> WiredTool:
    port = port_of(unit, argument)
    if not port.wired_port and unit.behaviour.memory_of_passive == "1E/1F":
        raise Refusal(without_memory)
    tool = wired_port_of(unit, argument).tool
    if tool is None:
        raise Refusal(without_memory)
    return tool
