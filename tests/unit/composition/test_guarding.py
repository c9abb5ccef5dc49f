"""Every run has the guards and watches of its kind, and they hold the arm."""

from dataclasses import replace
from pathlib import Path

import pytest
from clinical_case import ClinicalCell
from passing_clock import PassingClock
from recording_cell import GUIDE

from procedures.composition.guarding import guard
from procedures.engine.engine import Engine
from procedures.engine.order import order_of
from procedures.guards.arm_link import ArmLink
from procedures.guards.disk_space import DiskSpace
from procedures.guards.guide_still import GuideStill
from procedures.guards.head_in_sight import HeadInSight
from procedures.guards.line_of_sight import LineOfSight
from procedures.guards.mounted_tool import ToolStillMounted
from procedures.guards.tracker_link import TrackerLink
from procedures.guards.wall_clock import WallClock
from procedures.operator.errors import GuardUnmet
from procedures.operator.topic import Topic
from procedures.steps.clinical import global_localization
from procedures.steps.clinical.validity.inputs import UnchangedInputs
from procedures.workcell import MountedTool
from ronna_hw.devices.lifecycle import Lifecycle

OF_EVERY_RUN = [DiskSpace, WallClock, ArmLink, ToolStillMounted, LineOfSight]
OF_A_PATIENT = [HeadInSight, GuideStill]


ORDER = order_of([global_localization.STEP], ())


@pytest.mark.parametrize(
    ("clinical", "only_leaving", "expected"),
    [
        (True, False, [*OF_EVERY_RUN, UnchangedInputs, *OF_A_PATIENT, TrackerLink]),
        (True, True, [*OF_EVERY_RUN, *OF_A_PATIENT, TrackerLink]),
        (False, False, [*OF_EVERY_RUN, TrackerLink]),
    ],
    ids=["a case", "a case whose arm only goes home", "a calibration"],
)
def test_a_run_has_the_guards_of_its_kind(
    tmp_path: Path, clinical: bool, only_leaving: bool, expected: list[type]
) -> None:
    cell = ClinicalCell(tmp_path)
    setting = cell.setting() if clinical else replace(cell.setting(), clinical=None)
    engine = Engine(ORDER, cell.case, setting, cell.journal)
    unwatched = engine.checkpoint.watching
    guard(engine, only_leaving=only_leaving)
    assert (engine.checkpoint.watching is not unwatched) is clinical
    assert [type(one) for one in engine.checkpoint.guards] == expected


@pytest.mark.hazard(3)
def test_a_guarded_case_does_not_move_with_another_tool(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    cell.clock = PassingClock()
    engine = cell.engine(ORDER)
    guard(engine)
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.check_mounted(MountedTool.STEREO_HEAD)
    cell.arm.mounted = GUIDE
    cell.operator.refusing = (Topic.GUARD,)
    with pytest.raises(GuardUnmet, match=r"PRO-017.*tool"):
        cell.workcell.go(cell.arm.joints_rad)
    assert cell.arm.motions == []
