"""Whole cases with the patient's frame on the head clamp."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import tomli_w
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, read_journal
from sim.world.scene.named_scenes import add_patient_frame, draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
LIMIT_MM = 1.0  # of the one target: the mini scene's CT is coarse
DRAPED = "".join(f"since step == tool_change: tracker occlude marker {number}\n" for number in (1, 2, 3))
PUSHES = (
    "since step == global_localization after 0.5 s: room shift tracker 12 -8 5 mm\n"
    "since step == tool_change: room shift tracker -20 4 9 mm\n"
)
PUSHED_AT_TARGET = "since step == at_target after 2.2 s: room shift tracker 12 -8 5 mm\n"
MOVED_HEAD = "since step == at_target: room shift head 1 0.5 0 mm\n"
SLIPPED = "since step == tool_change: tracker move tool patient_frame 0.6 0 0 mm\n"


def run(commands: Commands, folder: Path, faults: str) -> tuple[int, dict[str, object], str, list[str]]:
    """Run a case; return its exit code, outcome, last words, and what the journal found or voided."""
    content = add_patient_frame(draw_scene("mini", seed=0)).model_dump(
        mode="json", by_alias=True, exclude_none=True
    )
    (folder / "scene.toml").write_text(tomli_w.dumps(content))
    (folder / "faults.txt").write_text(faults)
    options = ("--scene", str(folder / "scene.toml"), "--faults", str(folder / "faults.txt"))
    ran = commands.run(
        "ronna-procedure", "run", "--sim", *options, "--out", str(folder / "runs"), "--json", timeout_s=200
    )
    (journal,) = (folder / "runs").glob(f"*/{JOURNAL_FILE}")
    lines = [line for line in read_journal(journal) if line["entry"] in ("finding", "voided")]
    told = [str(line.get("text") or line.get("what")) for line in lines]
    return ran.returncode, json.loads(ran.stdout or "{}"), ran.stderr, told


def test_pushes_against_the_tracker_and_a_drape_over_the_head_change_no_target_and_the_head_is_in_doubt(
    commands: Commands, tmp_path: Path
) -> None:
    code, outcome, said, told = run(commands, tmp_path, DRAPED + PUSHES)
    assert code == 3, said  # nobody has seen that the head did not slip in its clamp
    assert outcome["outcome"] == "in doubt"
    assert any("may have slipped in the clamp" in one for one in told)
    assert float(str(outcome["max_application_error_mm"])) < LIMIT_MM
    assert any("the tracker was moved" in one and "the case goes on" in one for one in told)
    assert any("the spheres on the head are hidden" in one for one in told)


@pytest.mark.soak  # the rule is tried on readings in tests/unit/guards and tests/hazards
def test_a_push_while_work_goes_on_at_the_target_is_no_push_of_the_guide(
    commands: Commands, tmp_path: Path
) -> None:
    code, outcome, said, told = run(commands, tmp_path, PUSHED_AT_TARGET)
    assert code == 0, said
    assert float(str(outcome["max_application_error_mm"])) < LIMIT_MM
    assert any("the tracker was moved" in one and "the case goes on" in one for one in told)
    assert not any("the guide was pushed" in one for one in told)


def test_a_head_that_moves_under_the_drape_stops_the_case(commands: Commands, tmp_path: Path) -> None:
    code, _, said, told = run(commands, tmp_path, DRAPED + MOVED_HEAD)
    assert code != 0
    assert "PRO-020: the head clamp has moved" in said
    assert any("PRO-020" in one for one in told)


@pytest.mark.soak  # the rule is tried on readings in tests/unit/guards and tests/hazards
def test_a_frame_that_slips_on_its_clamp_stops_the_case(commands: Commands, tmp_path: Path) -> None:
    code, _, said, _ = run(commands, tmp_path, SLIPPED)
    assert code != 0
    assert "PRO-051: the patient's frame has moved on the head clamp" in said
    assert "run global_localization" in said
