"""Inspection of each device's readiness for a case, through the connection opened by the driver's probe.

The facts come through the typed interfaces of the devices, so they are the same for every driver. Nothing
moves: an arm is configured, which takes its port, and never activated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

from procedures.cli.doctor.pictures import pair_diagnostics
from procedures.cli.doctor.theatre_checks import TOOL, run_check
from procedures.planning.errors import SPHERES_NOT_TRACKED
from procedures.planning.tool_records import ToolRecords, check_patient_frame
from procedures.relocalization.triangulation import check_serial
from procedures.workcell import tools
from procedures.workcell.line_look import require_scanner
from procedures.workcell.stereo_look import FURTHER_TRIES
from procedures.workcell.tracker_look import add_frame_spheres, find_frame_name
from ronna_hw.calibration import StereoHeadCalibration
from ronna_hw.config import Calibrations, DeviceConfig, TheatreFile
from ronna_hw.devices import OpticalTracker, RobotArm, StereoPair
from ronna_hw.devices.capabilities import TellsReadiness
from ronna_hw.devices.lifecycle import Device, Identity
from ronna_hw.devices.probing import Diagnostic, fact_diagnostics, picture_diagnostics, refusal
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.robot import ConfirmedStart
from ronna_hw.devices.sensors import line_projector, reports_strays
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.roles import ASSISTANT, MASTER, TWO_ARMS
from ronna_hw.theatre import require_interface, required_interface

SIDES = ("left", "right")
STEREO = "stereo"  # table of the cameras
ARM_RECORD = "calibration of the arm"
ARE_TWO = "arms of master and assistant"
TURN_FRAME = "Clear the line of sight between the tracker and the head clamp; turn the frame or the tracker."
TURN_CART = "Clear the line of sight between the tracker and the arm; turn the cart or the tracker."
FRAMES_LOOKED_AT = 30  # half a second of tracking
PAIRS_LOOKED_AT = 50  # a hundred pictures
LEAST_SPHERES = 3  # for a registration by spheres alone
FEW_SPHERES = (
    f"A case by spheres alone needs at least {LEAST_SPHERES} on the head; one that scans the skin, those of "
    "its plan, or none."
)
OF_ONE_OF_ITS_MODEL = (
    "Controller and record do not both name a serial number: that [calibration.{}] is of this very arm, not "
    "of another of its model, was not checked."
)
OF_THIS_ARM = f"{OF_ONE_OF_ITS_MODEL.format('arm')} ronna-arm check measures whether it fits."
WHOSE_RECORD = {MASTER: OF_THIS_ARM, ASSISTANT: OF_ONE_OF_ITS_MODEL.format("assistant_arm")}


def camera_endpoint(device: DeviceConfig, side: str) -> str:
    """Return the endpoint of the camera on one side, or the side itself if both cameras share an endpoint."""
    return str(device.address(side)) if side in device.endpoints else side


def advise_on_serials(
    found: Sequence[Diagnostic], device: DeviceConfig, head: StereoHeadCalibration
) -> tuple[Diagnostic, ...]:
    """Advise on refused cameras by comparing serial numbers on each side.

    One cause is told once: that of swapped cameras by the pair, any other by the refused camera.
    """
    replied = {endpoint: serial for one in found for endpoint, serial in one.serials.items()}
    verdicts = {}
    for side in SIDES:
        endpoint = camera_endpoint(device, side)
        if endpoint in replied:
            verdicts[endpoint] = _verdict(side, endpoint, replied, device, head)
    first = next((verdict for verdict in verdicts.values() if verdict), "")
    cameras_well = all(one.well for one in found if one.serials)
    endpoints = [camera_endpoint(device, side) for side in SIDES]
    drivers_advice = {one.advice for one in found if one.serials and not one.well}
    is_pair_refused = any(not one.well and not one.serials and one.advice in drivers_advice for one in found)
    exchanged = [_configured(side, device, head) for side in reversed(SIDES)]
    swapped = is_pair_refused and [replied.get(each) for each in endpoints] == exchanged
    replacements: dict[str, str] = {}  # the driver's advice -> ours
    advised = []
    for one in found:
        if one.well:
            advised.append(one)
        elif one.serials:
            advice = next((verdicts[each] for each in one.serials if each in verdicts), "")
            side = next((side for side in SIDES if camera_endpoint(device, side) in one.serials), "")
            if None in one.serials.values() and not (side and _elsewhere(side, replied, device, head)):
                advice = f"{advice} {one.advice}".rstrip()  # only the driver knows why
            replacements[one.advice] = advice or one.advice
            advised.append(replace(one, advice=replacements[one.advice], explained=swapped))
        elif swapped and one.advice in drivers_advice:
            names = " and ".join(f"{STEREO}.endpoints.{side}" for side in SIDES)
            advised.append(replace(one, advice=f"Swap the cables, or the endpoints {names}."))
        else:
            advice = first if cameras_well else replacements.get(one.advice, "")
            explained = one.advice in drivers_advice  # repeats the advice of its first refused camera
            advised.append(replace(one, advice=advice or one.advice, explained=explained))
    return tuple(advised)


def _configured(side: str, device: DeviceConfig, head: StereoHeadCalibration) -> str:
    recorded = head.left.serial if side == "left" else head.right.serial
    return str(device.options.get(f"{side}_serial") or recorded)


def _elsewhere(
    side: str, replied: Mapping[str, str | None], device: DeviceConfig, head: StereoHeadCalibration
) -> str:
    """Return the address at which the camera of a side replied, if not its own; empty if that is uncertain.

    Where a serial number replied several times there is another cell on the network.
    """
    serials = [serial for serial in replied.values() if serial is not None]
    if len(set(serials)) < len(serials):
        return ""
    configured, endpoint = _configured(side, device, head), camera_endpoint(device, side)
    places = (at for at, serial in replied.items() if serial == configured and at != endpoint)
    return next((parse_endpoint(at).host for at in places), "")


def _verdict(
    side: str,
    endpoint: str,
    replied: Mapping[str, str | None],
    device: DeviceConfig,
    head: StereoHeadCalibration,
) -> str:
    """Describe a camera fault on one side; empty without a fault or if the driver already explains it."""
    actual = replied[endpoint]
    recorded = {"left": head.left.serial, "right": head.right.serial}
    configured = _configured(side, device, head)
    if given_twice := _given_twice(replied, device, recorded):
        return given_twice
    others = {serial: at for at, serial in replied.items() if serial is not None and at != endpoint}
    found = ", ".join(dict.fromkeys([*filter(None, [actual]), *others])) or "none"
    not_found = f"was not found (serial numbers found: {found})"
    if actual is None and (place := _elsewhere(side, replied, device, head)):
        return (
            f"{configured} is at {place}, not at {parse_endpoint(endpoint).host}: correct "
            f"the endpoint {STEREO}.endpoints.{side}."
        )
    if actual is None and configured in others:
        places = sorted(parse_endpoint(at).host for at, serial in replied.items() if serial == configured)
        return (
            f"The {side} camera {configured} was not found at {parse_endpoint(endpoint).host}; cameras with "
            f"that number reply at {', '.join(places)}, of this theatre or another."
        )
    if actual is None:
        return f"The {side} camera {configured} {not_found}."
    is_swapped = actual != recorded[side] and actual in recorded.values()
    if is_swapped or (actual != configured and configured in others):
        return ""
    if actual == configured == recorded[side]:
        return ""
    if actual == recorded[side]:
        cause = "is probably mistyped" if _differ_by_a_typing_error(configured, actual) else not_found
        return (
            f'{side}_serial = "{configured}" {cause}: camera {actual} replied in its place and is the one in '
            f"the calibration record. Correct it in the theatre file."
        )
    location = f"replied at {others[recorded[side]]}" if recorded[side] in others else "was not found"
    serial_advice = "" if actual == configured else f' and set {side}_serial = "{actual}"'
    return (
        f"The {side} camera was exchanged: {actual} replied, the calibration record is of {recorded[side]}, "
        f"which {location}. Mount {recorded[side]} again, or calibrate the head with {actual}{serial_advice}."
    )


def _given_twice(replied: Mapping[str, str | None], device: DeviceConfig, recorded: Mapping[str, str]) -> str:
    """Describe an endpoint or serial number that the theatre file gives to both cameras, or return ""."""
    left, right = SIDES
    endpoint = camera_endpoint(device, left)
    if endpoint == camera_endpoint(device, right):
        side = right if replied[endpoint] == recorded[left] else left
        place = next((at for at, serial in replied.items() if serial == recorded[side]), None)
        place_text = "the address of" if place is None else f'"{place}",'
        return (
            f"{STEREO}.endpoints.left and right are both {endpoint}: two cameras need two addresses. Set "
            f"{STEREO}.endpoints.{side} to {place_text} camera {recorded[side]}."
        )
    serial = device.options.get(f"{left}_serial")
    if serial is None or serial != device.options.get(f"{right}_serial"):
        return ""
    remedy = " and ".join(f'{side}_serial = "{recorded[side]}"' for side in SIDES if recorded[side] != serial)
    return (
        f'left_serial and right_serial are both "{serial}": two cameras have two serial numbers. '
        f"Set {remedy}, as in the calibration record."
    )


def _differ_by_a_typing_error(one: str, other: str) -> bool:
    """Return whether two texts differ by one wrong, missing, extra or transposed character."""
    if len(one) == len(other):
        wrong = [place for place in range(len(one)) if one[place] != other[place]]
        first, last = wrong[0], wrong[-1] + 1
        return len(wrong) == 1 or (last - first == 2 and one[first:last] == other[first:last][::-1])
    shorter, longer = sorted((one, other), key=len)
    return any(longer[:place] + longer[place + 1 :] == shorter for place in range(len(longer)))


def inspection(name: str, theatre: TheatreFile) -> Callable[[Device, Identity], Iterator[Diagnostic]]:
    """Return the inspection function for a device. Each refusal becomes a diagnostic."""
    calibrations, driver = theatre.calibration, theatre.devices[name].driver

    def inspect(device: Device, identity: Identity) -> Iterator[Diagnostic]:
        subject = f"{name}: "
        driver_check = run_check(
            f"{subject}driver",
            driver,
            lambda: require_interface(name, driver, device, required_interface(name)),
        )
        if not driver_check.well:
            yield driver_check
            return
        if isinstance(device, TellsReadiness):
            yield from fact_diagnostics(subject, device)
        if calibrations is not None:
            yield from _check_records(name, device, identity.serial, calibrations, theatre)
        configured = run_check(f"{subject}configured", "", device.configure)
        if not configured.well:
            yield configured
            return
        for notice in device.notices:
            yield Diagnostic(f"{subject}notice", True, notice)
        if isinstance(device, OpticalTracker):
            yield from _check_visibility(subject, device, theatre)
        elif isinstance(device, StereoPair):
            head = None if calibrations is None else calibrations.stereo_head
            judge_pair = partial(pair_diagnostics, subject, head=head)
            yield from picture_diagnostics(subject, device, PAIRS_LOOKED_AT, 1 + FURTHER_TRIES, judge_pair)
            if line_projector(device) is not None:  # a case by spheres can begin without
                patient_frame = theatre.procedure.patient_frame
                can_scan = partial(require_scanner, device, patient_frame, calibrations)
                yield replace(run_check(f"{subject}scan of the skin", "possible", can_scan), well=True)
        if isinstance(device, ConfirmedStart) and (words := device.to_confirm) is not None:
            yield Diagnostic(f"{subject}start", True, f"a person will be asked to confirm: {words}")

    return inspect


def _check_records(
    name: str, device: Device, serial: str, calibrations: Calibrations, theatre: TheatreFile
) -> Iterator[Diagnostic]:
    """Check that the records belong to this device and, on the master, that the stereo head is mounted."""
    subject = f"{name}: "
    if isinstance(device, OpticalTracker):
        yield from frame_diagnostics(subject, device, calibrations, theatre)
    if isinstance(device, StereoPair):
        records = (calibrations.stereo_head.left, calibrations.stereo_head.right)
        for side, record, serial in zip(SIDES, records, device.serials, strict=True):
            camera_subject = f"{subject}calibration of the {side} camera"
            found = run_check(camera_subject, serial, partial(check_serial, record, serial))
            yield replace(found, serials={camera_endpoint(theatre.devices[name], side): serial})
    role = name.removeprefix("robot.")
    if isinstance(device, RobotArm) and role in WHOSE_RECORD:
        kinematics, arm = device.kinematics, calibrations.arms.get(role)

        def check_arm() -> None:
            tools.calibrated_arm(kinematics, calibrations.arms, role)
            tools.require_this_arm(calibrations.arms, serial, role)

        seen = f"{kinematics.name} {serial}".rstrip()
        if arm is None:
            seen = f"none: {seen} is taken as nominal"
        found = run_check(f"{subject}{ARM_RECORD}", seen, check_arm)
        arm_check = replace(found, serials={kinematics.name: serial})
        is_unverified = arm is not None and not (arm.serial and serial)
        yield replace(arm_check, advice=WHOSE_RECORD[role]) if is_unverified and arm_check.well else arm_check
        if role != MASTER:
            return
        mount = tools.ToolMount(lambda: device.read_tool_identity().number, calibrations)
        mounted = tools.MountedTool.STEREO_HEAD
        yield run_check(f"{subject}{TOOL}", str(mounted), partial(mount.check, mounted))


def two_arm_diagnostics(found: Mapping[str, Sequence[Diagnostic]]) -> Iterator[Diagnostic]:
    """Check that master and assistant are two arms, by the `found` diagnostics of each table."""
    arms = [
        identity
        for role in TWO_ARMS
        for one in found.get(f"robot.{role}", ())
        if one.subject == f"robot.{role}: {ARM_RECORD}"
        for identity in one.serials.items()
    ]
    for one, other in combinations([(model, serial or "") for model, serial in arms], 2):
        yield run_check(ARE_TWO, "two", partial(tools.require_two_arms, one, other))


def frame_diagnostics(
    subject: str, tracker: OpticalTracker, calibrations: Calibrations, theatre: TheatreFile
) -> Iterator[Diagnostic]:
    """Check every frame that the theatre file names against the tracker's tools; needs no connection."""
    named, patient_frame = ", ".join(tracker.tools), theatre.procedure.patient_frame
    check_frames = partial(ToolRecords.of(theatre).check_frames, calibrations, tracker.tools)
    yield run_check(f"{subject}frames named in records", named, check_frames)
    if patient_frame is not None:
        check_patient = partial(check_patient_frame, patient_frame, calibrations, tracker.markers_mm)
        yield run_check(f"{subject}frame of the patient", patient_frame, check_patient)


