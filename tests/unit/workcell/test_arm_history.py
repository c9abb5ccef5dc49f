"""The history of an arm: the same while a case runs and when its journal is read again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from recording_cell import GUIDE, HOME, RecordingCell, RecordingOperator, tool_pose

from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.operator.errors import NotConfirmed, OperatorAborted
from procedures.operator.question import Topic
from procedures.strategies.trajectory import back_along_axis
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.arm_history import TRAIL, ArmHistory, PlaceKind, arm_history, fold_history
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout
from ronna_hw.evidence.journal_reading import JournalChain, JournalCorrupt, Line
from ronna_hw.evidence.lost_journal_end import lost_as_plain
from ronna_hw.vectors import JointVector

WAY_MM = 60.0
AWAY: JointVector = (HOME[0] + 0.1, *HOME[1:])
FARTHER: JointVector = (HOME[0] + 0.2, *HOME[1:])


@pytest.fixture
def cell(cell: RecordingCell) -> RecordingCell:
    """With the guide mounted, at home."""
    cell.arm.mounted = GUIDE
    cell.workcell.master.mount.check(MountedTool.GUIDE)
    cell.workcell.master.set_home()
    return cell


def compared(history: ArmHistory) -> tuple[ArmHistory, object]:
    """With the axis in plain numbers: a pose has no equality."""
    axis = None if history.place.axis is None else history.place.axis.as_plain()
    return replace(history, place=replace(history.place, axis=None)), axis


def ahead(cell: RecordingCell) -> InsertionAxis:
    """A trajectory whose stand-off is where the guide is now."""
    held = back_along_axis(tool_pose(cell.arm.joints_rad, cell), -WAY_MM)
    return InsertionAxis("T1", held, WAY_MM, (1, -1) * 3)


def nothing(_cell: RecordingCell) -> None:
    pass


def away(cell: RecordingCell) -> None:
    cell.workcell.master.go(AWAY)
    cell.workcell.master.settle(FARTHER, (1,) * 6)


def inserted(cell: RecordingCell) -> None:
    cell.workcell.master.go(AWAY)
    cell.workcell.master.insert(ahead(cell))


def worked(cell: RecordingCell) -> None:
    inserted(cell)
    instrument = cell.workcell.master.instrument
    instrument.stages.record_stop("T1", {"mm": 120.5})
    instrument.stages.record_begin("T1", "drill")
    instrument.record_insertion("T1")
    instrument.stages.record_done("T1", "drill")
    instrument.stages.record_begin("T1", "insert")


def taken_out(cell: RecordingCell) -> None:
    worked(cell)
    cell.workcell.master.instrument.record_removal()


def withdrawn(cell: RecordingCell) -> None:
    taken_out(cell)
    cell.workcell.master.withdraw("T1")


def home_again(cell: RecordingCell) -> None:
    withdrawn(cell)
    cell.workcell.master.return_home()


def failed(cell: RecordingCell) -> None:
    cell.arm.failing = LinkTimeout("telegrams ceased")
    with pytest.raises(LinkTimeout):
        cell.workcell.master.go(AWAY)


def refused(cell: RecordingCell) -> None:
    cell.arm.state = Lifecycle.ACTIVE
    cell.arm.blocked = lambda _start, _target: True
    with pytest.raises(NotClear):
        cell.workcell.master.go(AWAY)


def cut_short(cell: RecordingCell) -> None:
    cell.have_asked(RecordingOperator(Topic.PAUSE).word)
    cell.arm.interruptions = 1
    with pytest.raises(OperatorAborted):
        cell.workcell.master.go(AWAY)


@pytest.mark.hazard(2)
@pytest.mark.parametrize(
    "made", [nothing, away, inserted, worked, withdrawn, home_again, failed, refused, cut_short]
)
def test_the_journal_tells_a_resumed_case_what_the_running_one_knew(
    cell: RecordingCell, made: Callable[[RecordingCell], None]
) -> None:
    made(cell)
    read_again = arm_history(read_journal(cell.folder / JOURNAL_FILE))
    assert compared(read_again) == compared(cell.workcell.master.history)


@pytest.mark.parametrize(
    ("made", "is_away"),
    [
        (nothing, False),
        (away, True),
        (inserted, True),
        (withdrawn, True),
        (home_again, False),
        (refused, False),
        (cut_short, True),
    ],
)
def test_the_arm_is_away_from_when_it_leaves_home_until_it_is_back(
    cell: RecordingCell, made: Callable[[RecordingCell], None], is_away: bool
) -> None:
    made(cell)
    assert cell.workcell.master.place.is_out is is_away
    assert cell.workcell.master.place.is_home is not is_away


@pytest.mark.hazard(5)
def test_a_first_motion_that_failed_on_its_way_leaves_the_arm_away(cell: RecordingCell) -> None:
    failed(cell)
    cell.arm.joints_rad = AWAY
    assert cell.workcell.master.place.is_out


def test_an_arm_in_fault_that_left_home_is_away_until_its_joints_are_read(cell: RecordingCell) -> None:
    cell.workcell.master.set_home()
    cell.workcell.master.go(AWAY)
    cell.arm.joints_rad, cell.arm.state = HOME, Lifecycle.FAULT
    assert cell.workcell.master.place.is_out


def test_an_arm_that_stands_at_home_is_not_away_however_it_came_there(cell: RecordingCell) -> None:
    cell.workcell.master.go(AWAY)
    cell.workcell.master.go(HOME)
    assert not cell.workcell.master.place.is_out


def test_an_approach_that_the_operator_declines_leaves_the_guide_free_to_go_home(cell: RecordingCell) -> None:
    cell.workcell.master.go(AWAY)
    cell.workcell.master.supervised.reset_confirmation()
    cell.have_asked(RecordingOperator(Topic.FIRST_MOTION).word)
    with pytest.raises(NotConfirmed, match="PRO-002"):
        cell.workcell.master.insert(ahead(cell))
    assert not cell.workcell.master.place.is_on_axis


@pytest.mark.hazard(2)
def test_a_torn_journal_leaves_it_open_whether_an_instrument_is_inside_also_at_a_second_restart(
    cell: RecordingCell,
) -> None:
    worked(cell)
    cell.workcell.master.instrument.record_removal()
    assert cell.workcell.master.history.instrument_out
    restarted = {"entry": Entry.RESTARTED, "torn_bytes": 120}
    assert not cell.workcell.master.history.with_line(restarted).instrument_out


def test_an_instrument_that_is_assumed_to_be_inside_is_not_out(cell: RecordingCell) -> None:
    withdrawn(cell)
    cell.workcell.master.instrument.record_assumed("T1")
    assert cell.workcell.master.place.instrument_may_be_inside == "T1"
    assert not cell.workcell.master.history.instrument_out


MOTION_FROM_HOME = [{"entry": Entry.PLACED, "at_home": True}, {"entry": Entry.MOTION, "what": "go"}]


def test_a_motion_without_an_end_leaves_the_place_unknown_once_its_program_is_gone() -> None:
    history = arm_history(MOTION_FROM_HOME)
    assert history.place.place_kind is PlaceKind.MOVING
    assert history.with_line({"entry": Entry.RESTARTED}).place.place_kind is PlaceKind.UNKNOWN
    assert history.with_restart(torn=False) == history.with_line({"entry": Entry.RESTARTED})


def test_lost_lines_leave_the_place_unknown_until_the_arm_is_measured() -> None:
    torn = arm_history(MOTION_FROM_HOME[:1]).with_restart(torn=True)
    assert torn.place.place_kind is PlaceKind.UNKNOWN
    assert torn.place.is_out
    assert torn.with_line({"entry": Entry.PLACED, "at_home": True}).place.is_home
    assert torn.with_line({"entry": Entry.PLACED, "at_home": False}).place.place_kind is PlaceKind.AWAY


@pytest.mark.hazard(44)
def test_work_in_lost_lines_stays_known_and_in_doubt_to_every_later_program() -> None:
    lost: tuple[Line, ...] = (
        {"entry": Entry.STAGE, "trajectory": "T1", "task": "drill", "done": True},
        {"entry": Entry.INSTRUMENT, "trajectory": "T1", "inside": True},
        {"entry": Entry.STAGE, "trajectory": "T1", "task": ["not", "a", "task"], "done": True},
    )
    left = fold_history(JournalChain(tuple(MOTION_FROM_HOME[:1])), lost)
    assert left.stages == {"T1": {"drill": True}}
    assert left.doubted == {"T1"}
    assert left.place.instrument_may_be_inside == "T1"
    assert left.place.place_kind is PlaceKind.UNKNOWN
    assert arm_history([*MOTION_FROM_HOME[:1], {"entry": Entry.RESTARTED, **lost_as_plain(lost)}]) == left


@pytest.mark.hazard(44)
@pytest.mark.parametrize(
    ("made", "torn", "inside", "assumed"),
    [
        (away, False, None, False),
        (inserted, False, "T1", True),
        (worked, False, "T1", False),
        (taken_out, False, None, False),
        (taken_out, True, "T1", True),
        (withdrawn, False, None, False),
    ],
)
def test_after_a_kill_an_instrument_counts_as_inside_unless_it_was_confirmed_out(
    cell: RecordingCell, made: Callable[[RecordingCell], None], torn: bool, inside: str | None, assumed: bool
) -> None:
    made(cell)
    assert cell.workcell.master.place.assumed is False
    place = cell.workcell.master.history.with_restart(torn=torn).place
    assert (place.instrument_may_be_inside, place.assumed) == (inside, assumed)


@pytest.mark.hazard(5)
def test_an_arm_that_was_jogged_is_where_its_joints_say(cell: RecordingCell) -> None:
    lines = len(list(read_journal(cell.folder / JOURNAL_FILE)))
    cell.workcell.master.compare_place()
    assert len(list(read_journal(cell.folder / JOURNAL_FILE))) == lines  # as the journal has it
    cell.arm.joints_rad = AWAY
    cell.workcell.master.compare_place()
    assert cell.workcell.master.place.place_kind is PlaceKind.AWAY
    assert list(read_journal(cell.folder / JOURNAL_FILE))[-1]["entry"] == Entry.PLACED
    cell.arm.joints_rad = HOME
    cell.workcell.master.compare_place()
    assert cell.workcell.master.place.is_home


def test_a_guide_that_was_jogged_home_is_on_no_axis(cell: RecordingCell) -> None:
    worked(cell)
    cell.arm.joints_rad = HOME
    cell.workcell.master.compare_place()
    assert cell.workcell.master.place.is_home
    assert not cell.workcell.master.place.is_on_axis
    assert cell.workcell.master.instrument.inside == "T1"  # until it is confirmed to be out


def test_lines_of_another_arm_do_not_move_this_one() -> None:
    other = [{**line, "arm": "second"} for line in MOTION_FROM_HOME]
    assert arm_history(other) == arm_history([])
    assert arm_history(other, "second").place == arm_history(MOTION_FROM_HOME).place


def test_what_interrupted_a_stage_is_known_until_one_is_done_there() -> None:
    begun = {"entry": Entry.STAGE, "trajectory": "T1", "task": "insert", "done": False}
    interrupted = {"entry": Entry.STAGE, "trajectory": "T1", "task": "insert", "interrupted": "pushed"}
    lines = [begun, interrupted, begun]
    assert arm_history(lines).interruptions == {"T1": "pushed"}
    assert arm_history(lines).stages == {"T1": {"insert": False}}
    assert arm_history([*lines, {**begun, "done": True}]).interruptions == {}


def test_only_the_last_positions_of_a_long_way_are_kept() -> None:
    line = {"entry": Entry.MOVED, "joints_rad": list(HOME)}
    assert len(arm_history([line] * (TRAIL + 1)).trail) == TRAIL


@pytest.mark.parametrize(
    "line",
    [
        {"entry": "motion", "what": "insert", "trajectory": "T1", "to": [0, 0, 0]},
        {"entry": "moved", "joints_rad": 5},
        {"entry": "instrument"},
        {"entry": "stage", "trajectory": "T1"},
    ],
    ids=lambda line: line["entry"],
)
def test_a_line_that_is_not_ours_is_refused(line: dict[str, object]) -> None:
    with pytest.raises(JournalCorrupt, match=r"PRO-011.*line 4"):
        arm_history([{"sequence": 4, **line}])  # type: ignore[dict-item]
