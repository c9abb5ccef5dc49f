"""Comparison of a resumed run's devices, calibrations, tool, inputs and room with its records.

It connects and reads; nothing here can move the arm. The tracker measures the room again at rest: the visible
spheres on the head, or the frame on its clamp, and the base of each arm by the frame on it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from pydantic import BaseModel

from procedures.calibration.errors import PlatformMoved
from procedures.calibration.validity import require_valid_record
from procedures.engine.engine import Engine
from procedures.guards import errors
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import read_watched
from procedures.imaging.series import read_series
from procedures.planning.plan_file import read_plan
from procedures.relocalization.triangulation import check_serial
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import IntraoperativeSpheres
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.inputs import note_same_content
from procedures.steps.clinical.localized_room import build_watch
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import KnownBases, RegisteredRobot
from procedures.steps.clinical.room import find_followed, targets_mm
from procedures.steps.clinical.set_up import CheckedSetUp, DeviceIdentity, DriverSettings
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.workcell import MountedTool
from procedures.workcell.errors import TipOffAxis
from ronna_hw.calibration import CalibrationExpired, DatedRecord
from ronna_hw.errors import RonnaError
from ronna_hw.records import canonical_json
from ronna_hw.text import format_count

# Calibrations that determine where arms and tools are.
FOR_MOTION = ("arm", "stereo_head", "tool_tip", "assistant_arm", "assistant_holder")


@dataclass
class Comparison:
    """Findings of a comparison; append a finding to the list that says what follows from it."""

    warnings: list[str] = field(default_factory=list)  # potential harm: read first
    notes: list[str] = field(default_factory=list)
    unchanged: list[str] = field(default_factory=list)  # what is as recorded
    differences: list[str] = field(default_factory=list)  # prevent resuming, whatever the operator answers
    moved: errors.RoomMoved | None = None  # meanwhile, in the room: what depends on it is done again

    @property
    def findings(self) -> list[str]:
        """Findings for the journal, without the differences."""
        return [*self.warnings, *self.notes, *(f"{what}: as recorded" for what in self.unchanged)]

    def add_difference(self, what: str, recorded: object, found: object) -> None:
        """Add an item that differs from its record."""
        self.differences.append(f"{what}: recorded {recorded}, found {found}")

    def add_move(self, moved: errors.RoomMoved) -> None:
        """Add what has moved in the room, as a warning."""
        self.moved = moved
        self.warnings.insert(0, f"{moved.summary}: what depends on it is void, and done again")

    def compare(self, what: str, recorded: BaseModel | None, found: BaseModel | None) -> None:
        """Compare an item with its record, and add it as unchanged or add the fields that differ."""
        if recorded == found:
            self.unchanged.append(what)
        elif recorded is None or found is None:
            self.add_difference(what, *("none" if one is None else "one" for one in (recorded, found)))
        else:
            unlike = list(_find_differences(recorded, found))
            then = ", ".join(f"{name} {then}" for name, then, _ in unlike)
            self.add_difference(what, then, ", ".join(f"{name} {now}" for name, _, now in unlike))

    def format_lines(self, order: Sequence[str]) -> str:
        """Format the findings: warnings, the steps in `order`, notes and the number of unchanged items."""
        as_recorded = [format_count(len(self.unchanged), "item") + " as recorded"] if self.unchanged else []
        return "\n".join((*self.warnings, *order, *self.notes, *as_recorded))


def _find_differences(
    recorded: BaseModel, found: BaseModel, within: str = ""
) -> Iterator[tuple[str, object, object]]:
    """Yield the dotted name and both values of each differing field; long values are summarized."""
    for name in type(recorded).model_fields:
        then, now = getattr(recorded, name), getattr(found, name, None)
        if then == now:
            continue
        if isinstance(then, BaseModel) and isinstance(now, BaseModel):
            yield from _find_differences(then, now, f"{within}{name}.")
        else:
            yield f"{within}{name}", _summarize_value(then), _summarize_value(now)


def _summarize_value(value: object) -> object:
    if value and isinstance(value, tuple) and all(isinstance(one, int | float) for one in value):
        return value
    return format_count(len(value), "entry", "entries") if isinstance(value, list | tuple | dict) else value


def compare_devices(
    engine: Engine,
    recorded: CheckedSetUp,
    comparison: Comparison,
    *,
    exchange_begun: bool,
    only_leaving: bool = False,
) -> None:
    """Connect and configure every device, and compare each with the recorded set-up.

    `exchange_begun` says that a tool exchange began and did not end. With `only_leaving` only the arm is
    needed, and the age of records does not matter. Raises the error of a needed device that does not respond.
    """
    _compare_calibrations(engine, recorded, comparison, only_leaving=only_leaving)
    if only_leaving:
        _compare_drivers(
            engine,
            recorded,
            lambda what, then, now: comparison.warnings.append(f"{what}: recorded {then}, found {now}"),
        )
    else:
        _compare_theatre_file(engine, recorded, comparison)
    workcell = engine.setting.workcell
    for role, device in workcell.devices.items():
        try:
            found = DeviceIdentity.from_identity(device.connect())
            device.configure()
        except RonnaError as problem:
            if workcell.arm_of_device(role) or not only_leaving:
                raise
            comparison.notes.append(f"{role}: not needed on the way home ({problem.summary})")
            continue
        if (then := recorded.identities.get(role)) == found:
            comparison.unchanged.append(f"{role} {found.model}")
        elif only_leaving and not workcell.arm_of_device(role):
            comparison.notes.append(
                f"{role}: a different one; not needed on the way home: {_describe_device(found)}"
            )
        else:
            comparison.add_difference(role, _describe_device(then), _describe_device(found))
    if not only_leaving:
        _compare_cameras(engine, comparison)
    workcell.compare_places()  # it may have been jogged meanwhile
    _compare_tool(engine, comparison, exchange_begun=exchange_begun)


def _describe_device(identity: DeviceIdentity | None) -> str:
    if identity is None:
        return "none"
    return f"{identity.model} {identity.serial} with firmware {identity.firmware}"


def _describe_record(record: DatedRecord | None) -> str:
    if record is None:
        return "none"
    digest = hashlib.sha256(canonical_json(record.model_dump(mode="json"))).hexdigest()
    return f"{record.identifier} of {record.created:%Y-%m-%d %H:%M:%S %Z} (SHA-256 begins {digest[:8]})"


def _compare_calibrations(
    engine: Engine, recorded: CheckedSetUp, comparison: Comparison, *, only_leaving: bool
) -> None:
    now, then = engine.setting.workcell.calibrations.records, recorded.calibrations.records
    for name in (*sorted(then.keys() - now.keys()), *now):
        record = now.get(name)
        if record != then.get(name) and only_leaving and name not in FOR_MOTION:
            comparison.notes.append(
                f"calibration {name}: not needed on the way home, and there is none"
                if record is None
                else f"calibration {name}: a different one; not needed on the way home: "
                f"{_describe_record(record)}"
            )
        elif record is None or record != then.get(name):
            before, after = _describe_record(then.get(name)), _describe_record(record)
            comparison.add_difference(f"calibration {name}", before, after)
        else:
            _check_age(engine, name, record, comparison, only_leaving=only_leaving)


def _check_age(
    engine: Engine, name: str, record: DatedRecord, comparison: Comparison, *, only_leaving: bool
) -> None:
    try:
        require_valid_record(name, record, engine.setting.today(), engine.setting.starts)
    except CalibrationExpired as problem:
        if only_leaving:
            comparison.notes.append(f"calibration {record.identifier}: {problem.summary}")
        else:
            comparison.add_difference(f"calibration {record.identifier}", "a valid one", problem)
    else:
        comparison.unchanged.append(f"calibration {record.identifier}")


def _compare_theatre_file(engine: Engine, recorded: CheckedSetUp, comparison: Comparison) -> None:
    """Compare the theatre file with the record: devices, tools, flange, cell and procedure settings."""
    setting, tools = engine.setting, engine.setting.workcell.tools
    for role in sorted(recorded.identities.keys() - setting.workcell.devices.keys()):
        comparison.add_difference(role, _describe_device(recorded.identities[role]), "none")
    for name in sorted({*recorded.tools, *tools.records}):
        comparison.compare(f"tool record {name}", recorded.tools.get(name), tools.records.get(name))
    if tools.flange != recorded.flange:
        comparison.add_difference("flange", repr(recorded.flange), repr(tools.flange))
    _compare_drivers(engine, recorded, comparison.add_difference)
    comparison.compare("the cell", recorded.cell, setting.surroundings)
    comparison.compare("settings of the procedure", recorded.settings, setting.settings)


def _compare_drivers(
    engine: Engine, recorded: CheckedSetUp, add_difference: Callable[[str, str, str], object]
) -> None:
    """Compare each driver and its options with the record: they decide on limits, speeds and kinematics."""
    tables = engine.setting.workcell.device_tables
    for name, then in recorded.drivers.items():
        now = DriverSettings.of(tables[name]) if name in tables else None
        if now is None or now == then:
            continue  # a device that is gone is found among the identities
        if now.driver != then.driver:
            add_difference(f"driver of {name}", then.driver, now.driver)
        names = sorted({*then.options, *now.options})
        changed = [
            one
            for one in names
            if _without_folders(then.options.get(one)) != _without_folders(now.options.get(one))
        ]
        if changed:
            stated = (
                ", ".join(f"{one} {settings.options.get(one, 'not stated')}" for one in changed)
                for settings in (then, now)
            )
            add_difference(f"options of {name}", *stated)


def _without_folders(option: str | None) -> str | None:
    """Return an option, in JSON, with the names of its files alone: a run may have been moved."""
    return None if option is None else re.sub(r'"/[^"]*/([^"/]+)"', r'"\1"', option)


def _compare_cameras(engine: Engine, comparison: Comparison) -> None:
    workcell = engine.setting.workcell
    for side, serial in zip(("left", "right"), workcell.stereo.serials, strict=True):
        try:
            check_serial(getattr(workcell.calibrations.stereo_head, side), serial)
        except RonnaError as problem:
            comparison.add_difference(f"{side} camera", "the calibrated one", problem)


def _compare_tool(engine: Engine, comparison: Comparison, *, exchange_begun: bool) -> None:
    workcell = engine.setting.workcell
    changed = engine.case.find(MountedGuide, None) is not None
    expected = MountedTool.GUIDE if changed else MountedTool.STEREO_HEAD
    found, carries = workcell.master.mount.identify(), f"the {workcell.master.spoken_name} carries"
    if found is expected:
        comparison.unchanged.append(f"the {found}")
    elif exchange_begun and found is MountedTool.GUIDE and workcell.master.place.is_on_axis:
        # only a guide is sent onto an axis; its record was voided with the localization
        comparison.warnings.append(f"{carries} the guide, and its record no longer holds")
    elif exchange_begun and not workcell.master.place.is_on_axis:
        comparison.warnings.append(f"a tool exchange had begun: {carries} the {found}")
    else:
        comparison.add_difference("mounted tool", f"the {expected}", f"the {found}")
        return
    if (axis := workcell.master.place.axis) is not None:
        try:
            axis.check_on_axis(workcell.master.tool_pose())
        except TipOffAxis as problem:
            comparison.add_difference("guide", f"on {axis.trajectory}", problem)


def compare_inputs(engine: Engine, comparison: Comparison, plan_sha256: str | None = None) -> None:
    """Reread CT, scan, plan and proposed position and compare them. Any that is unreadable is a difference.

    `plan_sha256` is the hash of the plan when the run was opened; it applies until the plan was checked.
    """
    clinical = engine.setting.clinical
    if clinical is None:
        return
    if imported := engine.case.find(ImportedCt, None):
        try:
            volume = read_series(clinical.series)
        except (RonnaError, OSError) as problem:
            comparison.add_difference("CT series", imported.result.series_instance_uid, problem)
        else:
            then = imported.result
            if changed := then.differences(volume):
                comparison.add_difference(
                    "CT series", then.series_instance_uid, f"a different one: {changed}"
                )
            else:
                comparison.unchanged.append("CT series")
                if engine.case.find(CheckedPlan, None) is None:
                    engine.setting.memory.keep(volume)
    if scanned := engine.case.find(IntraoperativeSpheres, None):
        recorded = f"the one of {scanned.record.identifier}"
        try:
            changed = scanned.result.file_differences(clinical.scan_series)
        except (RonnaError, OSError) as problem:
            comparison.add_difference("scan of the operation", recorded, problem)
        else:
            if changed:
                comparison.add_difference("scan of the operation", recorded, changed)
            else:
                comparison.unchanged.append("scan of the operation")
    if checked := engine.case.find(CheckedPlan, None):
        try:
            plan = read_plan(clinical.plan)
        except (RonnaError, OSError) as problem:
            comparison.add_difference("plan", "the checked plan", problem)
        else:
            if plan == checked.result.plan:
                comparison.unchanged.append("plan")
                note_same_content(engine, clinical.plan, checked.record)
            else:
                comparison.add_difference("plan", "the checked plan", "a different one")
    elif plan_sha256 is not None and clinical.plan_sha256 not in (None, plan_sha256):
        comparison.add_difference("plan", f"SHA-256 {plan_sha256}", clinical.plan_sha256)
    if locked := engine.case.find(LockedCart, None):
        try:
            changed = locked.result.differences(clinical.place)
        except RonnaError as problem:
            comparison.add_difference("proposed position", "a readable one", problem)
        else:
            if changed:
                comparison.add_difference("proposed position", locked.record.identifier, changed)
            elif locked.result.proposal is not None:
                comparison.unchanged.append("proposed position")
                note_same_content(engine, clinical.place, locked.record)


def compare_room(engine: Engine, comparison: Comparison) -> bool:
    """Compare patient and robot base. Return False if the tracker sees too little of the head.

    Raises the errors of the tracker.
    """
    stored = engine.case.find(GlobalLocalization, None)
    if stored is None:
        what = "patient" if engine.setting.clinical is not None else "stand"
        comparison.notes.append(f"{what} and robot base: not recorded yet, nothing to compare")
        return True
    workcell, matched = engine.setting.workcell, engine.case.find(Correspondence, None)
    pairs = None if matched is None else matched.result.pairs
    context = engine.context(engine.order.sequence[0])
    checked = engine.case.find(CheckedPlan, None)
    points_mm = targets_mm(checked.result, matched.result) if checked and matched else {}
    watch = build_watch(
        workcell,
        engine.setting.settings,
        stored.record.identifier,
        stored.result,
        pairs,
        points_mm,
        context.latest(KnownBases),
        find_followed(context, None),
    )
    look = watch.compare(read_watched(watch, workcell, CAREFUL_FRAMES))
    if look.head_mm is None and not isinstance(look.moved, errors.BaseShifted | PlatformMoved):
        return False
    try:
        findings = look.require()
    except errors.RoomUndecided as undecided:
        if not workcell.master.place.is_home:
            comparison.warnings.append(
                f"{undecided.summary}: compared again once {workcell.phrases.are} home"
            )
            return False
        comparison.add_difference("room", f"all within {undecided.limit}", undecided.what)
        return True
    except errors.PatientUnseen:
        return False
    except errors.InsertionDisturbed:  # told with the axis on which the assistant stands
        return True
    except (errors.PatientMoved, errors.BaseShifted, errors.FrameSlipped, PlatformMoved) as moved:
        # The step registration asks whether to follow it.
        follows = workcell.master.tool is MountedTool.GUIDE and not context.stands(RegisteredRobot)
        if isinstance(moved, errors.PatientMoved) and follows:
            comparison.notes.append(f"patient: {moved.what}; no registration is valid")
        elif workcell.is_any_arm_out:
            comparison.add_difference("room", f"all within {moved.limit}", moved.what)
        else:
            comparison.add_move(moved)
        return True
    if look.reading.frame_mm is None and workcell.master.place.is_home:
        comparison.add_difference("robot base", "the frame on the arm in view", "the tracker does not see it")
        return True
    comparison.notes.append(
        f"patient: the frame on the clamp within {look.head_mm:.2f} mm of its recorded position; "
        "the head in the clamp was not compared"
        if look.by_frame
        else f"patient: spheres within {look.head_mm:.2f} mm of their recorded positions"
    )
    base = "the tracker does not see the frame on the arm; compared once it is home"
    if look.base_mm is not None:
        base = f"the frame on the arm within {look.base_mm:.2f} mm of where it is expected"
    comparison.notes += [f"robot base: {base}", *findings]
    return True
