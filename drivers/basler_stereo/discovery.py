"""Who is at an address: the bootstrap memory that a device sends to anyone who asks."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.basler_stereo.control import ControlChannel
from drivers.basler_stereo.errors import (
    BrokenAnswer,
    CablesSwapped,
    NoAnswer,
    NoCamera,
    WrongModel,
    WrongSerial,
)
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.wire import gige_vision as gev
from ronna_hw.wire.gige_vision import Bootstrap


@dataclass(frozen=True)
class CameraIdentity:
    """What one camera says about itself."""

    address: str
    mac: str
    vendor: str
    model: str
    serial: str
    version: str
    user_name: str


def identify(control: ControlChannel, deadline_s: float) -> CameraIdentity:
    """Ask the device at the channel's address who it is; raises GEV-001, GEV-008."""
    try:
        memory = control.discover(deadline_s)
    except NoAnswer as error:
        raise NoCamera(f"no camera answers at {control.address}", awaited="a discovery answer") from error
    return decode_identity(memory, control.address)


def decode_identity(memory: bytes, address: str) -> CameraIdentity:
    """The identity in a discovery answer; raises GEV-008."""
    if len(memory) != gev.DISCOVERY_BYTES:
        raise BrokenAnswer(
            f"{address}: a discovery answer of {len(memory)} bytes",
            awaited=str(gev.DISCOVERY_BYTES),
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


def check_pair(left: CameraIdentity, right: CameraIdentity, options: BaslerOptions) -> None:
    """Raise GEV-002, GEV-003 or GEV-004 unless these are the theatre file's cameras, each on its side."""
    for identity in (left, right):
        if options.expected_model and identity.model != options.expected_model:
            raise WrongModel(
                f"another device at {identity.address}",
                awaited=options.expected_model,
                last=f"{identity.vendor} {identity.model}".strip(),
            )
    wanted = (options.left_serial, options.right_serial)
    if left.serial == right.serial:
        raise WrongSerial(f"{left.address} and {right.address} are the same camera", last=left.serial)
    if _matches((left.serial, right.serial), wanted):
        return
    if _matches((right.serial, left.serial), wanted):
        raise CablesSwapped(
            "the cameras answer at each other's address",
            awaited=f"left {wanted[0]}, right {wanted[1]}",
            last=f"left {left.serial}, right {right.serial}",
        )
    for side, identity, serial in (("left", left, wanted[0]), ("right", right, wanted[1])):
        if serial is not None and identity.serial != serial:
            raise WrongSerial(f"another camera is the {side} one", awaited=serial, last=identity.serial)


def pair_identity(left: CameraIdentity, right: CameraIdentity) -> Identity:
    """Both cameras as the identity of one device."""
    return Identity(
        vendor=left.vendor,
        model=left.model,
        serial=f"{left.serial}+{right.serial}",
        firmware=left.version,
        details=(
            ("left", f"{left.serial} {left.mac} {left.address} {left.version}"),
            ("right", f"{right.serial} {right.mac} {right.address} {right.version}"),
        ),
    )


def _matches(serials: tuple[str, str], wanted: tuple[str | None, str | None]) -> bool:
    return all(want is None or serial == want for serial, want in zip(serials, wanted, strict=True))


def _text(memory: bytes, register: Bootstrap) -> str:
    field = memory[register : register + gev.TEXT_BYTES[register]]
    return field.split(b"\0", 1)[0].decode("utf-8", errors="replace").strip()
