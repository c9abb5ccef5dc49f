"""A unit of the simulated tracker and a host that sends it command lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ronna_hw.wire.polaris import PVWR_BLOCK_BYTES, crc16
from sim.polaris.line.interpreter import CommandInterpreter
from sim.polaris.tracker_unit import SimulatedUnit
from sim.polaris.unit.tool_definition import write_definition
from sim.world.scene.model import TrackerTool
from sim.world.world import World

ROM_BYTES_SENT = 768  # clients pad to whole blocks


@dataclass
class Bench:
    """One unit and one host that sends whole lines."""

    world: World
    unit: SimulatedUnit
    interpreter: CommandInterpreter

    def send(self, line: str) -> str:
        """Send a line without CRC; return the reply, its CRC checked and removed."""
        return text_of(self.interpreter.reply(line.encode("latin-1")))

    def send_with_crc(self, line: str) -> str:
        """Send a line with CRC, up to and including its colon; return the reply without CRC."""
        return text_of(self.interpreter.reply(f"{line}{crc16(line.encode()):04X}".encode()))

    def raw(self, line: str) -> bytes:
        """Send a line without CRC; return the bytes of the reply."""
        return self.interpreter.reply(line.encode("latin-1"))

    def ready(self) -> Bench:
        """Initialise the unit."""
        assert self.send("INIT ") == "OKAY"
        return self

    def track(self, *tools: TrackerTool) -> Bench:
        """Enable tools and start tracking."""
        for tool in tools:
            self.enable(tool)
        assert self.send("TSTART 80") == "OKAY"
        return self

    def disturb(self, *lines: str) -> None:
        """Replace the fault script by faults of the tracker that act from the beginning."""
        self.world.set_fault_script("\n".join(f"at 0 s: tracker {line}" for line in lines))

    def value(self, name: str) -> str:
        """Value of a parameter in the reply to GET."""
        return self.send(f"GET {name}").partition("=")[2]

    def load(self, content: bytes) -> int:
        """Request a handle and write a definition to it."""
        handle = int(self.send("PHRQ *********1****"), 16)
        padded = content.ljust(ROM_BYTES_SENT, b"\0")
        for address in range(0, ROM_BYTES_SENT, PVWR_BLOCK_BYTES):
            block = padded[address : address + PVWR_BLOCK_BYTES].hex()
            assert self.send(f"PVWR {handle:02X}{address:04X}{block}") == "OKAY"
        return handle

    def enable(self, tool: TrackerTool) -> int:
        """Load, initialise and enable a tool; a tool loaded twice raises a warning."""
        handle = self.load(write_definition(tool))
        assert not self.send(f"PINIT {handle:02X}").startswith("ERROR")
        assert self.send(f"PENA {handle:02X}D") == "OKAY"
        return handle


def text_of(reply: bytes) -> str:
    """Text of an ASCII reply; its CRC must be right."""
    assert reply.endswith(b"\r")
    content, crc = reply[:-5], reply[-5:-1]
    assert crc == b"%04X" % crc16(content)
    return content.decode("latin-1")


MakeBench = Callable[..., Bench]  # with a scene, a model, or behaviour of the unit
