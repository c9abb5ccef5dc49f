"""What the steps declare about themselves, checked over all of them."""

from __future__ import annotations

from typing import Any

import pytest
from clinical_case import HOME_RAD, OUTLINE, ClinicalCell
from declaration_checks import reading_too_early, undescribed, without_unit
from generate import list_step_results
from prepared_results import (
    LINK,
    SERIES,
    checked_paths,
    checked_tool,
    correspondence,
    mounted_guide,
    registered_robot,
    relocalization,
    up_to_correspondence,
)
from pydantic import ValidationError
from scanned_head import scanned_spheres

from procedures.calibration import Baseline, Observation, ObservationSet, Outline
from procedures.calibration.arm_model import ArmLooks, SphereLook
from procedures.calibration.frame_calibration import FrameLook, FrameLooks, Use
from procedures.calibration.tip_calibration import BallLook, DivotReading, TipLooks
from procedures.engine.case import StepKey
from procedures.engine.order import Steps, StepSpec
from procedures.guards.stability import SeenUnchanged, Subject
from procedures.journal.results import FramedPose, StepResult, parse_record
from procedures.operator.question import Topic
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.frame_looks import ObservedFrame
from procedures.steps.calibration.head_looks import BallMeasurement, ObservedBall, VisitedBaseline
from procedures.steps.calibration.recipe import Calibrated, Recipe, head_check, head_look, look_in_place
from procedures.steps.calibration.sphere_looks import ObservedSpheres
from procedures.steps.calibration.tip_readings import ObservedStand, TipReadings
from procedures.steps.catalogue import clinical_steps, list_questions
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import ConfirmedTarget, KnownBases
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.target_measurement import MeasuredTarget
from procedures.steps.clinical.work_progress import DepthStop
from procedures.workcell import MountedTool
from ronna_hw.calibration import PoseRecord
from ronna_hw.records import read_record
from ronna_hw.roles import ONE_ARM, TWO_ARMS

BASELINE = Baseline.model_construct(looks=())
BALL_MM = (700.0, 0.0, 300.0)
PROCEDURES: dict[str, Steps] = {
    "case with a scan": clinical_steps(intraoperative=True),
    "case": clinical_steps(measure_targets=True, roles=TWO_ARMS),
    "calibration": Recipe(of=Calibrated.HEAD, looks=60, more=3).steps,
    "calibration at a stated place": Recipe(of=Calibrated.HEAD, looks=60, more=3, ball_mm=BALL_MM).steps,
    "check": head_check(BASELINE, 3),
    "look": head_look(None),
    "look where it stands": look_in_place(),
    "spheres": Recipe(of=Calibrated.ARM, looks=60, more=10).steps,
    "reference frame": Recipe(of=Calibrated.FRAME, looks=20, more=4).steps,
    "tip": Recipe(of=Calibrated.TIP, looks=20, more=4).steps,
    "tip at a stated place": Recipe(of=Calibrated.TIP, looks=20, more=4, ball_mm=BALL_MM).steps,
}
STEPS = {step.result: step for steps in PROCEDURES.values() for step in steps}
RESULTS = list_step_results()


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_a_step_reads_only_results_of_earlier_steps(procedure: str) -> None:
    assert reading_too_early(PROCEDURES[procedure]) == []


def test_every_kind_of_result_has_its_step() -> None:
    assert set(STEPS) == set(RESULTS)


def test_no_two_steps_produce_the_same_kind_of_result() -> None:
    kinds = [model.kind for model in RESULTS]
    assert len(set(kinds)) == len(kinds)


@pytest.mark.hazard(37)
def test_with_an_assistant_the_work_at_a_target_is_declared_to_move_an_arm_but_not_the_master() -> None:
    alone, assisted = (
        next(step for step in clinical_steps(roles=roles) if step.name == "at_target")
        for roles in (ONE_ARM, TWO_ARMS)
    )
    assert not alone.moves_an_arm
    assert assisted.moves_an_arm
    assert not assisted.moves  # after a restart, the guide in front of the head stays there
    asked = {question.topic for question in list_questions(assisted)}
    assert {Topic.APPROACH, Topic.RETREAT, Topic.FIRST_MOTION} <= asked


@pytest.mark.parametrize("step", [step for step in STEPS.values() if step.moves], ids=lambda step: step.name)
def test_a_moving_step_does_not_begin_with_an_unknown_tool(
    cell: ClinicalCell, step: StepSpec[StepResult]
) -> None:
    assert cell.workcell.master.tool is MountedTool.UNKNOWN
    cell.arm.mounted = 0  # and nothing of ours is found when it is read again
    key = StepKey(step.name, "T1")
    assert step.preconditions(cell.begin(step).context(key))


@pytest.mark.parametrize("model", RESULTS, ids=lambda model: model.kind)
def test_every_field_is_described_and_every_quantity_has_its_unit_in_its_name(
    model: type[StepResult],
) -> None:
    assert undescribed(model) == []
    assert without_unit(model) == []


