"""The case sheet: plan, spheres and limits with their units, and who answers what."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from clinical_case import FIRST, TRAJECTORIES, ClinicalCell
from prepared_results import checked_plan, localized_fiducials
from report_text import report_text
from user_commands import in_this_process, one_error

from procedures.cli.procedure import app
from procedures.operator.question import FOR_A_PERSON, Topic
from procedures.planning.guide import depth_stop_mm
from procedures.planning.plan_model import FiducialKind
from procedures.planning.short_numbers import short_plan_number, short_series_number
from procedures.reporting.case_sheet.answering import SUBJECTS, questions_of_branches, questions_of_course
from procedures.reporting.case_sheet.sheet import SheetTheatre, sheet_of_plan, sheet_of_run
from procedures.steps.branches import (
    BEYOND_MARGIN,
    CART_MOVED,
    MOVED_SPHERE,
    SPHERE_FAILED,
    UNMATCHED_SPHERE,
)
from procedures.steps.catalogue import clinical_steps
from ronna_hw.collision_config import CollisionConfig, HeadZone
from ronna_hw.config import ProcedureSettings
from ronna_hw.roles import ONE_ARM, TWO_ARMS
from ronna_hw.tool_record import GuideBore


def test_the_sheet_of_a_run_has_its_plan_its_spheres_and_the_predicted_limits(
    registered: Path, tmp_path: Path
) -> None:
    sheet = sheet_of_run(registered)
    assert sheet is not None
    assert [one.planned.id for one in sheet.trajectories] == list(TRAJECTORIES)
    assert sheet.trajectories[0].limit_mm is not None
    done = in_this_process(app, "sheet", registered, "--out", tmp_path / "sheet.html")
    text = report_text(Path(done.stdout.strip()))
    for marker in localized_fiducials().markers:
        assert " ".join(f"{value:.1f}" for value in marker.centre_mm) in text
    assert "SIMULATED THEATRE" in text
    assert "accepted error mm" in text


def test_both_pages_carry_the_numbers_of_series_and_plan(registered: Path, tmp_path: Path) -> None:
    sheet = sheet_of_run(registered)
    assert sheet is not None
    text = report_text(sheet.write(tmp_path / "sheet.html"))
    first, second = text.split("Who answers what")
    for number in (
        f"CT series {short_series_number(sheet.plan.series_instance_uid)}",
        f"plan {short_plan_number(sheet.plan)}",
    ):
        assert number in first
        assert number in second


def test_limits_are_those_of_the_theatre_and_depth_stops_those_of_its_guide() -> None:
    plan = checked_plan().plan
    bore = GuideBore(reach_mm=70.0, length_mm=80.0, play_mm=0.02)
    theatre = SheetTheatre(
        cell=CollisionConfig(margin_mm=12.5, live_margin_mm=4.0, zone=HeadZone(near_speed_mm_s=40.0)),
        settings=ProcedureSettings(coarse_fine_limit_mm=2.0, insertion_force_N=9.0),
        arm="ur5",
        bore=bore,
    )
    sheet = sheet_of_plan("sheet", plan, checked_plan().head, (), (), theatre=theatre, roles=TWO_ARMS)
    values = {one.what: one.value for one in sheet.limits}
    assert values["clearance along a planned path, at least"] == "12.5 mm"
    assert values["clearance of the moving arm, at least"] == "4 mm"
    assert values["speed of all that moves, near the head"].startswith("40 mm/s up to 20 mm")
    assert values["force on the instrument"] == "9 N"
    assert values["guide on the gauge, from its record"].startswith("0.1 mm")  # a UR5 repeats less well
    assert sheet.trajectories[0].stop_mm == depth_stop_mm(plan, plan.trajectories[0], bore)
    alone = sheet_of_plan("sheet", plan, checked_plan().head, (), (), theatre=theatre)
    assert "force on the instrument" not in {one.what for one in alone.limits}


@pytest.mark.parametrize(
    ("roles", "fiducials"),
    [(ONE_ARM, FiducialKind.FREE), (TWO_ARMS, FiducialKind.FREE), (ONE_ARM, FiducialKind.MIXED)],
)
def test_every_question_of_the_course_is_worded_and_marked_if_only_a_person_answers(
    roles: tuple[str, ...], fiducials: FiducialKind
) -> None:
    asked = [topic for step in clinical_steps(roles=roles, fiducials=fiducials) for topic in step.asks]
    rows = questions_of_course(roles, fiducials, measure_targets=False, intraoperative=False)
    assert [one.subject for one in rows] == [SUBJECTS[topic] for topic in asked]
    personal = [topic in FOR_A_PERSON or topic is Topic.PATIENT for topic in asked]
    assert [one.is_personal for one in rows] == personal
    assert rows[0].answers == "yes or no"


def test_a_case_with_one_arm_is_not_asked_about_the_bases_of_two() -> None:
    about = "the bases of two arms are older than a fault of one of them"
    assert about not in {one.subject for one in questions_of_branches(ONE_ARM, FiducialKind.FREE)}
    assert about in {one.subject for one in questions_of_branches(TWO_ARMS, FiducialKind.FREE)}


@pytest.mark.parametrize("fiducials", [FiducialKind.SURFACE, FiducialKind.MIXED])
def test_a_case_on_the_skin_is_asked_to_accept_its_registration_and_not_to_leave_out_a_sphere(
    fiducials: FiducialKind,
) -> None:
    rows = questions_of_course(ONE_ARM, fiducials, measure_targets=False, intraoperative=False)
    assert "Register the CT to the robot by the skin, at each target" in {one.step for one in rows}
    branches = {one.subject for one in questions_of_branches(ONE_ARM, fiducials)}
    assert branches >= {BEYOND_MARGIN.event, CART_MOVED.event}
    assert branches.isdisjoint({SPHERE_FAILED.event, MOVED_SPHERE.event, UNMATCHED_SPHERE.event})


def test_the_sheet_says_who_answers_in_this_theatre(registered: Path) -> None:
    sheet = sheet_of_run(registered)
    assert sheet is not None
    assert sheet.answering.startswith("Rehearsal: a script answers")
    real = sheet_of_plan(
        "sheet", sheet.plan, checked_plan().head, (), (), theatre=replace(sheet.theatre, banner="")
    )
    assert real.answering.startswith("Real devices: a person answers")


def test_a_run_without_a_checked_plan_is_refused_with_the_way_to_a_sheet(
    cell: ClinicalCell, tmp_path: Path
) -> None:
    refused = in_this_process(app, "sheet", cell.folder, "--out", tmp_path / "sheet.html")
    message = " ".join(one_error(refused.stderr))
    assert "EXC-003" in message
    assert "ronna-plan sheet PLAN --ct SERIES_DIR" in message
    assert FIRST not in message
