"""From the path check to the last retreat, with one localization and with one trajectory left out."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from clinical_case import HOME_RAD, ROBOT_FROM_CT, TRAJECTORIES, ClinicalCell
from prepared_results import (
    checked_plan,
    far_away,
    global_localization,
    imported_ct,
    localized_fiducials,
    plan,
)

from procedures.engine.events import StepState
from procedures.engine.order import StepSpec
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.planning.guide import place_guide
from procedures.planning.motions import RESERVE
from procedures.planning.pose_name import GAUGE, HOME, PoseKind, PoseName
from procedures.steps.catalogue import CLINICAL_STEPS
from procedures.steps.clinical.path_check import CheckedPaths, motions_over_spheres
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.results import RegisteredRobot
from procedures.strategies.catalogue import find_strategy
from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.strategies.trajectory import back_along_axis
from procedures.workcell.arm_history import MotionKind
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.lifecycle import Lifecycle

AT_EACH_TARGET = ("positioning", "at_target", "retreat", "confirmation")
MARGIN_MM = 4.0  # NOS on an uncalibrated arm predicts 2.1 mm
PLAN = plan(margin_mm=MARGIN_MM)
GIVEN = (  # CT and tracker
    imported_ct(),
    localized_fiducials(),
    checked_plan().model_copy(update={"plan": PLAN}),
    global_localization(),
)


def steps(*instead: StepResult) -> tuple[StepSpec[StepResult] | StepResult, ...]:
    """The clinical case, with given results in place of what CT and tracker show."""
    stand_ins = {one.kind: one for one in (*GIVEN, *instead)}
    return tuple(stand_ins.get(step.name, step) for step in CLINICAL_STEPS)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[ClinicalCell, dict[str, str]]:
    """The finished case, and what each step has said of its result."""
    cell = ClinicalCell(tmp_path_factory.mktemp("once"), strategy=NeutralOrientation())
    engine = cell.begin(*steps())
    reader = engine.events.subscribe()
    engine.run_to()
    shown = [one.what for one in reader.read(0.0).events]
    return cell, {one.step: one.summary for one in shown if isinstance(one, StepState) and one.summary}


@pytest.fixture
def once(finished: tuple[ClinicalCell, dict[str, str]]) -> ClinicalCell:
    return finished[0]


def test_the_summary_of_a_step_names_its_figures(finished: tuple[ClinicalCell, dict[str, str]]) -> None:
    said = finished[1]
    assert re.fullmatch(r"\d+ poses in one branch, smallest clearance \d+ mm", said["path_check"])
    assert re.fullmatch(r"\d+ spheres, largest final residual [\d.]+ mm", said["relocalization"])
    assert "predicted target error" in said["registration"]
    words = re.findall(r"\w+", " ".join(said.values()))
    assert not {"look", "looks", "well", "clear", "estimators", "apart"} & set(words)


def motions_in(cell: ClinicalCell) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each motion in the journal, with the step that drove it."""
    step = ""
    for line in read_journal(cell.folder / JOURNAL_FILE):
        step = str(line["step"]) if line["entry"] == "intent" else step
        if line["entry"] == "motion":
            yield step, line


@pytest.mark.hazard(36)
def test_the_first_motion_over_the_spheres_states_every_motion_that_its_yes_covers(
    once: ClinicalCell,
) -> None:
    driven = [str(line["what"]) for step, line in motions_in(once) if step == "relocalization"]
    previewed = motions_over_spheres(once.case.get(CheckedPaths).result.motions, None)
    over = [one for one in previewed if one.kind != RESERVE]
    assert driven[0] == MotionKind.HOME
    assert len(driven) > len(over) > len(TRAJECTORIES)
    asked = next(one for one in once.operator.asked if one.topic is Topic.FIRST_MOTION)
    _, then, closest, speed = asked.value.splitlines()
    assert f"then: {len(over)} motions of this step, the small steps over each sphere, " in then
    assert "; later " in closest
    assert "; later up to " in speed


