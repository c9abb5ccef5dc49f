"""What suspends a running step, with a reason that says what to do; each guard alone, in this process."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from passing_clock import PassingClock
from recording_cell import GUIDE, RecordingCell

from procedures.engine.order import order_of
from procedures.guards.default_guards import ArmLink, DiskSpace, ToolStillMounted, WallClock
from procedures.guards.tracker_guards import FRAME_PATIENCE_S, LineOfSight
from procedures.operator.errors import GuardUnmet
from procedures.operator.question import Question, Topic
from procedures.runs.answers import ScriptedOperator
from procedures.steps.clinical import set_up
from procedures.workcell import MountedTool
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import LinkTimeout


@pytest.fixture
def cell(tmp_path: Path) -> RecordingCell:
    cell = RecordingCell(tmp_path)
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    return cell


@pytest.mark.hazard(33)
def test_low_disk_space_suspends_the_case(tmp_path: Path) -> None:
    assert DiskSpace(tmp_path, least_bytes=1).unmet() is None
    reason = DiskSpace(tmp_path, least_bytes=10**18).unmet()
    assert reason is not None
    assert "MB free" in reason
    assert "delete" in reason


@pytest.mark.hazard(33)
def test_a_missing_run_folder_suspends_the_case(tmp_path: Path) -> None:
    assert f"{tmp_path}/gone is not there: move it back" in (DiskSpace(tmp_path / "gone").unmet() or "")


@pytest.mark.hazard(29)
@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_jump_of_the_wall_clock_gives_one_finding_and_stops_nothing(step_s: float) -> None:
    found: list[str] = []
    wall, monotonic = [1e9], [0.0]
    guard = WallClock(found.append, lambda: wall[0], lambda: monotonic[0])
    wall[0], monotonic[0] = 1e9 + 7200.0, 7200.0  # two hours pass
    guard.unmet()
    wall[0] += step_s
    guard.unmet()
    guard.unmet()
    assert len(found) == 1
    assert f"{step_s:+.1f} s" in found[0]


@pytest.mark.hazard(4)
def test_a_stale_arm_pose_suspends_the_case(cell: RecordingCell) -> None:
    guard = ArmLink(cell.workcell.master)
    assert guard.unmet() is None
    stale = replace(cell.arm.read_state(), validity=Validity.STALE)
    cell.arm.observe = lambda: LastKnown(Lifecycle.ACTIVE, None, stale)  # type: ignore[method-assign]
    assert "has not reported its position" in (guard.unmet() or "")


@pytest.mark.hazard(18)
def test_a_link_that_loses_a_tenth_of_its_cycles_suspends_the_case_until_it_recovers(
    cell: RecordingCell,
) -> None:
    guard = ArmLink(cell.workcell.master)
    health = cell.arm.link_statistics()

    def after(cycles: int, lost: int) -> str | None:
        nonlocal health
        health = replace(health, cycles=health.cycles + cycles, lost_cycles=health.lost_cycles + lost)
        cell.arm.link_statistics = lambda: health  # type: ignore[method-assign]
        return guard.unmet()

    assert after(1000, 10) is None
    assert after(1000, 10) is None
    assert "100 of the last 1000 cycles" in (after(1000, 100) or "")
    assert after(10, 0) is not None  # too few to say that it is better
    assert after(1000, 0) is None


@pytest.mark.hazard(3)
@pytest.mark.parametrize(("mounted", "said"), [(0, "no tool"), (GUIDE, f"tool {GUIDE}")])
def test_a_tool_exchanged_meanwhile_suspends_the_case(cell: RecordingCell, mounted: int, said: str) -> None:
    doubts: list[str] = []
    guard = ToolStillMounted(cell.workcell, doubts.append)
    assert guard.unmet() is None
    assert doubts == []
    cell.arm.mounted = mounted
    reason = guard.unmet()
    assert said in doubts[0]
    assert reason is not None
    assert said in reason
    assert "mount" in reason


class Tracker:
    """Sees the frame or not; every reading is one frame later."""

    def __init__(self) -> None:
        self.state = Lifecycle.ACTIVE
        self.frames = 0
        self.validity = Validity.OK
        self.line_is_cut = False

    def read_frame(self) -> Any:
        self.frames += 1
        if self.line_is_cut:
            raise LinkTimeout("no reply")

    def observe(self) -> LastKnown[Any]:
        reading = SimpleNamespace(tool=lambda _name: SimpleNamespace(validity=self.validity))
        return LastKnown(self.state, None, reading)


@pytest.mark.hazard(14)
@pytest.mark.parametrize("line_is_cut", [False, True])
def test_a_lost_line_of_sight_suspends_the_case_until_the_tracker_sees_the_frame_again(
    line_is_cut: bool,
) -> None:
    tracker, now_s = Tracker(), 0.0
    guard = LineOfSight(tracker, "robot_frame", lambda: now_s)  # type: ignore[arg-type]
    tracker.line_is_cut = line_is_cut
    assert guard.unmet() is None
    tracker.validity = Validity.MISSING
    assert guard.unmet() is None  # a hand that passes
    now_s += FRAME_PATIENCE_S
    reason = guard.unmet()
    assert reason is not None
    assert "robot_frame" in reason
    assert "clear the line" in reason
    assert tracker.frames == 1  # it looks again by itself
    tracker.validity = Validity.OK
    assert guard.unmet() is None


def test_a_scripted_operator_leaves_when_a_guard_asks_the_same_question_twice() -> None:
    question = Question(Topic.GUARD, "disk space: 1 MB", "before the motion", ("wait", "leave"))
    script = ScriptedOperator()
    assert [script.ask(question).word for _ in range(2)] == ["wait", "leave"]


@pytest.mark.hazard(33)
def test_a_guard_condition_that_is_not_restored_ends_the_step_before_its_motion(cell: RecordingCell) -> None:
    cell.clock = PassingClock()
    engine = cell.engine(order_of([set_up.STEP], ()))
    engine.checkpoint.guards.append(DiskSpace(cell.folder / "gone"))
    cell.operator.refusing = (Topic.GUARD,)
    with pytest.raises(GuardUnmet, match="PRO-017: disk space"):
        cell.workcell.master.go(cell.arm.joints_rad)
    assert cell.arm.motions == []
