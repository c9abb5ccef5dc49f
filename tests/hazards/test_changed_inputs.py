"""Hazard 1: the CT or plan changes on disk during a case, and nothing moves on results computed from them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from clinical_case import FIRST, ClinicalCell, done_later, given
from coded_errors import raises
from painted_ct import write_series
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_tool,
    coarse,
    localized_fiducials,
    locked_cart,
    mounted_guide,
    plan,
    registered_robot,
)
from scanned_head import scanned_spheres

from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome, StepSpec
from procedures.guards.errors import INPUT_CHANGED
from procedures.imaging.dicom.slice_headers import hash_series
from procedures.imaging.series import read_series
from procedures.journal.errors import StepRefused
from procedures.journal.results import StepResult
from procedures.planning.plan_model import Plan
from procedures.planning.proposed_place import read_place
from procedures.runs.comparison import Comparison, compare_inputs
from procedures.steps.clinical import positioning
from procedures.steps.clinical.cart_lock import LockedCart, Proposal
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.inputs import UnchangedInputs
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import RegisteredRobot
from procedures.workcell import MountedTool
from ronna_hw.evidence.inspection import inspect_run

POSITIONING = f"positioning:{FIRST}"
VOXELS_HU = np.arange(4 * 6 * 6, dtype=np.int16).reshape(4, 6, 6)


def made_from(model: type[StepResult], result: StepResult) -> StepSpec[StepResult]:
    """A step that leaves this result, made from another."""

    def run(context: StepContext) -> Outcome[StepResult]:
        context.result(model)
        if isinstance(result, CheckedPlan):
            context.note_inputs(context.clinical.plan)
        return Outcome(result)

    return replace(given(result), run=run, reads=(model,))


def write_plan(path: Path, content: Plan) -> None:
    path.write_text(tomli_w.dumps(content.model_dump(mode="json", by_alias=True, exclude_none=True)))


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path).carrying(MountedTool.GUIDE)


@pytest.fixture
def engine(cell: ClinicalCell) -> Engine:
    """A case that stands before the first approach, computed from a CT and a plan on disk."""
    write_series(cell.series, VOXELS_HU)
    write_plan(cell.plan, plan())
    engine = cell.begin(
        ImportedCt.from_volume(read_series(cell.series)),
        made_from(ImportedCt, localized_fiducials()),
        made_from(LocalizedFiducials, checked_plan()),
        made_from(CheckedPlan, registered_robot()),
        *(mounted_guide(), checked_tool(), checked_paths(cell), *coarse(), positioning.STEP),
    )
    assert engine.setting.clinical is not None
    inputs = UnchangedInputs(engine, engine.setting.clinical)
    engine.checkpoint.guards.append(inputs)
    engine.recorders.append(inputs)
    while str(engine.upcoming) != POSITIONING:
        engine.run_to(engine.upcoming)
    return engine


def another_series(engine: Engine) -> None:
    write_series(series_of(engine), VOXELS_HU + 1)


def one_slice_less(engine: Engine) -> None:
    next(series_of(engine).iterdir()).unlink()


def another_target(engine: Engine) -> None:
    first, *others = plan().trajectories
    x, y, z = first.target_mm
    moved = first.model_copy(update={"target_mm": (x + 1.0, y, z)})
    write_plan(plan_of(engine), plan().model_copy(update={"trajectories": (moved, *others)}))


def series_of(engine: Engine) -> Path:
    assert engine.setting.clinical is not None
    return engine.setting.clinical.series


def plan_of(engine: Engine) -> Path:
    assert engine.setting.clinical is not None
    return engine.setting.clinical.plan


def motions(cell: ClinicalCell) -> list[str]:
    return [kind for kind, _ in cell.arm.motions]


@pytest.mark.hazard(1)
@pytest.mark.parametrize("change", [another_series, one_slice_less, another_target])
def test_results_computed_from_another_ct_or_plan_move_nothing(
    cell: ClinicalCell, engine: Engine, change: Callable[[Engine], None]
) -> None:
    change(engine)
    with raises(INPUT_CHANGED, match="PRO-021"):
        engine.run_step(engine.order.find(POSITIONING))
    with pytest.raises(StepRefused):
        engine.run_step(engine.order.find(POSITIONING))
    assert motions(cell) == []
    assert engine.course.status(engine.order.find(RegisteredRobot.kind)) == "superseded"


@pytest.mark.hazard(1)
def test_a_plan_that_changes_during_an_approach_is_detected_before_the_next_motion(
    cell: ClinicalCell, engine: Engine
) -> None:
    def change_on_the_way(_start: object, _target: object) -> bool:
        another_target(engine)
        return False  # the way is clear

    cell.settled().arm.blocked = change_on_the_way
    with raises(INPUT_CHANGED):
        engine.run_step(engine.order.find(POSITIONING))
    assert motions(cell) == ["joints"]
    engine.retreat_home()
    assert engine.setting.workcell.master.place.is_home


@pytest.mark.hazard(1)
def test_files_that_were_only_touched_or_copied_count_as_unchanged(engine: Engine) -> None:
    os.utime(plan_of(engine), (0, 0))
    copy = shutil.copytree(series_of(engine), series_of(engine).with_name("copy"))
    shutil.rmtree(series_of(engine))
    copy.rename(series_of(engine))
    engine.run_step(engine.order.find(POSITIONING))


@pytest.mark.hazard(1)
@pytest.mark.parametrize("goes_on", [True, False], ids=["before a step", "before the end"])
def test_a_comment_written_into_the_plan_is_a_finding_and_the_run_is_whole(
    cell: ClinicalCell, engine: Engine, goes_on: bool
) -> None:
    with plan_of(engine).open("a") as plan_file:
        plan_file.write("# agreed with the surgeon\n")
    if goes_on:
        engine.run_step(engine.order.find(POSITIONING))
    engine.close("left")
    assert [entry for entry, _ in cell.entries("voided", "finding")] == ["finding"]
    assert inspect_run(engine.case.folder).changes == ()


@pytest.mark.hazard(1)
def test_unreadable_files_suspend_the_case_until_they_are_readable_again(engine: Engine) -> None:
    (guard,) = engine.checkpoint.guards
    hidden = series_of(engine).rename(series_of(engine).with_name("hidden"))
    assert "cannot be read" in (guard.unmet() or "")
    hidden.rename(series_of(engine))
    assert guard.unmet() is None
    assert engine.case.stands(engine.order.find(RegisteredRobot.kind))


PLACE = {
    "series_instance_uid": plan().series_instance_uid,
    "assumed_robot_from_ct": [0.0] * 6,
    "best_mm": [0.0, 0.0],
    "turned_deg": 0.0,
    "free_mm": 40.0,
    "turns_deg": [5.0, 5.0],
}


@pytest.fixture
def placed(tmp_path: Path) -> Engine:
    """A case with a cart that was locked at its proposed place."""
    cell = ClinicalCell(tmp_path)
    clinical = cell.setting().clinical
    assert clinical is not None
    write_series(cell.series, VOXELS_HU)
    write_plan(cell.plan, plan())
    clinical.place.write_text(json.dumps(PLACE))
    proposed = read_place(clinical.place)
    assert proposed is not None
    proposal = Proposal(sha256=proposed.sha256, place=proposed.place)
    locked = locked_cart().model_copy(update={"proposal": proposal})
    engine = cell.begin(done_later(locked), done_later(coarse()[0], LockedCart))
    engine.checkpoint.guards.append(UnchangedInputs(engine, clinical))
    engine.run_to(engine.order.find("cart_lock"))
    return engine


@pytest.mark.hazard(1)
def test_a_changed_proposed_position_is_detected_and_voids_the_cart_lock_compared_with_it(
    placed: Engine,
) -> None:
    place = plan_of(placed).with_name("place.json")
    place.write_text(json.dumps(PLACE | {"map": ["#"]}))
    (guard,) = placed.checkpoint.guards
    assert guard.unmet() is None  # what was compared is the same
    place.write_text(json.dumps(PLACE | {"free_mm": 400.0}))
    with raises(INPUT_CHANGED, match=r"place\.json has changed since cart_lock: another position"):
        placed.run_to()
    assert str(placed.upcoming) == "cart_lock"


@pytest.mark.hazard(1)
def test_a_missing_proposed_position_suspends_the_case_and_is_a_difference_after_a_restart(
    placed: Engine,
) -> None:
    plan_of(placed).with_name("place.json").unlink()
    (guard,) = placed.checkpoint.guards
    assert "place.json cannot be read" in (guard.unmet() or "")
    comparison = Comparison()
    compare_inputs(placed, comparison)
    (differs,) = comparison.differences
    assert differs.startswith("proposed position: recorded 01-cart_lock, found no position")


@pytest.mark.hazard(1)
def test_a_position_proposed_after_the_cart_lock_is_a_finding_and_voids_nothing(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path)
    clinical = cell.setting().clinical
    assert clinical is not None
    write_series(cell.series, VOXELS_HU)
    write_plan(cell.plan, plan())
    engine = cell.begin(done_later(locked_cart()), done_later(coarse()[0], LockedCart))
    engine.checkpoint.guards.append(UnchangedInputs(engine, clinical))
    engine.run_to(engine.order.find("cart_lock"))
    clinical.place.write_text(json.dumps(PLACE))
    engine.run_to()
    assert engine.over
    assert [entry for entry, _ in cell.entries("voided", "finding")] == ["finding"]


@pytest.fixture
def scanned(tmp_path: Path) -> Engine:
    """A case with a scan of the clamped head, beside its plan."""
    cell = ClinicalCell(tmp_path)
    clinical = cell.setting().clinical
    assert clinical is not None
    write_series(cell.series, VOXELS_HU)
    write_series(clinical.scan_series, VOXELS_HU)
    write_plan(cell.plan, plan())
    taken = scanned_spheres().model_copy(update={"files_sha256": hash_series(clinical.scan_series)})
    engine = cell.begin(done_later(taken), done_later(coarse()[0], type(taken)))
    engine.checkpoint.guards.append(UnchangedInputs(engine, clinical))
    engine.run_to(engine.order.find(taken.kind))
    return engine


@pytest.mark.hazard(1)
def test_a_changed_scan_of_the_operation_is_detected_and_voids_what_was_found_in_it(scanned: Engine) -> None:
    series = plan_of(scanned).parent / "intraoperative" / "ct"
    for path in series.iterdir():
        path.write_bytes(path.read_bytes())
    (guard,) = scanned.checkpoint.guards
    assert guard.unmet() is None  # written again with the same content
    next(series.iterdir()).unlink()
    with raises(INPUT_CHANGED, match="ct has changed since intraoperative_scan: files changed, missing"):
        scanned.run_to()
    assert str(scanned.upcoming) == "intraoperative_scan"


@pytest.mark.hazard(1)
def test_another_scan_may_be_made_while_its_step_is_repeated(scanned: Engine) -> None:
    next((plan_of(scanned).parent / "intraoperative" / "ct").iterdir()).unlink()
    (guard,) = scanned.checkpoint.guards
    scanned.running = scanned.order.find("intraoperative_scan")
    assert guard.unmet() is None
    scanned.running = None
    with raises(INPUT_CHANGED):
        guard.unmet()


@pytest.mark.hazard(1)
def test_a_changed_scan_of_the_operation_is_a_difference_after_a_restart(scanned: Engine) -> None:
    series, comparison = plan_of(scanned).parent / "intraoperative" / "ct", Comparison()
    compare_inputs(scanned, comparison)
    assert comparison.differences == []
    assert "scan of the operation" in comparison.unchanged
    with next(series.iterdir()).open("r+b") as one:
        one.seek(-1, os.SEEK_END)
        one.write(b"x")
    comparison = Comparison()
    compare_inputs(scanned, comparison)
    (differs,) = comparison.differences
    assert differs.startswith(
        "scan of the operation: recorded the one of 01-intraoperative_scan, found files"
    )
