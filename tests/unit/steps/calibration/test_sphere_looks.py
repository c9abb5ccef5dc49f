"""An arm is calibrated by the spheres that it can measure; the others are named and left out."""

from pathlib import Path

import numpy as np
import pytest
from clinical_case import ClinicalCell
from coded_errors import raises
from prepared_results import checked_set_up, global_localization
from recording_cell import theatre_of

from procedures.calibration.errors import NO_BALL
from procedures.operator.question import Topic
from procedures.steps.calibration.sphere_looks import ObservedSpheres, looks_step
from procedures.workcell import MountedTool
from ronna_hw.calibration import Numbers3
from sim.world.process import load_scene

NEAR_MM, SECOND_MM = (720.0, -10.0, 310.0), (810.0, -10.0, 310.0)
FAR_MM = (480.0, 300.0, 310.0)
AT_THE_EDGE_MM = (1116.0, -10.0, 310.0)  # of reach: 11 of the 60 poses
OUT_OF_REACH_MM = (870.0, 373.0, 1063.0)  # such as a reflection that the tracker took for a sphere
IDENTIFYING, JUDGING = 60, 12


def observed(cell: ClinicalCell, *spheres_mm: Numbers3, identifying: int = IDENTIFYING) -> ObservedSpheres:
    cell.workcell.spheres_mm = np.array(spheres_mm)
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell.run(
        checked_set_up(cell), global_localization(np.array(spheres_mm)), looks_step(identifying, JUDGING)
    ).result


@pytest.mark.parametrize("others_mm", [(NEAR_MM,), (NEAR_MM, SECOND_MM)])
def test_a_sphere_out_of_reach_is_named_and_the_others_or_a_single_one_are_enough(
    cell: ClinicalCell, others_mm: tuple[Numbers3, ...]
) -> None:
    done = observed(cell, OUT_OF_REACH_MM, *others_mm)
    assert done.remarks == ("the sphere at 870 373 1063 mm was left out: it is out of reach",)
    looks = done.observed.looks
    assert {one.sphere for one in looks} == {*range(len(others_mm))}
    assert done.observed.arm_serial == "1"  # the arm's, so that no other arm gets its record
    judging = sum(one.validation for one in looks)
    assert judging > JUDGING  # more are planned than the judgement needs
    assert len(looks) - judging >= IDENTIFYING


def test_without_a_sphere_within_reach_nothing_moves(cell: ClinicalCell) -> None:
    with raises(NO_BALL, match="no isolated sphere is within reach"):
        observed(cell, OUT_OF_REACH_MM)
    assert cell.arm.motions == []


def test_a_sphere_whose_way_is_not_clear_is_left_out(cell: ClinicalCell) -> None:
    seen = [0]

    def blocked(_start: object, target: object) -> bool:
        seen[0] += 1
        return seen[0] <= 2  # straight and by home, to the first sphere only

    cell.arm.blocked = blocked
    done = observed(cell, NEAR_MM, SECOND_MM)
    (remark,) = done.remarks
    assert "was left out: the way is not clear" in remark
    assert len({one.sphere for one in done.observed.looks}) == 1


def test_a_sphere_without_a_planned_pose_is_named_and_the_arm_does_not_go_there(tmp_path: Path) -> None:
    calibrated = ClinicalCell(tmp_path, theatre=theatre_of(load_scene("mini", seed=3, calibrated=True)))
    done = observed(calibrated, NEAR_MM, SECOND_MM, AT_THE_EDGE_MM, FAR_MM, identifying=0)
    assert done.remarks == (
        "the sphere at 1116 -10 310 mm was left out: none of the planned poses is around it",
    )
    assert len({one.sphere for one in done.observed.looks}) == 3
    (question,) = [one for one in calibrated.operator.asked if one.topic is Topic.CALIBRATION]
    assert question.subject.startswith("The arm will measure 3 spheres")
