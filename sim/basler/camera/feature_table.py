"""All features, in the order of their registers. Names as in the camera family (SFNC 1.x).

Those that select which events are reported are here, the others in modules of their own.
"""

from __future__ import annotations

from sim.basler.camera.acquisition_features import ACQUISITION_FEATURES
from sim.basler.camera.exposure_features import EXPOSURE_FEATURES
from sim.basler.camera.features import Commands, Feature, Kind, setting
from sim.basler.camera.image_features import IMAGE_FEATURES
from sim.basler.camera.transport_features import TRANSPORT_FEATURES
from sim.basler.message.events import EventKind

EVENTS = "EventsGeneration"
OFF, ON = 0, 1


def _notified(commands: Commands) -> int:
    return int(commands.settings.event_selector in commands.settings.events_notified)


def _notify(commands: Commands, value: int) -> None:
    settings = commands.settings
    others = settings.events_notified - {settings.event_selector}
    settings.events_notified = others | {settings.event_selector} if value == ON else others


EVENT_FEATURES: tuple[Feature, ...] = (
    setting(
        "EventSelector",
        EVENTS,
        "Event to which EventNotification applies.",
        "event_selector",
        kind=Kind.ENUMERATION,
        entries={kind.feature_name: int(kind) for kind in EventKind},
        selects=("EventNotification",),
    ),
    Feature(
        "EventNotification",
        Kind.ENUMERATION,
        EVENTS,
        "Report the selected event on the message channel.",
        read=_notified,
        write=_notify,
        entries={"Off": OFF, "On": ON},
    ),
)

FEATURES: tuple[Feature, ...] = (
    IMAGE_FEATURES + ACQUISITION_FEATURES + EXPOSURE_FEATURES + TRANSPORT_FEATURES + EVENT_FEATURES
)
