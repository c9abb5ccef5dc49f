"""A whole case meets a branch, continues as the rehearsal's operator agrees, and states what it left out."""

import json

import pytest
from simulated_case import SimulatedCase

from procedures.guards.errors import PatientMoved
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
LARGEST_ERROR_MM = 1.0


@pytest.mark.hazard(27)
@pytest.mark.branch("SPHERE_FAILED")
def test_a_sphere_under_blood_is_left_out_and_the_case_completes_with_the_others(case: SimulatedCase) -> None:
    scene = ("--seed", "3", "--scene", "mini", "--markers", "5", "--targets", "1")
    ran = case.run(*scene, faults="when step == relocalization: camera stain marker 2 60 %")
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert outcome["registration"]["n"] == 4
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    answers = {line.get("topic"): line.get("answer") for line in case.journal}
    assert answers["sphere:T1"] == "leave it out"


@pytest.mark.hazard(28)
@pytest.mark.branch("BEYOND_MARGIN")
def test_a_trajectory_beyond_its_margin_is_left_out_and_the_other_is_completed(case: SimulatedCase) -> None:
    scene = draw_scene("mini", seed=3, targets=2)
    first, other = scene.head.targets
    strict = first.model_copy(update={"margin_mm": 0.1})
    head = scene.head.model_copy(update={"targets": (strict, other)})
    ran = case.run(scene=scene.model_copy(update={"head": head}))
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert [target["id"] for target in outcome["targets"]] == [other.identifier]
    assert "exceeds the plan's margin" in outcome["left_out"][first.identifier]
    done = {line["step"] for line in case.journal if line["entry"] == "result"}
    assert f"positioning:{first.identifier}" not in done
    report = (case.run_folder / "report.html").read_text()
    assert f"{first.identifier} was left out" in report


@pytest.mark.hazard(12)
@pytest.mark.branch("REFERENCE_MOVED")
def test_a_head_that_moves_during_the_withdrawal_stops_the_arm_within_twelve_frames(
    case: SimulatedCase,
) -> None:
    # In this scene the tracker sees the head on the whole way out; where the guide hides it, it does later.
    shifted = "when step == retreat: room shift head 0.3 0.4 0 mm"
    ran = case.run("--seed", "5", "--scene", "mini", faults=shifted)
    assert ran.returncode == PatientMoved.exit_code
    assert "PRO-020" in ran.stderr
    lines = case.journal
    began_s = next(line["theatre_time_s"] for line in lines if line.get("what") == "withdraw")
    said = [json.loads(line) for line in (case.run_folder / EVENTS_FILE).read_text().splitlines()]
    alarm_s = next(
        line["theatre_time_s"] for line in said if "the arm is stopped" in line["what"].get("text", "")
    )
    assert alarm_s - began_s <= 12 / 60
    stopped = next(line for line in lines if line.get("error") == "PRO-020")
    assert stopped["theatre_time_s"] > alarm_s  # on its way: the motion takes 2.5 s
    assert not [line for line in lines if line["entry"] == "result" and line["step"] == "retreat:T1"]
