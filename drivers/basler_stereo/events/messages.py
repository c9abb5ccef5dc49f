"""Event messages of a camera: decoded from bytes, and counted. No I/O."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from drivers.basler_stereo.features.description import Node
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import GvcpCommand, GvcpFlag

EXPOSURE_END = "ExposureEnd"
MISSED_TRIGGERS = ("FrameStartOvertrigger", "AcquisitionStartOvertrigger")
EVENT_OVERRUN = "EventOverrun"
WANTED = (EXPOSURE_END, *MISSED_TRIGGERS, EVENT_OVERRUN)
"""The events we subscribe to, by their EventSelector names."""

_HEADER = struct.Struct(gev.GVCP_COMMAND_HEADER)
_ITEM = struct.Struct(gev.EVENT_ITEM)
_ACK = struct.Struct(gev.GVCP_ACK_HEADER)


class EventItem(NamedTuple):
    """One event of a message: its id, the frame it belongs to (0: none), the camera's tick count."""

    event_id: int
    block_id: int
    ticks: int


@dataclass(frozen=True)
class EventMessage:
    """One decoded message."""

    request_id: int
    command: int
    wants_acknowledge: bool
    items: tuple[EventItem, ...]

    def acknowledge(self) -> bytes:
        """The acknowledge, after which the camera stops repeating it."""
        return _ACK.pack(gev.GevStatus.SUCCESS, self.command + 1, 0, self.request_id)


@dataclass
class EventCounters:
    """What a camera has reported since it was configured."""

    exposures: int = 0
    missed_triggers: int = 0  # frame or acquisition triggers that came while the camera was busy
    overruns: int = 0  # the camera had more events than it could send: the other counts are too low
    others: int = 0
    repeated_messages: int = 0  # our acknowledge came late or was lost

    def count(self, name: str | None) -> None:
        """Count one event by its name."""
        if name == EXPOSURE_END:
            self.exposures += 1
        elif name in MISSED_TRIGGERS:
            self.missed_triggers += 1
        elif name == EVENT_OVERRUN:
            self.overruns += 1
        else:
            self.others += 1


def decode_message(datagram: bytes) -> EventMessage | None:
    """A message with events, or None for anything else."""
    if len(datagram) < gev.GVCP_HEADER_BYTES:
        return None
    key, flags, command, length, request_id = _HEADER.unpack_from(datagram)
    payload = datagram[gev.GVCP_HEADER_BYTES :]
    if key != gev.GVCP_KEY or len(payload) != length or length < gev.EVENT_ITEM_BYTES:
        return None
    if (
        command == GvcpCommand.EVENT
        and length % gev.EVENT_ITEM_BYTES == 0
        and not flags & GvcpFlag.EXTENDED_ID
    ):
        pieces = range(0, length, gev.EVENT_ITEM_BYTES)
    elif command == GvcpCommand.EVENTDATA and not flags & GvcpFlag.EXTENDED_ID:
        pieces = range(0, 1)
    else:
        return None
    items = []
    for start in pieces:
        _, event_id, _, block_id, ticks = _ITEM.unpack_from(payload, start)
        items.append(EventItem(event_id, block_id, ticks))
    return EventMessage(request_id, command, bool(flags & GvcpFlag.ACK_REQUIRED), tuple(items))


def event_ids(nodes: Mapping[str, Node]) -> dict[int, str]:
    """Names of the wanted events by their id on the wire, as far as the description gives it.

    An event's value, such as its time stamp, belongs to a port that carries the id.
    """
    found: dict[int, str] = {}
    for name in WANTED:
        feature = nodes.get(f"{name}EventTimestamp")
        register = _named_by(nodes, feature, "pValue") or feature
        port = _named_by(nodes, register, "pPort")
        text = port.text("EventID") if port else None
        with contextlib.suppress(ValueError):
            found[int(text or "", 16)] = name
    return found


def _named_by(nodes: Mapping[str, Node], node: Node | None, tag: str) -> Node | None:
    return nodes.get(node.text(tag) or "") if node else None
