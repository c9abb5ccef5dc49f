"""Devices, calibrations and tool after a restart. Connects and reads; nothing here can move the arm."""

from __future__ import annotations

from procedures.engine.engine import Engine
from procedures.recovery.comparison import Comparison
from procedures.relocalization.triangulation import check_serial
from procedures.steps.clinical.set_up import CheckedSetUp, DeviceIdentity
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.workcell import MountedTool
from procedures.workcell.errors import TipOffAxis
from ronna_hw.errors import RonnaError


def compare_devices(
    engine: Engine, recorded: CheckedSetUp, comparison: Comparison, *, exchange_begun: bool
) -> None:
    """Connect and configure every device and hold it against the set-up.

    `exchange_begun` says that an exchange of tools began and did not end. Raises what a device raises that
    does not answer.
    """
    _compare_calibrations(engine, recorded, comparison)
    workcell = engine.setting.workcell
    for role, device in workcell.devices.items():
        found = DeviceIdentity.of(device.connect())
        device.configure()
        if (then := recorded.identities.get(role)) == found:
            comparison.same(f"{role} {found.model}")
        else:
            comparison.differs(role, _named(then) if then else "none", _named(found))
    _compare_tool(engine, comparison, exchange_begun=exchange_begun)


def _named(identity: DeviceIdentity) -> str:
    return f"{identity.model} {identity.serial} with firmware {identity.firmware}"


def _compare_calibrations(engine: Engine, recorded: CheckedSetUp, comparison: Comparison) -> None:
    now = engine.setting.workcell.calibrations
    records = (now.stereo_head, now.tool_tip, now.tracker_frame)
    then = recorded.calibrations
    for record, before in zip(records, (then.stereo_head, then.tool_tip, then.tracker_frame), strict=True):
        if record != before:
            comparison.differs(f"calibration {before.identifier}", f"of {before.created:%Y-%m-%d}", "another")
            continue
        try:
            record.check_valid_at(engine.setting.today())
        except RonnaError as problem:
            comparison.differs(f"calibration {record.identifier}", "one that is valid", problem)
        else:
            comparison.same(f"calibration {record.identifier}")


def _compare_tool(engine: Engine, comparison: Comparison, *, exchange_begun: bool) -> None:
    workcell = engine.setting.workcell
    for side, serial in zip(("left", "right"), workcell.stereo.serials, strict=True):
        try:
            check_serial(getattr(workcell.calibrations.stereo_head, side), serial)
        except RonnaError as problem:
            comparison.differs(f"{side} camera", "the calibrated one", problem)
    changed = engine.case.find(MountedGuide, None) is not None
    expected = MountedTool.GUIDE if changed else MountedTool.STEREO_HEAD
    found = workcell.identify_mounted()
    if found is expected:
        comparison.same(f"the {found}")
    elif exchange_begun and workcell.insertion is None:
        comparison.note(f"an exchange of tools had begun: the arm carries the {found}")
    else:
        comparison.differs("mounted tool", f"the {expected}", f"the {found}")
        return
    if workcell.insertion is not None:
        try:
            workcell.insertion.check_on_axis(workcell.tool_pose())
        except TipOffAxis as problem:
            comparison.differs("instrument", f"in {workcell.insertion.trajectory}", problem)
