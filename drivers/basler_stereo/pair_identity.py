"""Checks that two cameras are the pair expected by the theatre file, and combines their identities."""

from __future__ import annotations

from drivers.basler_stereo.control.identity import CameraIdentity
from drivers.basler_stereo.errors import CablesSwapped, WrongModel, WrongSerial
from drivers.basler_stereo.options import BaslerOptions
from ronna_hw.devices.lifecycle import Identity


def check_pair(left: CameraIdentity, right: CameraIdentity, options: BaslerOptions) -> None:
    """Raise GEV-002, GEV-003 or GEV-004 unless these are the expected cameras, each on its side."""
    for identity in (left, right):
        if options.expected_model and identity.model != options.expected_model:
            raise WrongModel(
                f"unexpected device at {identity.address}",
                expected=options.expected_model,
                got=f"{identity.vendor} {identity.model}".strip(),
            )
    wanted = (options.left_serial, options.right_serial)
    if left.serial == right.serial:
        raise WrongSerial(f"{left.address} and {right.address} are the same camera", got=left.serial)
    if _matches((left.serial, right.serial), wanted):
        return
    if _matches((right.serial, left.serial), wanted):
        raise CablesSwapped(
            "left and right camera are swapped",
            expected=f"left {wanted[0]}, right {wanted[1]}",
            got=f"left {left.serial}, right {right.serial}",
        )
    for side, identity, serial in (("left", left, wanted[0]), ("right", right, wanted[1])):
        if serial is not None and identity.serial != serial:
            raise WrongSerial(f"unexpected camera on the {side} side", expected=serial, got=identity.serial)


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
