"""Features of transport, actions and user sets."""

from __future__ import annotations

from sim.basler.camera.features import Commands, Feature, Kind, always, constant, setting
from sim.basler.camera.settings import UserSet
from sim.basler.stream.channel import LARGEST_PACKET_SIZE, PACKET_SIZE_STEP, SMALLEST_PACKET_SIZE


def _set_packet_size(commands: Commands, value: int) -> None:
    commands.channel.packet_size = value


TRANSPORT = "TransportLayer"
ACTION = "ActionControl"
SETS = "UserSets"
TRANSPORT_FEATURES: tuple[Feature, ...] = (
    Feature(
        "PayloadSize",
        Kind.INTEGER,
        TRANSPORT,
        "Image data of one frame.",
        read=lambda commands: commands.settings.frame().payload_bytes,
        unit="B",
    ),
    constant("GevVersionMajor", TRANSPORT, "Version of the standard.", 1, visibility="Expert"),
    constant("GevVersionMinor", TRANSPORT, "Version of the standard.", 2, visibility="Expert"),
    Feature(
        "GevSCPSPacketSize",
        Kind.INTEGER,
        TRANSPORT,
        "Size of a stream packet with its IP and UDP headers.",
        read=lambda commands: commands.channel.packet_size,
        write=_set_packet_size,
        minimum=always(SMALLEST_PACKET_SIZE),
        maximum=always(LARGEST_PACKET_SIZE),
        step=PACKET_SIZE_STEP,
        unit="B",
        locked=True,
    ),
    setting(
        "TLParamsLocked",
        TRANSPORT,
        "1 while the client grabs: the format is locked.",
        "parameters_locked",
        minimum=always(0),
        maximum=always(1),
        visibility="Invisible",
    ),
    setting("ActionDeviceKey", ACTION, "Device key of accepted action commands.", "action_device_key"),
    setting(
        "ActionSelector",
        ACTION,
        "Action to which the following features apply.",
        "action_selector",
        minimum=always(1),
        maximum=always(1),
        selects=("ActionGroupKey", "ActionGroupMask"),
    ),
    setting("ActionGroupKey", ACTION, "Group of the selected action.", "action_group_key"),
    setting("ActionGroupMask", ACTION, "Mask of the group.", "action_group_mask"),
    setting(
        "UserSetSelector",
        SETS,
        "User set to load or save.",
        "user_set_selector",
        kind=Kind.ENUMERATION,
        entries={
            "Default": UserSet.DEFAULT,
            "UserSet1": UserSet.FIRST,
            "UserSet2": UserSet.SECOND,
            "UserSet3": UserSet.THIRD,
        },
        selects=("UserSetLoad", "UserSetSave"),
    ),
    Feature(
        "UserSetLoad",
        Kind.COMMAND,
        SETS,
        "Load the selected user set.",
        write=lambda it, _: it.load_user_set(),
        locked=True,
    ),
    Feature(
        "UserSetSave",
        Kind.COMMAND,
        SETS,
        "Save the current settings as the selected user set; Default is read-only.",
        write=lambda it, _: it.save_user_set(),
    ),
)
