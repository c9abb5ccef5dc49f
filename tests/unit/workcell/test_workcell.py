"""Workcell motions: each has an intent and a result in the journal, none passes a guide before an entry."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest
from coded_errors import raises
from recording_cell import GUIDE, HOME, RecordingCell, tool_pose

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.strategies.strategy import APPROACH_RAD, ONE_SIDE, approach_joints
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.errors import GUIDE_HELD_AT_ENTRY, INSTRUMENT_IN_GUIDE, TipOffAxis, WrongTool
from procedures.workcell.motions import PlannedMotion
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices import Device
from ronna_hw.devices.errors import WRONG_KIND
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

WAY_MM = 60.0
BELOW_HOME = approach_joints(HOME, ONE_SIDE)  # from where every joint turns onto home


def turned(by_rad: float) -> JointVector:
    A1, A2, A3, A4, A5, A6 = HOME
    return (A1 + by_rad, A2, A3, A4, A5, A6)


def motions(cell: RecordingCell) -> list[tuple[str, object]]:
    lines = read_journal(cell.folder / JOURNAL_FILE)
    return [(line["entry"], line.get("what", line.get("error"))) for line in lines]


def with_guide(cell: RecordingCell) -> None:
    cell.arm.mounted = GUIDE
    cell.workcell.master.mount.check(MountedTool.GUIDE)
    cell.workcell.master.set_home()


def insertion(cell: RecordingCell, trajectory: str = "T1") -> InsertionAxis:
    """A trajectory whose stand-off is where the guide is now."""
    here = tool_pose(cell.arm.joints_rad, cell)
    target = Transform.of(
        here.target,
        here.source,
        translation_mm=here.apply([0.0, 0.0, WAY_MM]),
        quaternion_wxyz=here.quaternion_wxyz,
    )
    return InsertionAxis(trajectory, target, WAY_MM)


def inserted(cell: RecordingCell, trajectory: str = "T1") -> InsertionAxis:
    with_guide(cell)
    made = insertion(cell, trajectory)
    cell.workcell.master.insert(made)
    return made


@contextmanager
def nothing_moves(cell: RecordingCell, error: type[Exception], match: str) -> Iterator[None]:
    """The block is refused with this error before the arm has moved."""
    moved = len(cell.arm.motions)
    with raises(error, match=match):
        yield
    assert len(cell.arm.motions) == moved


def test_every_motion_is_recorded_as_an_intent_and_a_result(cell: RecordingCell) -> None:
    cell.workcell.master.set_home()
    cell.workcell.master.go(turned(0.1))
    cell.workcell.master.settle(turned(0.2), (1,) * 6)
    cell.workcell.master.go_home()
    assert motions(cell) == [
        ("placed", None),
        *[("motion", "go"), ("moved", None)],
        *[("motion", "settle"), ("moved", None)],
        *[("motion", "home"), ("moved", None)],
    ]


@pytest.mark.hazard(33)
def test_a_motion_whose_intent_cannot_be_written_is_not_made(cell: RecordingCell) -> None:
    os.dup2(full := os.open("/dev/full", os.O_WRONLY), cell.journal._file)
    os.close(full)
    with pytest.raises(JournalNotWritable, match="PRO-003"):
        cell.workcell.master.go(turned(0.1))
    assert cell.arm.motions == []


@pytest.mark.hazard(33)
def test_the_intent_is_on_the_disk_before_the_arm_moves(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_disk: list[int] = []
    as_it_moved: list[bytes] = []
    monkeypatch.setattr(os, "fdatasync", lambda file: on_disk.append(os.fstat(file).st_size))

    def move(_start: JointVector, _target: JointVector) -> bool:
        as_it_moved.append((cell.folder / JOURNAL_FILE).read_bytes()[: on_disk[-1]])
        return False  # the way is clear

    cell.arm.blocked = move
    cell.workcell.master.go(turned(0.1))
    assert b'"motion"' in as_it_moved[0].splitlines()[-1]


@pytest.mark.hazard(33)
def test_without_an_open_journal_nothing_moves_and_no_workcell_is_made(cell: RecordingCell) -> None:
    cell.journal.close()
    with pytest.raises(JournalNotWritable, match="the journal is closed"):
        cell.workcell.master.go(turned(0.1))
    with pytest.raises(JournalNotWritable, match="the journal is closed"):
        cell.make_workcell()
    assert cell.arm.motions == []


def test_a_failed_motion_is_recorded_in_the_journal(cell: RecordingCell) -> None:
    cell.arm.failing = LinkTimeout("telegrams ceased")
    with pytest.raises(LinkTimeout):
        cell.workcell.master.go(turned(0.1))
    assert motions(cell) == [("motion", "go"), ("moved", LinkTimeout.code)]


def test_a_blocked_straight_way_is_replaced_by_one_via_home(cell: RecordingCell) -> None:
    cell.workcell.master.set_home()
    cell.arm.joints_rad = turned(-0.1)
    cell.arm.blocked = lambda start, target: target == turned(0.1) and start != HOME
    cell.workcell.master.go(turned(0.1))
    assert [to for _, to in cell.arm.motions] == [BELOW_HOME, HOME, turned(0.1)]


def test_the_way_back_after_a_detour_by_home_leads_by_home_not_by_where_the_arm_was_before(
    cell: RecordingCell,
) -> None:
    cell.workcell.master.set_home()
    before, across, last = turned(0.5), turned(-0.5), turned(-0.6)
    unclear = ({before, across}, {before, last}, {last, BELOW_HOME})
    cell.arm.blocked = lambda start, target: {start, target} in unclear
    cell.workcell.master.go(before)
    cell.workcell.master.go(across)
    assert [to for _, to in cell.arm.motions] == [before, BELOW_HOME, HOME, across]
    cell.workcell.master.settle(last, None)
    cell.arm.motions.clear()
    cell.workcell.master.return_home()
    assert [to for _, to in cell.arm.motions] == [last, across, BELOW_HOME, HOME]
    assert cell.workcell.master.place.is_home


def test_nothing_moves_when_no_way_is_clear(cell: RecordingCell) -> None:
    cell.workcell.master.set_home()
    cell.arm.blocked = lambda _start, _target: True
    with pytest.raises(NotClear):
        cell.workcell.master.go(turned(0.1))
    assert cell.arm.motions == []


def test_joints_settle_from_the_requested_side(cell: RecordingCell) -> None:
    cell.workcell.master.settle(HOME, (1, -1, 1, -1, 1, -1))
    back, there = (to for _, to in cell.arm.motions)
    assert there == HOME
    stood_back = [round((end - start) / APPROACH_RAD) for start, end in zip(back, there, strict=True)]
    assert stood_back == [1, -1, 1, -1, 1, -1]


def test_insertion_and_withdrawal_end_where_they_began(cell: RecordingCell) -> None:
    made = inserted(cell)
    assert (on := cell.workcell.master.place.axis) is not None
    assert on.as_plain() == made.as_plain()
    reached = tool_pose(cell.arm.joints_rad, cell)
    assert math.dist(reached.translation_mm, made.held.translation_mm) < 1e-6
    cell.workcell.master.withdraw("T1")
    assert not cell.workcell.master.place.is_on_axis
    assert math.dist(cell.arm.joints_rad, HOME) < 1e-9


@pytest.mark.hazard(13)
def test_on_an_axis_only_the_program_that_moved_there_knows_on_which_sides_the_joints_rest(
    cell: RecordingCell,
) -> None:
    sides = (1, -1, 1, 1, -1, 1)
    with_guide(cell)
    cell.workcell.master.insert(replace(insertion(cell), arriving=sides))
    assert cell.workcell.master.rest_sides == sides
    cell.workcell.master.expect_jogging()  # or a restart
    assert cell.workcell.master.place.is_on_axis
    assert cell.workcell.master.rest_sides is None


VIEWS: dict[str, Callable[[RecordingCell], PlannedMotion]] = {
    "going": lambda cell: cell.workcell.master.go_motion(turned(0.1)),
    "returning home": lambda cell: cell.workcell.master.return_motion(),
    "settling": lambda cell: cell.workcell.master.settle_motion(turned(0.1), (1,) * 6),
    "straight": lambda cell: cell.workcell.master.line_to_motion(tool_pose(HOME, cell)),
    "inserting": lambda cell: cell.workcell.master.insert_motion(insertion(cell, "T2")),
    "withdrawing": lambda cell: cell.workcell.master.withdraw_motion(insertion(cell, "T2")),
}
Anything = Callable[[RecordingCell], object]
OTHER_MOTIONS: dict[str, Anything] = {
    "go": lambda cell: cell.workcell.master.go(turned(0.1)),
    "home": lambda cell: cell.workcell.master.go_home(),
    "settle": lambda cell: cell.workcell.master.settle(turned(0.1), (1,) * 6),
    "line": lambda cell: cell.workcell.master.line_to(tool_pose(HOME, cell)),
    "insert": lambda cell: cell.workcell.master.insert(insertion(cell, "T2")),
    **{
        f"{view} carried out": lambda cell, view=view: cell.workcell.master.supervised.carry_out(
            VIEWS[view](cell)
        )
        for view in VIEWS
    },
}


@pytest.mark.hazard(24)
@pytest.mark.parametrize("what", OTHER_MOTIONS)
def test_while_the_guide_is_before_an_entry_every_motion_off_its_axis_is_refused(
    cell: RecordingCell, what: str
) -> None:
    inserted(cell)
    with nothing_moves(cell, GUIDE_HELD_AT_ENTRY, r"PRO-014.*in front of the entry of T1"):
        OTHER_MOTIONS[what](cell)


@pytest.mark.hazard(24)
def test_a_retreat_along_another_trajectory_is_refused(cell: RecordingCell) -> None:
    inserted(cell, "T2")
    with nothing_moves(cell, GUIDE_HELD_AT_ENTRY, "not on T1; expected T1, got T2"):
        cell.workcell.master.withdraw("T1")


@pytest.mark.hazard(24)
def test_a_retreat_to_another_axis_of_the_same_name_is_refused(cell: RecordingCell) -> None:
    inserted(cell)
    aside = tool_pose(turned(0.1), cell)
    with nothing_moves(cell, TipOffAxis, "PRO-015"):
        cell.workcell.master.supervised.carry_out(
            cell.workcell.master.withdraw_motion(InsertionAxis("T1", aside, WAY_MM))
        )


@pytest.mark.hazard(24)
def test_the_arm_of_the_workcell_can_be_looked_at_and_not_moved(cell: RecordingCell) -> None:
    seen = {"kinematics", "limits", "observe", "state", "notices", "connect", "configure"}
    for arm in (cell.workcell.master.arm, cell.workcell.devices["arm"]):
        assert {name for name in dir(arm) if name[0] != "_"} == seen


@pytest.mark.hazard(24)
def test_a_retreat_with_the_tip_off_its_axis_is_refused(cell: RecordingCell) -> None:
    inserted(cell)
    A1, A2, A3, A4, A5, A6 = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.002, A2, A3, A4, A5, A6)  # pushed aside by about a millimetre
    with nothing_moves(cell, TipOffAxis, "PRO-015: the guide is not on the axis of T1"):
        cell.workcell.master.withdraw("T1")
    assert cell.workcell.master.place.is_on_axis


@pytest.mark.hazard(24)
def test_after_a_failed_approach_the_guide_is_still_known_to_be_on_its_axis(cell: RecordingCell) -> None:
    with_guide(cell)
    cell.arm.failing = LinkTimeout("telegrams ceased")
    with pytest.raises(LinkTimeout):
        cell.workcell.master.insert(insertion(cell))
    cell.arm.failing = None
    with raises(GUIDE_HELD_AT_ENTRY):
        cell.workcell.master.go_home()
    cell.workcell.master.withdraw("T1")


@pytest.mark.hazard(44)
@pytest.mark.parametrize("what", ["withdraw", *OTHER_MOTIONS])
def test_while_an_instrument_is_in_the_guide_nothing_moves_at_all(cell: RecordingCell, what: str) -> None:
    inserted(cell)
    cell.workcell.master.instrument.record_insertion("T1")
    with nothing_moves(cell, INSTRUMENT_IN_GUIDE, r"TOOL-001.*an instrument is in the guide, and in T1"):
        {**OTHER_MOTIONS, "withdraw": lambda cell: cell.workcell.master.withdraw("T1")}[what](cell)
    cell.workcell.master.instrument.record_removal()
    cell.workcell.master.withdraw("T1")


@pytest.mark.hazard(3)
def test_nothing_is_inserted_with_a_tool_other_than_the_guide(cell: RecordingCell) -> None:
    with_guide(cell)
    made = insertion(cell)
    cell.arm.mounted = 1
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    with pytest.raises(WrongTool, match="PRO-009"):
        cell.workcell.master.insert(made)
    assert cell.arm.motions == []


@pytest.mark.hazard(3)
def test_poses_of_a_tool_that_was_not_checked_are_refused(cell: RecordingCell) -> None:
    with pytest.raises(WrongTool, match="has not been checked"):
        cell.workcell.master.tool_pose()


def test_devices_are_started_and_stopped_only_once(cell: RecordingCell) -> None:
    cell.arm.state = cell.stereo.state = Lifecycle.CONFIGURED
    cell.workcell.start()
    cell.workcell.start(cameras=True)
    cell.workcell.rest()
    cell.workcell.rest()
    assert cell.arm.calls == ["activate", "deactivate"]
    assert cell.stereo.calls == ["activate", "deactivate"]


@pytest.mark.hazard(24)
def test_an_arm_declared_as_another_kind_of_device_is_refused(cell: RecordingCell) -> None:
    second = {"second": cell.theatre.robot["master"]}
    cell.opened.file = cell.theatre.model_copy(update={"device": second})
    with raises(WRONG_KIND, match=r"DEV-008: device\.second is an arm.*Declare it as \[robot\.NAME\]"):
        cell.workcell.device("second", Device)
    with raises(WRONG_KIND):
        _ = cell.workcell.devices