def test_every_motion_that_is_driven_was_previewed_in_this_order_and_with_this_end(
    once: ClinicalCell,
) -> None:
    """But for small steps; what is approached several times is previewed once. By the coarse registration."""
    paths = once.case.get(CheckedPaths).result
    ends: dict[tuple[str, PoseName], Sequence[float]] = {("move", HOME): HOME_RAD}
    ends["move", GAUGE] = radians6(*once.workcell.tools.guide.gauge.joints_deg)
    for name, spheres in paths.localizations.items():
        poses = {
            PoseName(PoseKind.FIDUCIAL, name, n): (one.tool_pose, one.joints_rad)
            for n, one in enumerate(spheres)
        }
        poses |= {
            PoseName(PoseKind.TARGET, n): (one.tool_pose, one.approach_rad)
            for n, one in paths.targets.items()
        }
        for pose, (held, before_rad) in poses.items():
            before = back_along_axis(held.transform, once.setting().settings.approach_mm)
            ends["move", pose], ends["line", pose] = before_rad, held.translation_mm
            ends["back", pose] = tuple(before.translation_mm.tolist())
    driven = [(line["what"], line["to"]) for _, line in motions_in(once)]
    (_, settled), *driven = [one for one, _ in groupby(driven)]
    assert settled == pytest.approx(HOME_RAD)
    onto_home = [one for one in paths.motions if one.start == one.end == HOME]  # driven with the way there
    rest = iter(driven)
    for motion in (one for one in paths.motions if one not in onto_home and one.kind != RESERVE):
        near = 0.02 if motion.kind == "move" else 1.0
        what, to = next(rest)
        while to != pytest.approx(ends[motion.kind, motion.end], abs=near):
            assert what == MotionKind.STEP, str(motion)
            what, to = next(rest)
    assert {what for what, _ in rest} <= {MotionKind.STEP}


def test_the_spheres_are_measured_and_registered_once_before_the_tool_is_changed(once: ClinicalCell) -> None:
    done = [step for _, step in once.entries("result")]
    assert done[8:] == [
        *("path_check", "relocalization", "registration", "tool_change", "tool_check"),
        *(f"{name}:{one}" for one in TRAJECTORIES for name in AT_EACH_TARGET),
    ]
    assert once.arm.joints_rad == HOME_RAD
    assert once.arm.state is once.stereo.state is Lifecycle.CONFIGURED


def test_the_one_registration_is_the_parent_of_every_positioning(once: ClinicalCell) -> None:
    registered = once.case.get(RegisteredRobot)
    assert tuple(one.target for one in registered.result.predictions) == TRAJECTORIES
    for name in TRAJECTORIES:
        positioned = once.case.get(PositionedGuide, name)
        assert positioned.record.parents[registered.record.identifier] == registered.record.sha256
        held = place_guide(PLAN, PLAN.trajectory(name), once.workcell.tools.guide.bore)
        held_mm = ROBOT_FROM_CT.apply(held.rest_mm)
        assert positioned.result.tool_pose.translation_mm == pytest.approx(held_mm, abs=1e-3)


@pytest.mark.hazard(23)
@pytest.mark.branch("UNREACHABLE")
@pytest.mark.parametrize("strategy", ["nos", pytest.param("jdms", marks=pytest.mark.slow)])
def test_the_other_trajectories_are_completed_when_one_is_out_of_reach(tmp_path: Path, strategy: str) -> None:
    first, *others = PLAN.trajectories
    changed = PLAN.model_copy(update={"trajectories": (far_away(first), *others)})
    cell = ClinicalCell(tmp_path, strategy=find_strategy(strategy))
    engine = cell.begin(*steps(checked_plan().model_copy(update={"plan": changed})))
    engine.run_to()
    assert engine.machine.state == "finished"
    (question,) = (one for one in cell.operator.asked if one.topic is Topic.UNREACHABLE)
    assert question.name == f"reach:{first.id}"
    assert f"{first.id}/" in question.value
    paths = cell.case.get(CheckedPaths).result
    assert list(paths.left_out) == [first.id]
    assert tuple(paths.targets) == tuple(one.id for one in others)
    assert {key.trajectory for key in engine.order.sequence if engine.course.status(key) == "left out"} == {
        first.id
    }
    assert cell.arm.joints_rad == HOME_RAD