def examples(cell: ClinicalCell) -> list[StepResult]:
    """One result of every step."""
    pose, outline = correspondence().robot_from_ct, Outline.of(OUTLINE)
    flange = PoseRecord(translation_mm=pose.translation_mm, quaternion_wxyz=pose.quaternion_wxyz)
    look = Observation(
        joints_rad=HOME_RAD, robot_from_flange=flange, left=outline, right=outline, orientation=3
    )
    head = cell.calibrations.stereo_head
    observed = ObservationSet(
        created=head.created, serials=("1", "2"), arm_variant="kr6", start=head, observations=(look,)
    )
    measured: dict[str, Any] = {"created": head.created, "arm": cell.arm.kinematics.name, "stereo_head": head}
    sphere = SphereLook(
        sphere=0,
        joints_rad=HOME_RAD,
        flanks=(1, -1, 1, -1, 1, -1),
        point_mm=(0.1, 0.2, 1 / 3),
        covariance_mm2=((1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (0.0, 0.0, 1e-3)),
        validation=True,
    )
    turned = FrameLook(
        use=Use.RETURN, joints_rad=HOME_RAD, robot_from_flange=flange, tracker_from_marker=flange, frames=30
    )
    ball = BallLook(joints_rad=HOME_RAD, robot_from_flange=flange, ball_mm=(0.1, 0.2, 1 / 3))
    divot = DivotReading(look=0, joints_rad=HOME_RAD, robot_from_flange=flange, dials_mm=(0.1, 0.0, 0.0))
    return [
        *up_to_correspondence(cell),
        scanned_spheres(),
        *(checked_paths(cell), relocalization(), registered_robot(), mounted_guide(), checked_tool()),
        MeasuredTarget(
            tool_pose=pose,
            error_mm=0.1,
            ball_tool_mm=(0.1, 0.0, 0.0),
            covariance_mm2=None,
            joints_rad=HOME_RAD,
        ),
        PositionedGuide(tool_pose=FramedPose.of(pose.transform), joints_rad=HOME_RAD),
        ReachedTarget(
            tool_pose=pose,
            nominal_error_mm=0.1 + 0.2,
            too_deep_mm=0.05,
            depth_stop=DepthStop(
                bore_mm=90.0, standoff_mm=25.0, depth_mm=50.0, computed_mm=165.0, read_mm=165.05
            ),
            pushed_mm=0.01,
        ),
        KnownBases(
            robot_from_base=pose,
            robot_from_tracker=pose,
            flange_from_master_frame=pose,
            flange_from_frame=pose,
            by_frames_mm=0.3,
            error_mm=0.09,
            apart_mm=0.1 + 0.2,
            scatter_mm=0.08,
            frame_looks=(12, 12),
            ball_looks=30,
            outliers=1,
            master_errors=(0.1 + 0.2, -1.0),
            assistant_errors=(1 / 3, 0.0),
            assistant_rad=HOME_RAD,
            region_mm=(750.0, 0.0, 480.0),
            first_look=3,
        ),
        Retreated(joints_rad=HOME_RAD, link=LINK),
        ConfirmedTarget(
            seen=(
                SeenUnchanged(subject=Subject.HEAD, moved_mm=0.1 + 0.2, noticeable_mm=1 / 3, differs=True),
                SeenUnchanged(subject=Subject.BASE, moved_mm=None, noticeable_mm=0.5),
                SeenUnchanged.guide(0.01, 0.05),
            ),
            in_doubt=("T1",),
            link=None,
        ),
        BallPlace(ball_mm=(1.0, 2.0, 1 / 3), others_mm=((0.0, 0.0, 0.0),)),
        ObservedBall(observed=observed, remarks=("a remark",)),
        VisitedBaseline(calibration=SERIES, looks=(look,)),
        BallMeasurement(position_mm=None, left=outline, right=None, reason="no sphere"),
        ObservedSpheres(observed=ArmLooks(**measured, serials=("1", "2"), looks=(sphere,)), remarks=()),
        ObservedFrame(
            observed=FrameLooks(**measured, start=cell.calibrations.tracker_frame, looks=(turned,)),
            remarks=("a remark",),
        ),
        ObservedStand(looks=(ball,), remarks=()),
        TipReadings(
            observed=TipLooks(
                **measured,
                start=cell.calibrations.tool_tip,
                looks=(ball,),
                readings=(divot,),
                validation=(0,),
            )
        ),
    ]


def test_every_result_is_read_back_unchanged_and_is_immutable(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    results = examples(cell)
    assert {type(result) for result in results} == set(RESULTS)
    for result in results:
        stored = cell.case.store(StepKey(result.kind), result, ())
        record = read_record(cell.folder / "records" / f"{stored.record.identifier}.json")
        assert parse_record(record, type(result)) == result
        with pytest.raises(ValidationError, match="frozen"):
            setattr(result, next(iter(type(result).model_fields)), None)
