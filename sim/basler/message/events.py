"""Events of the camera family by name, and their form on the wire."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ronna_hw.wire.gige_vision import EVENT_ITEM

STREAM_CHANNEL = 0
FRAME_NUMBER = ">I"  # what an ExposureEnd carries beside the standard's fields


class EventKind(IntEnum):
    """Entries of EventSelector; the values are the ids on the wire.

    A vendor's ids begin at 0x9000; which of them the real firmware gives to which event is unconfirmed. A
    client takes them from the description.
    """

    EXPOSURE_END = 0x9001
    FRAME_START_OVERTRIGGER = 0x9002
    ACQUISITION_START_OVERTRIGGER = 0x9003
    FRAME_START = 0x9004
    ACQUISITION_START = 0x9005
    EVENT_OVERRUN = 0x9006

    @property
    def feature_name(self) -> str:
        """The entry as the family spells it."""
        return "".join(word.capitalize() for word in self.name.split("_"))


@dataclass(frozen=True)
class Event:
    """Something that happened: block id 0 when no frame belongs to it; `data` goes as EVENTDATA."""

    kind: EventKind
    block_id: int
    stamp_ticks: int
    data: bytes = b""

    def encoded(self) -> bytes:
        """Its bytes in a message."""
        head = struct.pack(EVENT_ITEM, 0, self.kind, STREAM_CHANNEL, self.block_id, self.stamp_ticks)
        return head + self.data
