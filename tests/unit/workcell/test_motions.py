"""What a question states about a motion is what the arm then does, for every kind of motion."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from planned_arm import PlannedArm
from recording_cell import GUIDE, HOME, RecordingCell, RecordingOperator, tool_pose

from procedures.operator.question import Question, Topic
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.arm_history import ArmHistory, ArmPlace, PlaceKind
from procedures.workcell.errors import TipOffAxis
from procedures.workcell.motions import MotionFacts
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Obstacle, Surroundings
from ronna_hw.arm.clearance.sweep import sweep
from ronna_hw.arm.motion.limits import WORKING_LINE_SPEED_MM_S
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.set_points import PathMotion
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

CYCLE_S = 0.004
WAY_MM = 50.0
TOLD = re.compile(
    r"^first: .* moves (\d+) mm( via home)?$[\s\S]*^speed: up to (\d+) mm/s, in (\d+\.\d) s; ", re.MULTILINE
)
START: JointVector = (HOME[0] - 0.4, *HOME[1:])
ACROSS: JointVector = (HOME[0] + 0.4, *HOME[1:])
LIFTED: JointVector = (HOME[0], HOME[1] - 0.4, *HOME[2:])


@pytest.fixture
def cell(tmp_path: Path) -> RecordingCell:
    """With the guide mounted, home over the middle, and the arm beside it."""
    cell = RecordingCell(tmp_path, operator=RecordingOperator())
    cell.arm = PlannedArm("arm", state=Lifecycle.ACTIVE, mounted=GUIDE, joints_rad=LIFTED)
    cell.opened.replace_device("robot.master", cell.arm)
    cell.workcell.master.mount.check(MountedTool.GUIDE)
    cell.workcell.master.set_home()
    cell.arm.joints_rad = START
    cell.have_asked(cell.operator.word)
    return cell


def arm_of(cell: RecordingCell) -> PlannedArm:
    assert isinstance(cell.arm, PlannedArm)
    return cell.arm


def tool_at(cell: RecordingCell, ahead_mm: float, turned_rad: float = 0.0) -> Transform:
    """A pose of the tool that far along its own axis, and turned about it."""
    here = tool_pose(cell.arm.joints_rad, cell)
    half = turned_rad / 2.0
    way = Transform.of(
        here.source,
        here.source,
        translation_mm=(0.0, 0.0, ahead_mm),
        quaternion_wxyz=(math.cos(half), 0.0, math.sin(half), 0.0),
    )
    return here @ way


def withdraw(cell: RecordingCell) -> None:
    """The guide is on its axis already, as in a run that is resumed."""
    on = InsertionAxis("T1", tool_pose(cell.arm.joints_rad, cell), WAY_MM)
    cell.workcell.master.restore_history(ArmHistory(place=ArmPlace(PlaceKind.ON_AXIS, on)))
    cell.workcell.master.withdraw("T1")


def go_past_a_post(cell: RecordingCell) -> None:
    x, y, z = arm_of(cell).kinematics.flange_pose(HOME).translation_mm.tolist()
    post = Obstacle("post", Capsule((x, y, z - 100.0), (x, y, z), 5.0))
    arm_of(cell).surround(Surroundings(obstacles=(post,)))
    cell.workcell.master.go(ACROSS)


KINDS: dict[str, Callable[[RecordingCell], object]] = {
    "go": lambda cell: cell.workcell.master.go(ACROSS),
    "go past a post": go_past_a_post,
    "home": lambda cell: cell.workcell.master.go_home(),
    "step": lambda cell: cell.workcell.master.settle(ACROSS, None),
    "settle": lambda cell: cell.workcell.master.settle(ACROSS, (1, -1, 1, -1, 1, -1)),
    "settle nearby": lambda cell: cell.workcell.master.settle(
        cell.workcell.master.joints_rad(), (1, -1, 1, -1, 1, -1)
    ),
    "line": lambda cell: cell.workcell.master.line_to(tool_at(cell, 40.0, 0.2)),
    "insert": lambda cell: cell.workcell.master.insert(InsertionAxis("T1", tool_at(cell, WAY_MM), WAY_MM)),
    "withdraw": withdraw,
}


def points(cell: RecordingCell, plan: MotionPlan) -> list[JointVector]:
    """The set-points of a plan, one per cycle, as the real-time process generates them."""
    path = plan.path(cell.arm.kinematics)
    motion = PathMotion(path, plan.start_rad, plan.limits, CYCLE_S, plan.speed_steps)
    found = [plan.start_rad]
    while not motion.is_finished:
        go_rad, _ = motion.prepare()
        motion.take_go()
        found.append(go_rad)
    return found


@pytest.mark.hazard(36)
@pytest.mark.parametrize("kind", KINDS)
def test_the_duration_and_speed_in_the_question_are_those_of_the_actual_motion(
    cell: RecordingCell, kind: str
) -> None:
    KINDS[kind](cell)
    (asked,) = cell.operator.asked
    said = TOLD.search(asked.value)
    assert said is not None
    assert (said[2] is not None) is (kind == "go past a post")
    ways = [points(cell, plan) for plan in arm_of(cell).plans]
    bodies = Bodies(cell.arm.kinematics, arm_of(cell).surroundings)
    steps_mm = [np.diff(sweep(bodies, way).ends_mm, axis=0) for way in ways]
    fastest_mm_s = max(np.linalg.norm(step, axis=-1).max() for step in steps_mm) / CYCLE_S
    assert float(said[4]) == pytest.approx(sum(len(way) - 1 for way in ways) * CYCLE_S, abs=0.07)
    assert float(said[3]) == pytest.approx(fastest_mm_s, rel=0.05, abs=1.0)


@pytest.mark.hazard(36)
def test_the_guide_goes_in_at_half_the_speed_of_its_retreat(cell: RecordingCell) -> None:
    KINDS["insert"](cell)
    cell.workcell.master.withdraw("T1")
    speeds_mm_s = []
    for plan in arm_of(cell).plans:
        tips = np.array([tool_pose(joints, cell).translation_mm for joints in points(cell, plan)])
        speeds_mm_s.append(np.linalg.norm(np.diff(tips, axis=0), axis=1).max() / CYCLE_S)
    full_mm_s = WORKING_LINE_SPEED_MM_S
    assert speeds_mm_s == pytest.approx([full_mm_s / 2.0, full_mm_s], rel=0.02)


@pytest.mark.hazard(36)
@pytest.mark.parametrize("kind", ["insert", "withdraw"])
def test_after_a_stop_the_question_states_the_remaining_motion(cell: RecordingCell, kind: str) -> None:
    cell.arm.interruptions = 1
    KINDS[kind](cell)
    whole, pause, rest = cell.operator.asked
    assert pause.topic is Topic.PAUSE
    assert [int(TOLD.search(one.value)[1]) for one in (whole, rest)] == [50, 25]  # type: ignore[index]


@pytest.mark.hazard(36)
@pytest.mark.hazard(24)
@pytest.mark.parametrize("kind", ["insert", "withdraw"])
def test_a_guide_pushed_aside_during_a_stop_does_not_continue(cell: RecordingCell, kind: str) -> None:
    cell.arm.interruptions = 1
    answer = cell.operator.word

    def push(question: Question) -> str:
        if question.topic is Topic.PAUSE:
            A1, *others = cell.arm.joints_rad
            cell.arm.joints_rad = (A1 + 0.002, *others)  # by about a millimetre
        return answer(question)

    cell.have_asked(push)
    with pytest.raises(TipOffAxis, match="PRO-015"):
        KINDS[kind](cell)
    assert arm_of(cell).plans == []


@pytest.mark.parametrize(
    ("travel_mm", "turn_deg", "moves", "turns"),
    [(8.3, 0.31, "moves 8 mm", "up to 0.3 deg"), (0.4, 12.2, "moves 0.4 mm", "up to 12 deg")],
)
def test_a_motion_that_would_round_to_nothing_is_told_with_a_decimal(
    travel_mm: float, turn_deg: float, moves: str, turns: str
) -> None:
    turn = (0.0, math.radians(turn_deg))
    preview = SimpleNamespace(
        joint_ranges_rad=[turn],
        duration_s=1.0,
        largest_speed_mm_s=8.0,
        refused=None,
        closest=None,
        nearest_to_head_mm=None,
    )
    facts = MotionFacts("the stereo head", travel_mm, (cast(PathPreview, preview),))
    assert f"the stereo head {moves}, joints turn {turns}, in 1.0 s at up to 8 mm/s" in str(facts)
    assert facts.read_back.shown == moves
    assert facts.read_back.fits(moves.removeprefix("moves "))
