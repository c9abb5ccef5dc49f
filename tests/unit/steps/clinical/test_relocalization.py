"""The spheres are measured one after another, starting from the coarse registration alone."""

from __future__ import annotations

import math
import re
from itertools import count, pairwise

import numpy as np
import pytest
from clinical_case import FIRST, HOME_RAD, ROBOT_FROM_CT, SPHERES_MM, TRAJECTORIES, ClinicalCell, shifted
from coded_errors import raises
from prepared_results import APPROACH_MM, ARRIVING, checked_paths, checked_plan, coarse, localized_fiducials
from recording_cell import RecordingOperator

from procedures.engine.case import Stored
from procedures.journal.errors import GateFailed, StepRefused
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.journal.results import StepResult
from procedures.operator.question import Question, Topic
from procedures.steps.clinical.relocalization import STEP
from procedures.steps.clinical.results import Relocalization
from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.strategies.strategy import APPROACH_RAD
from procedures.workcell import MountedTool
from procedures.workcell.errors import SPHERE_NOT_FOUND
from procedures.workcell.stereo_look import Look
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle


def asked(cell: ClinicalCell) -> list[Question]:
    return [question for question in cell.operator.asked if question.topic is Topic.SPHERE]


COARSE_OFF_MM = (4.0, -3.0, 2.0)


def relocalize(cell: ClinicalCell, **paths: object) -> Stored[Relocalization]:
    return cell.run(*before(cell.carrying(MountedTool.STEREO_HEAD), **paths), STEP)


def before(cell: ClinicalCell, **paths: object) -> tuple[StepResult, ...]:
    return (checked_paths(cell, **paths), *coarse(), checked_plan(), localized_fiducials())


def test_the_offset_of_the_first_sphere_corrects_the_search_for_the_others(cell: ClinicalCell) -> None:
    done = relocalize(cell, robot_from_ct=shifted(ROBOT_FROM_CT, COARSE_OFF_MM)).result
    first, *others = done.residuals_mm
    assert first[0] == pytest.approx(np.linalg.norm(COARSE_OFF_MM))
    assert max(one[0] for one in others) < 1e-3
    assert done.coarse_offset_mm == pytest.approx(np.negative(COARSE_OFF_MM), abs=1e-3)


def test_a_sphere_is_expected_where_the_localization_before_found_it(cell: ClinicalCell) -> None:
    prepared = before(
        cell.carrying(MountedTool.STEREO_HEAD), robot_from_ct=shifted(ROBOT_FROM_CT, COARSE_OFF_MM)
    )
    engine = cell.begin(*prepared, STEP)
    first, second = (key for key in engine.order.sequence if key.name == STEP.name)
    engine.run_to(second)
    assert cell.case.get(Relocalization, first.trajectory).result.residuals_mm[0][0] > 1.0
    done = cell.case.get(Relocalization, second.trajectory).result
    assert max(one[0] for one in done.residuals_mm) < 1e-3
    assert done.coarse_offset_mm == pytest.approx(np.negative(COARSE_OFF_MM), abs=1e-3)


def test_every_measuring_pose_is_approached_in_the_joint_directions_of_the_target(cell: ClinicalCell) -> None:
    relocalize(cell)
    lines = read_journal(cell.folder / JOURNAL_FILE)
    places = [tuple(line["to"]) for line in lines if line.get("what") == "settle"]
    ways = [
        np.subtract(at, back) / APPROACH_RAD
        for (_, back), (_, at) in pairwise(cell.arm.motions)
        if at in places and math.dist(at, back) < 3 * APPROACH_RAD
    ]
    assert len(ways) == len(places) >= len(SPHERES_MM)
    np.testing.assert_allclose(ways, np.tile(ARRIVING, (len(ways), 1)), atol=1e-6)