def _check_visibility(subject: str, tracker: OpticalTracker, theatre: TheatreFile) -> Iterator[Diagnostic]:
    """Report which tools and spheres are currently visible."""
    try:
        with tracker.active():
            frames = [tracker.read_frame() for _ in range(FRAMES_LOOKED_AT)]
    except RonnaError as error:  # too cold, bumped, an alert
        yield refusal(f"{subject}tracking", error)
        return
    calibrations = theatre.calibration
    mounted_later = {record.frame.tool for record in theatre.tools.values() if record.frame is not None}
    for tool in tracker.tools:
        seen = sum(frame.tool(tool).validity is Validity.OK for frame in frames)
        on_clamp = tool == theatre.procedure.patient_frame
        needed = on_clamp or (calibrations is not None and tool == calibrations.tracker_frame.tool)
        is_well, advice = seen > len(frames) // 2 or not needed, ""
        if seen < len(frames) and tool not in mounted_later:
            advice = TURN_FRAME if on_clamp else TURN_CART
        text = f"in {seen} of {len(frames)} frames"
        yield Diagnostic(f"{subject}visibility of {tool}", is_well, text, advice)
    spheres = sorted(len(add_frame_spheres(tracker, frame).strays) for frame in frames)[len(frames) // 2]
    advice = "" if spheres >= LEAST_SPHERES else FEW_SPHERES
    text = f"{spheres}" if reports_strays(tracker) else f"{spheres}; only those of tools are reported"
    if not reports_strays(tracker) and find_frame_name(tracker.markers_mm) is None:
        advice = SPHERES_NOT_TRACKED.action
    yield Diagnostic(f"{subject}spheres in view", True, text, advice)
