"""Register table of all features in address order: value, minimum, maximum and increment.

Names are those of the camera family (SFNC 1.x). Features of transport, actions, user sets and events are
defined here, those of frames in `capture_features`, those of lines in `output_line`.
"""

from __future__ import annotations

import math
import struct

from ronna_hw.wire.gige_vision import GevStatus
from sim.basler.camera.capture_features import (
    ACQUISITION_FEATURES,
    ANALOG_FEATURES,
    EXPOSURE_FEATURES,
    IMAGE_FEATURES,
)
from sim.basler.camera.features import (
    Feature,
    FeatureState,
    Kind,
    Limit,
    Number,
    choice,
    command,
    constant,
    in_category,
    resolve_limit,
    setting,
)
from sim.basler.control.output_line import LINE_FEATURES
from sim.basler.control.registers import RegisterMap, RegisterRefusal, RegisterWord
from sim.basler.settings import EventKind, UserSet
from sim.basler.stream_channel import LARGEST_PACKET_SIZE, PACKET_SIZE_STEP, SMALLEST_PACKET_SIZE


def _set_packet_size(camera: FeatureState, value: int) -> None:
    camera.channel.packet_size = value


TRANSPORT_FEATURES = in_category(
    "TransportLayer",
    Feature(
        "PayloadSize",
        "Image data of one frame.",
        read=lambda camera: camera.settings.frame().payload_bytes,
        unit="B",
    ),
    constant("GevVersionMajor", "Version of the standard.", 1, visibility="Expert"),
    constant("GevVersionMinor", "Version of the standard.", 2, visibility="Expert"),
    Feature(
        "GevSCPSPacketSize",
        "Size of a stream packet with its IP and UDP headers.",
        read=lambda camera: camera.channel.packet_size,
        write=_set_packet_size,
        limits=(SMALLEST_PACKET_SIZE, LARGEST_PACKET_SIZE),
        step=PACKET_SIZE_STEP,
        unit="B",
        locked=True,
    ),
    setting(
        "TLParamsLocked",
        "1 while the client grabs: the format is locked.",
        "parameters_locked",
        limits=(0, 1),
        visibility="Invisible",
    ),
)
ACTION_FEATURES = in_category(
    "ActionControl",
    setting("ActionDeviceKey", "Device key of accepted action commands.", "action_device_key"),
    setting(
        "ActionSelector",
        "Action to which the following features apply.",
        "action_selector",
        limits=(1, 1),
        selects=("ActionGroupKey", "ActionGroupMask"),
    ),
    setting("ActionGroupKey", "Group of the selected action.", "action_group_key"),
    setting("ActionGroupMask", "Mask of the group.", "action_group_mask"),
)
USER_SET_FEATURES = in_category(
    "UserSets",
    choice(
        "UserSetSelector",
        "User set to load or save.",
        "user_set_selector",
        entries={
            "Default": UserSet.DEFAULT,
            "UserSet1": UserSet.FIRST,
            "UserSet2": UserSet.SECOND,
            "UserSet3": UserSet.THIRD,
        },
        selects=("UserSetLoad", "UserSetSave"),
    ),
    command("UserSetLoad", "Load the selected user set.", lambda camera: camera.load_user_set(), locked=True),
    command(
        "UserSetSave",
        "Save the current settings as the selected user set; Default is read-only.",
        lambda camera: camera.save_user_set(),
    ),
)


OFF, ON = 0, 1


def _set_notified(camera: FeatureState, value: int) -> None:
    settings = camera.settings
    other_events = settings.events_notified - {settings.event_selector}
    settings.events_notified = other_events | {settings.event_selector} if value == ON else other_events


EVENT_FEATURES = in_category(
    "EventsGeneration",
    choice(
        "EventSelector",
        "Event to which EventNotification applies.",
        "event_selector",
        entries={kind.feature_name: int(kind) for kind in EventKind},
        selects=("EventNotification",),
    ),
    Feature(
        "EventNotification",
        "Report the selected event on the message channel.",
        Kind.ENUMERATION,
        read=lambda camera: int(camera.settings.event_selector in camera.settings.events_notified),
        write=_set_notified,
        entries={"Off": OFF, "On": ON},
    ),
)

FEATURES: tuple[Feature, ...] = (
    *IMAGE_FEATURES,
    *ACQUISITION_FEATURES,
    *EXPOSURE_FEATURES,
    *ANALOG_FEATURES,
    *TRANSPORT_FEATURES,
    *ACTION_FEATURES,
    *USER_SET_FEATURES,
    *EVENT_FEATURES,
    *LINE_FEATURES,
)


FEATURES_ADDRESS = 0x20000  # the standard's own addresses end below 0xA000
BYTES_PER_FEATURE = 16
ADDRESSES = {
    feature.name: FEATURES_ADDRESS + number * BYTES_PER_FEATURE for number, feature in enumerate(FEATURES)
}
MINIMUM_OFFSET, MAXIMUM_OFFSET, STEP_OFFSET = 4, 8, 12


def address_of(name: str) -> int:
    """Return the address of a feature's value."""
    return ADDRESSES[name]


def add_features(registers: RegisterMap, camera: FeatureState) -> None:
    """Add the registers of all features."""
    for feature in FEATURES:
        address = address_of(feature.name)
        registers.add(address, _value_register(feature, camera))
        for offset, limit in zip((MINIMUM_OFFSET, MAXIMUM_OFFSET), feature.limits or (), strict=False):
            registers.add(address + offset, _limit_register(feature, limit, camera))
        if feature.limits and feature.kind is Kind.INTEGER:
            registers.add(address + STEP_OFFSET, _limit_register(feature, feature.step, camera))


def _value_register(feature: Feature, camera: FeatureState) -> RegisterWord:
    def read() -> int:
        # A command is never pending: it is done once its register has been written.
        return 0 if feature.read is None else _encode(feature, feature.read(camera))

    def write(word: int) -> None:
        assert feature.write is not None
        if feature.locked and camera.acquisition.running:
            raise RegisterRefusal(GevStatus.BUSY)
        value = _decode(feature, word)
        if not feature.accepts(camera, value):
            raise RegisterRefusal(GevStatus.INVALID_PARAMETER)
        feature.write(camera, value)

    return RegisterWord(read, None if feature.write is None else write)


def _limit_register(feature: Feature, limit: Limit, camera: FeatureState) -> RegisterWord:
    return RegisterWord(lambda: _encode(feature, resolve_limit(limit, camera)))


def _encode(feature: Feature, value: Number) -> int:
    if feature.kind is Kind.FLOAT:
        return int(struct.unpack(">I", struct.pack(">f", value))[0])
    return int(value)


def _decode(feature: Feature, word: int) -> Number:
    if feature.kind is not Kind.FLOAT:
        return word
    value = float(struct.unpack(">f", struct.pack(">I", word))[0])
    return value if math.isfinite(value) else math.nan
