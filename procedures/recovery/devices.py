"""Devices, calibrations and tool after a restart. Connects and reads; nothing here can move the arm."""

from __future__ import annotations

from procedures.engine.device_faults import ARM
from procedures.engine.engine import Engine
from procedures.recovery.comparison import Comparison
from procedures.relocalization.triangulation import check_serial
from procedures.steps.clinical.set_up import CheckedSetUp, DeviceIdentity
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.workcell import MountedTool
from procedures.workcell.errors import TipOffAxis
from ronna_hw.calibration import CalibrationExpired, DatedRecord
from ronna_hw.errors import RonnaError

FOR_MOTION = ("arm", "stereo_head", "tool_tip")  # calibrations that determine where arm and tools are


def compare_devices(
    engine: Engine,
    recorded: CheckedSetUp,
    comparison: Comparison,
    *,
    exchange_begun: bool,
    only_leaving: bool = False,
) -> None:
    """Connect and configure every device and compare it with the set-up.

    `exchange_begun`: an exchange of tools began and did not end. With `only_leaving`, only the arm is needed
    and the age of records does not matter. Raises the error of a needed device that does not respond.
    """
    _compare_calibrations(engine, recorded, comparison, only_leaving=only_leaving)
    if not only_leaving:
        _compare_theatre_file(engine, recorded, comparison)
    workcell = engine.setting.workcell
    for role, device in workcell.devices.items():
        try:
            found = DeviceIdentity.of(device.connect())
            device.configure()
        except RonnaError as problem:
            if role == ARM or not only_leaving:
                raise
            comparison.note(f"{role}: not needed on the way home ({problem.summary})")
            continue
        if (then := recorded.identities.get(role)) == found:
            comparison.same(f"{role} {found.model}")
        elif role != ARM and only_leaving:
            comparison.note(f"{role}: a different one; not needed on the way home: {_named(found)}")
        else:
            comparison.differs(role, _named(then) if then else "none", _named(found))
    if not only_leaving:
        _compare_cameras(engine, comparison)
    workcell.compare_place()  # it may have been jogged meanwhile
    _compare_tool(engine, comparison, exchange_begun=exchange_begun)


def _named(identity: DeviceIdentity) -> str:
    return f"{identity.model} {identity.serial} with firmware {identity.firmware}"


def _dated(record: DatedRecord) -> str:
    return f"{record.identifier} of {record.created:%Y-%m-%d}"


def _compare_calibrations(
    engine: Engine, recorded: CheckedSetUp, comparison: Comparison, *, only_leaving: bool
) -> None:
    now = engine.setting.workcell.calibrations
    then = recorded.calibrations.records
    for name in then.keys() - now.records.keys():
        if only_leaving and name not in FOR_MOTION:
            comparison.note(f"calibration {name}: not needed on the way home, and there is none")
            continue
        comparison.differs(f"calibration {name}", _dated(then[name]), "none")
    for name, record in now.records.items():
        if record != then.get(name) and only_leaving and name not in FOR_MOTION:
            comparison.note(
                f"calibration {name}: a different one; not needed on the way home: {_dated(record)}"
            )
            continue
        if record != then.get(name):
            before = _dated(then[name]) if name in then else "none"
            comparison.differs(f"calibration {name}", before, _dated(record))
            continue
        try:
            record.check_valid_at(engine.setting.today())
        except CalibrationExpired as problem:
            if name in engine.setting.starts and problem.limit is not None:  # not one dated in the future
                comparison.same(f"calibration {record.identifier}")
            elif only_leaving:
                comparison.note(f"calibration {record.identifier}: {problem.summary}")
            else:
                comparison.differs(f"calibration {record.identifier}", "a valid one", problem)
        else:
            comparison.same(f"calibration {record.identifier}")


def _compare_theatre_file(engine: Engine, recorded: CheckedSetUp, comparison: Comparison) -> None:
    """Devices, and what depths, clearances and predictions come from: tools, flange, cell and settings."""
    setting, tools = engine.setting, engine.setting.workcell.tools
    for role in recorded.identities.keys() - setting.workcell.devices.keys():
        comparison.differs(role, _named(recorded.identities[role]), "none")
    for name in sorted({*recorded.tools, *tools.records}):
        comparison.compare(f"tool record {name}", recorded.tools.get(name), tools.records.get(name))
    if tools.flange != recorded.flange:
        comparison.differs("flange", repr(recorded.flange), repr(tools.flange))
    comparison.compare("the cell", recorded.cell, setting.surroundings)
    comparison.compare("settings of the procedure", recorded.settings, setting.settings)


def _compare_cameras(engine: Engine, comparison: Comparison) -> None:
    workcell = engine.setting.workcell
    for side, serial in zip(("left", "right"), workcell.stereo.serials, strict=True):
        try:
            check_serial(getattr(workcell.calibrations.stereo_head, side), serial)
        except RonnaError as problem:
            comparison.differs(f"{side} camera", "the calibrated one", problem)


def _compare_tool(engine: Engine, comparison: Comparison, *, exchange_begun: bool) -> None:
    workcell = engine.setting.workcell
    changed = engine.case.find(MountedGuide, None) is not None
    expected = MountedTool.GUIDE if changed else MountedTool.STEREO_HEAD
    found = workcell.identify_mounted()
    if found is expected:
        comparison.same(f"the {found}")
    elif exchange_begun and not workcell.place.on_axis:
        comparison.warn(f"a tool exchange had begun: the arm carries the {found}")
    else:
        comparison.differs("mounted tool", f"the {expected}", f"the {found}")
        return
    if (axis := workcell.place.axis) is not None:
        try:
            axis.check_on_axis(workcell.tool_pose())
        except TipOffAxis as problem:
            comparison.differs("guide", f"on {axis.trajectory}", problem)
