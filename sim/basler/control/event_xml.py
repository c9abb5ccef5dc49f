"""The events in the GenICam description: their data, and its position in a message.

The nodes are on ports of their own, one per kind of event, which a client fills from messages; their
addresses are offsets in an item of the message.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

from ronna_hw.wire.gige_vision import EVENT_ITEM_BYTES
from sim.basler.message.events import EventKind


@dataclass(frozen=True)
class EventData:
    """One value of one kind of event; `place` is its offset in an item."""

    kind: EventKind
    what: str
    place: int
    length: int
    about: str

    @property
    def name(self) -> str:
        """Spelled as in the family."""
        return f"{self.kind.feature_name}Event{self.what}"

    @property
    def category(self) -> str:
        """Its category for clients."""
        return f"{self.kind.feature_name}EventData"

    @property
    def port(self) -> str:
        """The port of this kind of event."""
        return f"{self.kind.feature_name}EventPort"


def _all_data() -> Iterator[EventData]:
    for kind in EventKind:
        yield EventData(kind, "StreamChannelIndex", 4, 2, "Stream channel of the event.")
        if kind is EventKind.EXPOSURE_END:
            yield EventData(kind, "FrameID", EVENT_ITEM_BYTES, 4, "Block ID of the exposed frame.")
        yield EventData(kind, "Timestamp", 8, 8, "Time of the event, ticks.")


EVENT_DATA = tuple(_all_data())


def add_event_data(root: ElementTree.Element) -> None:
    """Add nodes, registers and ports of all kinds of events."""
    for data in EVENT_DATA:
        node = _named(root, "Integer", data.name)
        _text(node, "ToolTip", data.about)
        _text(node, "pValue", f"{data.name}Register")
        register = _named(root, "IntReg", f"{data.name}Register")
        for tag, text in (
            ("Address", f"0x{data.place:X}"),
            ("Length", str(data.length)),
            ("AccessMode", "RO"),
            ("pPort", data.port),
            ("Cachable", "NoCache"),
            ("Sign", "Unsigned"),
            ("Endianess", "BigEndian"),
        ):
            _text(register, tag, text)
    for kind in EventKind:
        port = _named(root, "Port", f"{kind.feature_name}EventPort")
        _text(port, "EventID", f"{kind:x}")


def _named(root: ElementTree.Element, tag: str, name: str) -> ElementTree.Element:
    return ElementTree.SubElement(root, tag, {"Name": name, "NameSpace": "Standard"})


def _text(node: ElementTree.Element, tag: str, text: str) -> None:
    ElementTree.SubElement(node, tag).text = text
