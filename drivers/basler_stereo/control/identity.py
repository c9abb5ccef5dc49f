"""Identity of the device at an address, from the bootstrap registers in its reply to GVCP discovery."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.basler_stereo.control.channel import ControlChannel
from drivers.basler_stereo.errors import MalformedReply, NoCamera, NoReply
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap


@dataclass(frozen=True)
class CameraIdentity:
    """Identity of one camera from its bootstrap registers."""

    address: str
    mac: str
    vendor: str
    model: str
    serial: str
    version: str
    user_name: str


def identify(control: ControlChannel, deadline_s: float) -> CameraIdentity:
    """Identify the device at the channel's address; raises GEV-001, GEV-008."""
    try:
        memory = control.discover(deadline_s)
    except NoReply as error:
        raise NoCamera(f"no camera replied at {control.address}", expected="a reply to discovery") from error
    return decode_identity(memory, control.address)


def decode_identity(memory: bytes, address: str) -> CameraIdentity:
    """The identity in a reply to discovery; raises GEV-008."""
    if len(memory) != gev.DISCOVERY_BYTES:
        raise MalformedReply(
            f"{address}: the reply to discovery has the wrong length",
            expected=f"{gev.DISCOVERY_BYTES} bytes",
            got=f"{len(memory)} bytes",
            wire=memory[:16],
        )
    (high,) = struct.unpack_from(">H", memory, Bootstrap.MAC_HIGH + 2)
    (low,) = struct.unpack_from(">I", memory, Bootstrap.MAC_LOW)
    return CameraIdentity(
        address=address,
        mac=(high << 32 | low).to_bytes(6, "big").hex(":"),
        vendor=_text(memory, Bootstrap.MANUFACTURER_NAME),
        model=_text(memory, Bootstrap.MODEL_NAME),
        serial=_text(memory, Bootstrap.SERIAL_NUMBER),
        version=_text(memory, Bootstrap.DEVICE_VERSION),
        user_name=_text(memory, Bootstrap.USER_DEFINED_NAME),
    )


def _text(memory: bytes, register: Bootstrap) -> str:
    field = memory[register : register + gev.TEXT_BYTES[register]]
    return field.split(b"\0", 1)[0].decode("utf-8", errors="replace").strip()
