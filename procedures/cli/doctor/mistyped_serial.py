"""A camera of the calibration record whose serial number was mistyped in the options."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import Diagnostic


def mistyped_serials(
    found: Sequence[Diagnostic], device: DeviceConfig, head: StereoHeadCalibration
) -> tuple[Diagnostic, ...]:
    """The findings at the cameras, with that advice where a refused one is the camera that was calibrated."""
    sides = {"left": head.left.serial, "right": head.right.serial}
    advised = list(found)
    for side, recorded in sides.items():
        typed = device.options.get(f"{side}_serial")
        if not isinstance(typed, str) or typed == recorded:
            continue
        advice = (
            f'{side}_serial = "{typed}" is probably mistyped: the calibration record of the {side} camera '
            f"names {recorded}, which was found. Correct it in the theatre file."
        )
        advised = [
            replace(one, advice=advice)
            if not one.well and typed in one.seen and recorded in one.seen
            else one
            for one in advised
        ]
    return tuple(advised)
