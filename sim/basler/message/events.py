"""Events of the camera family by name, and their wire format."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ronna_hw.wire.gige_vision import EVENT_ITEM

STREAM_CHANNEL = 0
FRAME_NUMBER = ">I"  # additional field of ExposureEnd beyond the standard's


class EventKind(IntEnum):
    """Entries of EventSelector; the values are the ids on the wire.

    A vendor's ids begin at 0x9000; their assignment in real firmware is unconfirmed. A client reads them
    from the description.
    """

    EXPOSURE_END = 0x9001
    FRAME_START_OVERTRIGGER = 0x9002
    ACQUISITION_START_OVERTRIGGER = 0x9003
    FRAME_START = 0x9004
    ACQUISITION_START = 0x9005
    EVENT_OVERRUN = 0x9006

    @property
    def feature_name(self) -> str:
        """The entry as spelled in the family."""
        return "".join(word.capitalize() for word in self.name.split("_"))


@dataclass(frozen=True)
class Event:
    """An event: block id 0 if no frame belongs to it; `data` is sent as EVENTDATA."""

    kind: EventKind
    block_id: int
    stamp_ticks: int
    data: bytes = b""

    def encoded(self) -> bytes:
        """Its bytes in a message."""
        head = struct.pack(EVENT_ITEM, 0, self.kind, STREAM_CHANNEL, self.block_id, self.stamp_ticks)
        return head + self.data
