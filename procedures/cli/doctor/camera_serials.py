"""Verdicts on serial numbers of cameras: the options' and the records', compared with what replied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import Diagnostic

SIDES = ("left", "right")


def camera_endpoint(device: DeviceConfig, side: str) -> str:
    """The endpoint of the camera of a side; of cameras without one of their own, the side."""
    return str(device.address(side)) if side in device.endpoints else side


def advise_on_serials(
    found: Sequence[Diagnostic], device: DeviceConfig, head: StereoHeadCalibration
) -> tuple[Diagnostic, ...]:
    """The findings at the cameras; a refused one gets the verdict on the serial number of its side.

    The refusal of the whole pair repeats the advice of its first refused camera, if there is one.
    """
    replied = {endpoint: serial for one in found for endpoint, serial in one.serials.items()}
    verdicts = {}
    for side in SIDES:
        endpoint = camera_endpoint(device, side)
        if endpoint in replied:
            verdicts[endpoint] = _verdict(side, endpoint, replied, device, head)
    first = next((verdict for verdict in verdicts.values() if verdict), "")
    cameras_well = all(one.well for one in found if one.serials)
    given: dict[str, str] = {}  # the driver's advice -> ours
    advised = []
    for one in found:
        advice = next((verdicts[each] for each in one.serials if each in verdicts), "")
        if None in one.serials.values():  # only the driver knows why
            advice = f"{advice} {one.advice}".rstrip()
        if not one.serials:
            advice = first if cameras_well else given.get(one.advice, "")
        if not one.well and advice:
            given[one.advice] = advice
            advised.append(replace(one, advice=advice))
        else:
            advised.append(one)
    return tuple(advised)


def _verdict(
    side: str,
    endpoint: str,
    replied: Mapping[str, str | None],
    device: DeviceConfig,
    head: StereoHeadCalibration,
) -> str:
    """State what is wrong with the camera of a side; empty if nothing is, or the driver says where it is."""
    there = replied[endpoint]
    recorded = {"left": head.left.serial, "right": head.right.serial}
    configured = str(device.options.get(f"{side}_serial") or recorded[side])
    others = {serial: at for at, serial in replied.items() if serial is not None and at != endpoint}
    found = ", ".join(dict.fromkeys([*filter(None, [there]), *others])) or "none"
    not_found = f"was not found (serial numbers found: {found})"
    if there is None:
        return f"The {side} camera {configured} {not_found}."
    swapped = there != recorded[side] and there in recorded.values()
    if swapped or (there != configured and configured in others):
        return ""
    if there == configured == recorded[side]:
        return ""
    if there == recorded[side]:
        cause = "is probably mistyped" if _differ_by_a_typing_error(configured, there) else not_found
        return (
            f'{side}_serial = "{configured}" {cause}: camera {there} replied in its place and is the one in '
            f"the calibration record. Correct it in the theatre file."
        )
    where = f"replied at {others[recorded[side]]}" if recorded[side] in others else "was not found"
    set_it = "" if there == configured else f' and set {side}_serial = "{there}"'
    return (
        f"The {side} camera was exchanged: {there} replied, the calibration record is of {recorded[side]}, "
        f"which {where}. Mount {recorded[side]} again, or calibrate the head with {there}{set_it}."
    )


def _differ_by_a_typing_error(one: str, other: str) -> bool:
    """Whether one character is wrong, missing or too many, or two neighbours are exchanged."""
    if len(one) == len(other):
        wrong = [place for place in range(len(one)) if one[place] != other[place]]
        first, last = wrong[0], wrong[-1] + 1
        return len(wrong) == 1 or (last - first == 2 and one[first:last] == other[first:last][::-1])
    shorter, longer = sorted((one, other), key=len)
    return any(longer[:place] + longer[place + 1 :] == shorter for place in range(len(longer)))
