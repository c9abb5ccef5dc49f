"""A dry run lists the motions from the arm's current place, with spheres numbered from one."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from clinical_case import HOME_RAD, ClinicalCell
from prepared_results import checked_paths, checked_plan, coarse, localized_fiducials

from procedures.engine.case import StepKey
from procedures.planning.pose_name import HOME, PoseName
from procedures.steps.clinical import tool_check
from procedures.steps.clinical.path_check import CheckedPaths, MotionPreview
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.relocalization import STEP
from procedures.steps.clinical.results import ConfirmedTarget, KnownBases
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.tool_check import CheckedTool
from procedures.steps.dry_run import describe_planned_motions
from procedures.workcell import MountedTool

PLACES = (HOME, *(PoseName.parse(f"T1/fiducial {number}") for number in range(4)))


def motion(start: PoseName, end: PoseName, kind: str = "") -> MotionPreview:
    return MotionPreview(
        start=start,
        end=end,
        kind=kind or ("move" if start != end else "line"),
        duration_s=1.0,
        clear=True,
        closest=None,
        largest_joint_speed_share=0.1,
        largest_speed_mm_s=100.0,
        nearest_to_head_mm=None,
    )


def said(cell: ClinicalCell, paths: CheckedPaths) -> tuple[str, ...]:
    engine = cell.begin(paths, *coarse(), STEP)
    engine.run_to(engine.order.sequence[0])
    key = next(key for key in engine.order.sequence if key.name == STEP.name)
    lines = describe_planned_motions(engine.case, StepKey(key.name, "T1"), cell.setting())
    assert lines is not None
    return lines


@pytest.fixture
def paths(cell: ClinicalCell) -> CheckedPaths:
    planned = checked_paths(cell.carrying(MountedTool.STEREO_HEAD))
    ways = (
        one
        for start, end in pairwise(PLACES)
        for one in (motion(start, end), motion(end, end), motion(end, end, "back"))
    )
    return planned.model_copy(update={"motions": tuple(ways)})


def test_from_home_every_motion_is_listed_and_spheres_are_numbered_from_one(
    cell: ClinicalCell, paths: CheckedPaths
) -> None:
    cell.arm.joints_rad = HOME_RAD
    lines = said(cell, paths)
    assert lines[0].startswith("move home to T1/sphere 1, ")
    assert lines[-2].startswith("line onto T1/sphere 4, ")
    assert lines[-1].startswith("back from T1/sphere 4, ")
    assert len(lines) == 3 * len(PLACES[1:])


def test_a_way_by_home_from_one_sphere_to_the_next_is_listed(cell: ClinicalCell, paths: CheckedPaths) -> None:
    cell.arm.joints_rad = HOME_RAD
    _, second, *_ = PLACES[1:]
    direct = next(one for one in paths.motions if one.end == second)
    via_home = (motion(direct.start, HOME), motion(HOME, second))
    before, after = paths.motions[: paths.motions.index(direct)], paths.motions[len(via_home) + 2 :]
    lines = said(cell, paths.model_copy(update={"motions": (*before, *via_home, *after)}))
    assert len(lines) == 3 * len(PLACES[1:]) + 1
    assert lines[3].startswith("move T1/sphere 1 to home, ")


def test_the_line_onto_a_target_is_of_its_approach_and_the_line_back_of_its_retreat(
    cell: ClinicalCell, paths: CheckedPaths
) -> None:
    target = PoseName.parse("T1/target")
    onto, back_off = (motion(target, target, kind) for kind in ("line", "back"))
    ways = (motion(HOME, target), onto, back_off, motion(target, HOME))
    cell.arm.joints_rad = HOME_RAD
    engine = cell.begin(paths.model_copy(update={"motions": ways}), *coarse(), STEP)
    engine.run_to(engine.order.sequence[0])
    there, back = (
        [line.partition(",")[0] for line in describe_planned_motions(engine.case, key, cell.setting()) or ()]
        for key in (StepKey(PositionedGuide.kind, "T1"), StepKey(Retreated.kind, "T1"))
    )
    assert there == ["move home to T1/target", "line onto T1/target"]
    assert back == ["back from T1/target", "move T1/target to home"]


def test_of_the_bases_it_is_said_how_both_arms_move_and_why_no_path_is_known(
    cell: ClinicalCell, paths: CheckedPaths
) -> None:
    engine = cell.begin(paths, *coarse(), STEP)
    engine.run_to(engine.order.sequence[0])
    why, *lines = describe_planned_motions(engine.case, StepKey(KnownBases.kind), cell.setting()) or ()
    assert "past the other arm" in why
    assert [line.partition(" to ")[0] for line in lines] == [
        "move of the arm",
        "move of the assistant",
        "move of the assistant",
        "move of both arms",
    ]


def test_over_a_sphere_only_the_remaining_motions_are_listed(cell: ClinicalCell, paths: CheckedPaths) -> None:
    cell.arm.joints_rad = paths.localizations["T1"][0].joints_rad
    heading, first, *_others = said(cell, paths)
    assert heading == "the arm is over sphere 1; from there"
    assert first.startswith("move T1/sphere 1 to T1/sphere 2, ")


@pytest.mark.parametrize("key", [StepKey(CheckedTool.kind), StepKey(ConfirmedTarget.kind, "T1")], ids=str)
def test_the_motions_over_the_gauge_are_told_with_distance_speed_and_clearance(
    cell: ClinicalCell, paths: CheckedPaths, key: StepKey
) -> None:
    cell.arm.joints_rad = HOME_RAD
    engine = cell.begin(checked_plan(), localized_fiducials(), paths, *coarse(), tool_check.STEP)
    engine.run_to(engine.order.sequence[-2])
    there, again, _, back = describe_planned_motions(engine.case, key, cell.setting()) or ()
    facts = r"the guide moves (\d+) mm, joints turn up to [\d.]+ deg, in .+ s at up to \d+ mm/s; .* clears .*"
    far = re.fullmatch(f"move home to the gauge, {facts}", there)
    home = re.fullmatch(f"move the gauge to home, {facts}", back)
    assert far is not None
    assert home is not None
    assert int(far[1]) >= int(home[1]) > 100
    assert re.fullmatch(f"move onto the gauge again, {facts}", again)
    assert not cell.arm.motions
    assert "surround" not in cell.arm.calls  # what is mounted now is not the guide
    assert cell.operator.asked == []
