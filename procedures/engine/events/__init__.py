"""What happens in a case, as one numbered stream that everybody reads: journal, terminal, console, links."""

from procedures.engine.events.event import Event
from procedures.engine.events.happenings import (
    Answered,
    CaseState,
    DeviceAge,
    DeviceState,
    Fault,
    Finding,
    Happening,
    JournalLine,
    Pose,
    Progress,
    Questioned,
    Refusal,
    StepState,
)
from procedures.engine.events.stream import Batch, EventStream, Reader

__all__ = [
    "Answered",
    "Batch",
    "CaseState",
    "DeviceAge",
    "DeviceState",
    "Event",
    "EventStream",
    "Fault",
    "Finding",
    "Happening",
    "JournalLine",
    "Pose",
    "Progress",
    "Questioned",
    "Reader",
    "Refusal",
    "StepState",
]
