"""Every run has the guards and watches of its kind, and they hold the arm."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
import tomli_w
from clinical_case import ClinicalCell
from passing_clock import PassingClock
from plain_steps import only_home_remains
from recording_cell import GUIDE, RecordingCell, mini_theatre_file

from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.engine.order import order_of
from procedures.guards.default_guards import ArmLink, DiskSpace, ToolStillMounted, UnchangedRecords, WallClock
from procedures.guards.guide_displacement import GuideDisplacement
from procedures.guards.tracker_guards import HeadInSight, LineOfSight, TrackerLink
from procedures.operator.errors import GuardUnmet
from procedures.operator.question import Question, Topic
from procedures.runs.engine_setup import add_guards
from procedures.steps.clinical import global_localization
from procedures.steps.clinical.inputs import UnchangedInputs
from procedures.workcell import MountedTool
from ronna_hw.config import read_theatre_file
from ronna_hw.devices.lifecycle import Lifecycle

OF_EVERY_RUN = [DiskSpace, WallClock, ArmLink, ToolStillMounted, LineOfSight]
OF_A_PATIENT = [GuideDisplacement, HeadInSight]


ORDER = order_of([global_localization.STEP], ())


@pytest.mark.parametrize(
    ("clinical", "only_leaving", "expected"),
    [
        (True, False, [*OF_EVERY_RUN, UnchangedRecords, UnchangedInputs, *OF_A_PATIENT, TrackerLink]),
        (True, True, [*OF_EVERY_RUN, *OF_A_PATIENT, TrackerLink]),
        (False, False, [*OF_EVERY_RUN, UnchangedRecords, TrackerLink]),
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
    add_guards(engine, tmp_path / "theatre.toml", cell.theatre, only_leaving=only_leaving)
    assert (engine.checkpoint.watching is not unwatched) is clinical
    assert [type(one) for one in engine.checkpoint.guards] == expected


@pytest.mark.hazard(1)
def test_a_calibration_renewed_during_a_case_suspends_its_next_motion_until_it_is_put_back(
    tmp_path: Path,
) -> None:
    cell = RecordingCell(tmp_path)
    cell.clock = PassingClock()
    file = mini_theatre_file(tmp_path, simulated=True)
    former, began_with = file.read_bytes(), read_theatre_file(file)
    setting = replace(cell.setting(), clinical=None)
    engine = Engine(only_home_remains(), cell.case, setting, cell.journal)
    add_guards(engine, file, began_with)
    moved = len(cell.arm.motions)
    content = tomllib.loads(former.decode())
    content["calibration"]["tool_tip"]["stated_error_mm"] = 0.07
    file.write_text(tomli_w.dumps(content))
    cell.operator.refusing = (Topic.GUARD,)
    with pytest.raises(GuardUnmet, match=r"PRO-017: .*calibration\.tool_tip in theatre\.toml changed after"):
        engine.run_to()
    assert len(cell.arm.motions) == moved
    assert ("rested", "") in cell.entries("rested")
    cell.workcell.master.set_home()
    engine.retreat_home()  # is not held up
    file.write_bytes(former)
    engine.run_to()
    assert len(cell.arm.motions) > moved


@pytest.fixture
def guarded(tmp_path: Path) -> ClinicalCell:
    """With the stereo head found mounted, an arm that may move, and nobody who settles what a guard finds."""
    cell = ClinicalCell(tmp_path)
    cell.clock = PassingClock()
    add_guards(cell.engine(ORDER), tmp_path / "theatre.toml", cell.theatre, only_leaving=True)
    cell.arm.state = Lifecycle.ACTIVE
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    cell.operator.refusing = (Topic.GUARD,)
    return cell


@pytest.mark.hazard(3)
@pytest.mark.parametrize("meanwhile", [False, True], ids=["before", "while the first motion is confirmed"])
def test_a_guarded_case_does_not_move_with_another_tool(guarded: ClinicalCell, meanwhile: bool) -> None:
    def exchange(question: Question) -> None:
        if question.topic is Topic.FIRST_MOTION:
            guarded.arm.mounted = GUIDE

    guarded.operator.meanwhile = exchange
    guarded.arm.mounted = guarded.arm.mounted if meanwhile else GUIDE
    with pytest.raises(GuardUnmet, match=r"PRO-017.*tool"):
        guarded.workcell.master.go(guarded.arm.joints_rad)
    assert guarded.arm.motions == []


@pytest.mark.hazard(4)
def test_a_stop_that_fails_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = ClinicalCell(tmp_path)
    engine = cell.engine(ORDER)
    add_guards(engine, tmp_path / "theatre.toml", cell.theatre)
    reader = engine.events.subscribe()
    monkeypatch.setattr(cell.opened, "stop", lambda: ["the arm may not be at rest"])
    cell.workcell.stop()
    assert Advisory(text="the arm may not be at rest") in [one.what for one in reader.read(0.1).events]
