"""What the cases for a Polaris unit and its driver share: needs, the tool they load, one frame by BX.

A case's number is P (the unit) or D (its driver) and a line of the checklist, with a letter if a line has
several cases. Every case leaves the unit initialised, idle and without tools.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from conformance.case import Need
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.bx_reply import Seen, read_body
from conformance.polaris.link import PolarisLink

POLARIS_BYTES = Need("polaris bytes", "the tracker has no single endpoint to which bytes could be sent")
TOOL_DEFINITION = Need("tool definition", "no tool definition is configured")
SERIAL_LINE = Need("serial line", "the endpoint is not a serial line: it has neither baud rate nor break")

NEEDS = (POLARIS_BYTES,)
WITH_TOOL = (*NEEDS, TOOL_DEFINITION)
SERIAL = (*NEEDS, SERIAL_LINE)


@runtime_checkable
class HoldsDefinitions(Protocol):
    """A tracker that reports which tool definitions it loads."""

    @property
    def definition_blocks(self) -> dict[str, bytes]:
        """Tool name -> content of its definition file."""
        ...


@runtime_checkable
class TellsBaud(Protocol):
    """A tracker that reports the rate of its serial line."""

    @property
    def baud(self) -> int | None:
        """Present rate; None if the line is not serial."""
        ...


def definition(dut: DeviceUnderTest) -> bytes:
    """The first tool definition that the driver would load."""
    tracker = dut.make()
    assert isinstance(tracker, HoldsDefinitions), "the case needs a tool definition"
    return next(iter(tracker.definition_blocks.values()))


def seen(unit: PolarisLink, options: int = 0x0001) -> Seen:
    """The frame by BX with these options."""
    return read_body(unit.binary(f"BX:{options:04X}"), options)