def test_the_surroundings_are_exact_at_the_spheres_and_not_at_home(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    near: list[object] = []
    monkeypatch.setattr(cell.workcell.master, "surround", lambda _room, near_rad: near.append(near_rad))
    relocalize(cell)
    middle, *others = near
    planned = [one.joints_rad for one in checked_paths(cell).localizations["T1"]]
    assert middle == planned[len(SPHERES_MM) // 2]
    assert others == planned[1:]


def test_from_the_second_sphere_on_the_head_is_where_the_stereo_head_has_seen_it(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    rooms: list[Surroundings] = []
    monkeypatch.setattr(cell.workcell.master, "surround", lambda room, _near_rad: rooms.append(room))
    relocalize(cell, robot_from_ct=shifted(ROBOT_FROM_CT, COARSE_OFF_MM))
    spheres_mm = [
        next(one.capsule.start_mm for one in room.obstacles if one.name == "fiducial 1") for room in rooms
    ]
    seen_mm = np.array(spheres_mm[1:]) - spheres_mm[0]
    np.testing.assert_allclose(seen_mm, [np.negative(COARSE_OFF_MM)] * len(seen_mm), atol=1e-3)


def test_every_sphere_is_measured_in_the_order_of_the_paths_with_a_picture(cell: ClinicalCell) -> None:
    done = relocalize(cell, fiducials=(2, 0, 3, 1)).result
    assert done.fiducials == (2, 0, 3, 1)
    np.testing.assert_allclose(done.points_mm, SPHERES_MM[[2, 0, 3, 1]], atol=1e-6)
    kept = sorted(path.name for path in (cell.folder / "pictures").iterdir())
    assert kept == [f"stereo-{FIRST}-{number}.png" for number in (1, 2, 3, 4)]
    assert cell.arm.calls[:2] == ["surround", "activate"]
    assert cell.stereo.calls == ["activate"]


@pytest.mark.hazard(11)
@pytest.mark.branch("WRONG_SPHERE")
def test_a_sphere_off_its_tracker_position_is_refused_with_its_number_in_the_ct(cell: ClinicalCell) -> None:
    cell.workcell.spheres_mm[0] += (0.0, 0.0, 6.0)
    with pytest.raises(GateFailed, match=r"PRO-007: sphere 1 is not where the tracker saw it"):
        relocalize(cell, fiducials=(3, 2, 1, 0))


@pytest.mark.hazard(11)
@pytest.mark.branch("WRONG_SPHERE")
def test_a_wrong_sphere_does_not_lead_the_head_on_to_the_next_one(cell: ClinicalCell) -> None:
    cell.workcell.spheres_mm[2] += (0.0, 4.4, 0.0)  # 2.9 mm beside the mean of three
    with pytest.raises(GateFailed, match=r"PRO-007: sphere 1 or sphere 3 is not .* limit 3 mm, got 4\.40 mm"):
        relocalize(cell, fiducials=(0, 2, 1))
    assert len(list((cell.folder / "pictures").iterdir())) == 2
    assert stands_off(cell, 2)


@pytest.mark.hazard(11)
@pytest.mark.branch("WRONG_SPHERE")
def test_the_first_sphere_may_be_off_by_what_is_known_of_the_frames(cell: ClinicalCell) -> None:
    relocalize(cell, robot_from_ct=shifted(ROBOT_FROM_CT, (0.0, first_limit_mm(cell) - 0.1, 0.0)))


@pytest.mark.hazard(11)
@pytest.mark.branch("WRONG_SPHERE")
def test_after_a_wrong_first_sphere_nothing_moves(cell: ClinicalCell) -> None:
    with pytest.raises(GateFailed, match="PRO-007: sphere 1 is not where the tracker saw it"):
        relocalize(cell, robot_from_ct=shifted(ROBOT_FROM_CT, (0.0, first_limit_mm(cell) + 0.1, 0.0)))
    assert stands_off(cell, 0)


def first_limit_mm(cell: ClinicalCell) -> float:
    """The limit, and twice four deviations of the tool frame and of the frame on it."""
    return 3.0 + 8.0 * math.hypot(2.0, cell.calibrations.tracker_frame.stated_error_mm)


def stands_off(cell: ClinicalCell, fiducial: int) -> bool:
    """Whether the head is still in front of that sphere, where its measurement ended."""
    away_mm = np.linalg.norm(
        cell.workcell.master.tool_pose().translation_mm - cell.workcell.spheres_mm[fiducial]
    )
    return abs(float(away_mm) - APPROACH_MM) < 0.1


@pytest.mark.branch("UNMEASURED_BESIDE_SKIN")
@pytest.mark.hazard(27)
@pytest.mark.branch("SPHERE_FAILED")
def test_a_missing_sphere_ends_the_step_when_too_few_remain(cell: ClinicalCell) -> None:
    cell.workcell.spheres_mm[1] += (0.0, 0.0, 80.0)
    with raises(SPHERE_NOT_FOUND, match="PRO-008"):
        relocalize(cell)
    assert asked(cell) == []


@pytest.mark.hazard(27)
@pytest.mark.branch("SPHERE_FAILED")
def test_a_missing_sphere_is_left_out_when_enough_remain_and_the_operator_agrees(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.steps.clinical.relocalization.FEWEST_SPHERES", 3)
    cell.workcell.spheres_mm[1] += (0.0, 0.0, 80.0)
    done = relocalize(cell).result
    (question,) = asked(cell)
    assert question.subject == "sphere 2 cannot be measured"
    assert "3 spheres would remain" in question.value
    assert done.fiducials == (0, 2, 3)
    assert [one.fiducial for one in done.left_out] == [1]

    assert "no sphere in 36 image pairs" in done.left_out[0].reason
    kinds = [line["what"] for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == "motion"]
    searched = re.search("s{37,}", "".join(kind[0] for kind in kinds))  # where it should be, and around
    assert searched
    assert kinds[searched.end() :][:2] == ["line", "settle"]  # the head backs off along its axis


@pytest.mark.hazard(27)
@pytest.mark.branch("SPHERE_FAILED")
def test_a_search_passes_over_poses_that_are_not_clear_and_still_names_the_sphere(cell: ClinicalCell) -> None:
    cell.workcell.spheres_mm[1] += (0.0, 0.0, 80.0)
    moves = count(1)
    cell.arm.blocked = lambda _start, _target: next(moves) in (30, 40)
    found = "sphere 2 was not found: no sphere in 34 image pairs, 2 poses not clear"
    with raises(SPHERE_NOT_FOUND, match=f"PRO-008: {found}"):
        relocalize(cell)


def test_a_search_in_which_the_arm_trips_ends_with_that(cell: ClinicalCell) -> None:
    cell.workcell.spheres_mm[1] += (0.0, 0.0, 80.0)
    moves = count(1)

    def trips(_start: object, _target: object) -> bool:
        if next(moves) == 30:
            cell.arm.state = Lifecycle.FAULT
        return cell.arm.state is Lifecycle.FAULT

    cell.arm.blocked = trips
    with pytest.raises(NotClear):
        relocalize(cell)


@pytest.mark.branch("SPHERE_FAILED")
def test_a_missing_sphere_is_not_left_out_without_consent(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.steps.clinical.relocalization.FEWEST_SPHERES", 3)
    cell.operator = RecordingOperator(Topic.SPHERE)
    cell.workcell.spheres_mm[1] += (0.0, 0.0, 80.0)
    with raises(SPHERE_NOT_FOUND):
        relocalize(cell)


@pytest.mark.branch("SPHERE_FAILED")
def test_a_servo_that_does_not_converge_is_treated_like_a_missing_sphere(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.steps.clinical.relocalization.FEWEST_SPHERES", 3)
    see = cell.workcell.look

    def look_at_a_drifting_sphere() -> Look:
        if np.linalg.norm(cell.workcell.master.tool_pose().translation_mm - SPHERES_MM[0]) < 20.0:
            cell.workcell.spheres_mm[0] += (0.0, 0.0, 1.0)
        return see()

    cell.workcell.look = look_at_a_drifting_sphere  # type: ignore[method-assign]
    done = relocalize(cell).result
    assert done.left_out[0].reason.startswith("the residual has not decreased")
    assert done.fiducials == (1, 2, 3)


@pytest.mark.hazard(3)
def test_the_step_is_refused_with_the_guide_mounted(cell: ClinicalCell) -> None:
    steps = before(cell.carrying(MountedTool.STEREO_HEAD))
    cell.carrying(MountedTool.GUIDE)
    with pytest.raises(
        StepRefused,
        match="the arm carries the guide, not the stereo head; with the arm home, run global_localization",
    ):
        cell.run(*steps, STEP)
    assert cell.arm.joints_rad == HOME_RAD


def test_a_strategy_that_localizes_once_measures_for_all_trajectories(cell: ClinicalCell) -> None:
    cell.strategy = NeutralOrientation()
    stored = relocalize(cell)
    assert stored.record.trajectory is None
    assert [str(key) for key in cell.begin(STEP).order.sequence] == ["relocalization"]
    assert len(TRAJECTORIES) == 2
    assert (cell.folder / "pictures" / "stereo-all-1.png").is_file()
