"""The suite of cases about a unit that speaks the NDI Polaris protocol, and what they share.

The number of a case is P (what the unit does) or D (what its driver does) and a line of the protocol's
checklist; a letter tells several cases of one line apart. Every case leaves the unit initialised, idle and
without tools.
"""

from __future__ import annotations

from ronna_hw.conformance.case import Suite
from ronna_hw.conformance.device_under_test import DeviceUnderTest
from ronna_hw.conformance.polaris.bx_reply import Seen, read_body
from ronna_hw.conformance.polaris.link import PolarisLink

POLARIS_UNIT = Suite("polaris unit", driver="ndi_polaris", simulator=())
case = POLARIS_UNIT.case

NEEDS = ("polaris bytes",)
WITH_TOOL = (*NEEDS, "tool definition")
SERIAL = (*NEEDS, "serial line")
LOOKS = 20  # frames looked at where one alone proves little


def definition(dut: DeviceUnderTest) -> bytes:
    """The first tool definition that the driver would send."""
    blocks: dict[str, bytes] = dut.make().definition_blocks
    return next(iter(blocks.values()))


def seen(unit: PolarisLink, options: int = 0x0001) -> Seen:
    """The frame by BX with these options."""
    return read_body(unit.binary(f"BX:{options:04X}"), options)
