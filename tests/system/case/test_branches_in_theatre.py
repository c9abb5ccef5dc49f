"""A whole case meets a branch, continues as the rehearsal's operator agrees, and states what it left out."""

import json
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from user_commands import Commands

from procedures.guards.errors import PatientMoved
from procedures.journal.journal import JOURNAL_FILE, Line, read_journal
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
LARGEST_ERROR_MM = 1.0


def run(commands: Commands, folder: Path, *case: str) -> dict[str, Any]:
    """The outcome of a whole case."""
    line = ("run", "--sim", *case, "--json", "--out", str(folder))
    ran = commands.run("ronna-procedure", *line, timeout_s=300)
    assert ran.returncode == 0, ran.stderr
    outcome: dict[str, Any] = json.loads(ran.stdout)
    return outcome


def journal(folder: Path, outcome: dict[str, Any]) -> list[Line]:
    return list(read_journal(folder / outcome["run"] / JOURNAL_FILE))


@pytest.mark.hazard(27)
@pytest.mark.branch("SPHERE_FAILED")
def test_a_sphere_under_blood_is_left_out_and_the_case_completes_with_the_others(
    commands: Commands, tmp_path: Path
) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text("when step == relocalization: camera stain marker 2 60 %\n")
    scene = ("--seed", "3", "--scene", "mini", "--markers", "5", "--targets", "1")
    outcome = run(commands, tmp_path, *scene, "--faults", str(faults))
    assert outcome["registration"]["n"] == 4
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    answers = {line.get("topic"): line.get("answer") for line in journal(tmp_path, outcome)}
    assert answers["sphere:T1"] == "leave it out"


@pytest.mark.hazard(28)
@pytest.mark.branch("BEYOND_MARGIN")
def test_a_trajectory_beyond_its_margin_is_left_out_and_the_other_is_completed(
    commands: Commands, tmp_path: Path
) -> None:
    scene = draw_scene("mini", seed=3, targets=2)
    first, other = scene.head.targets
    strict = first.model_copy(update={"margin_mm": 0.1})
    head = scene.head.model_copy(update={"targets": (strict, other)})
    changed = scene.model_copy(update={"head": head})
    content = changed.model_dump(mode="json", by_alias=True, exclude_none=True)
    path = tmp_path / "scene.toml"
    path.write_text(tomli_w.dumps(content))
    outcome = run(commands, tmp_path, "--scene", str(path))
    assert [target["id"] for target in outcome["targets"]] == [other.identifier]
    assert "exceeds the plan's margin" in outcome["left_out"][first.identifier]
    done = {line["step"] for line in journal(tmp_path, outcome) if line["entry"] == "result"}
    assert f"positioning:{first.identifier}" not in done
    report = (tmp_path / outcome["run"] / "report.html").read_text()
    assert f"{first.identifier} was left out" in report


@pytest.mark.hazard(12)
@pytest.mark.branch("REFERENCE_MOVED")
def test_a_head_that_moves_during_the_withdrawal_stops_the_arm_within_twelve_frames(
    commands: Commands, tmp_path: Path
) -> None:
    faults = tmp_path / "faults.txt"
    faults.write_text("when step == retreat: room shift head 0.3 0.4 0 mm\n")
    # In this scene the tracker sees the head on the whole way out; where the guide hides it, it does later.
    case = ("--seed", "5", "--scene", "mini", "--faults", str(faults), "--out", str(tmp_path / "runs"))
    ran = commands.run("ronna-procedure", "run", "--sim", *case, timeout_s=300)
    assert ran.returncode == PatientMoved.exit_code
    assert "PRO-020" in ran.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    lines = list(read_journal(folder / JOURNAL_FILE))
    began_s = next(line["theatre_time_s"] for line in lines if line.get("what") == "withdraw")
    said = [json.loads(line) for line in (folder / EVENTS_FILE).read_text().splitlines()]
    alarm_s = next(
        line["theatre_time_s"] for line in said if "the arm is stopped" in line["what"].get("text", "")
    )
    assert alarm_s - began_s <= 12 / 60
    stopped = next(line for line in lines if line.get("error") == "PRO-020")
    assert stopped["theatre_time_s"] > alarm_s  # on its way: the motion takes 2.5 s
    assert not [line for line in lines if line["entry"] == "result" and line["step"] == "retreat:T1"]
