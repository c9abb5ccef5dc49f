"""`ronna-plan place` on a simulated case: a place is proposed, drawn, and stands the path check."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from user_commands import Commands

from ronna_hw.arm.pose import Pose


def _pose_words(pose: Pose) -> list[str]:
    return [f"{value:.6f}" for value in pose.to_kuka()]


@pytest.mark.slow
@pytest.mark.timeout(170)
def test_the_proposed_place_is_drawn_and_stands_the_path_check(commands: Commands, tmp_path: Path) -> None:
    words = ("run", "--sim", "--scene", "mini", "--seed", "3", "--out", str(tmp_path), "--json")
    run = tmp_path / json.loads(commands.run("ronna-procedure", *words).stdout)["run"]
    scene = json.loads((run / "theatre/scene.json").read_text())
    true = scene["head"]["robot_from_ct"]
    assumed = Pose.from_quaternion(tuple(true["translation_mm"]), tuple(true["quaternion_wxyz"]))
    plan = (str(run / "case/plan.toml"), "--ct", str(run / "case/ct"))
    case = (*plan, "--config", str(run / "theatre/theatre.toml"))
    out = tmp_path / "place"
    words = (*case, "--robot-from-ct", *_pose_words(assumed), "--within", "60", "--out", str(out), "--json")
    done = commands.run("ronna-plan", "place", *words)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["assumed_place_serves"] is True
    assert "<svg" in (out / "place.svg").read_text()
    assert json.loads((out / "place.json").read_text())["best_mm"] == found["best_mm"]
    x, y = found["best_mm"]
    there = Pose(
        (assumed.position_mm[0] - x, assumed.position_mm[1] - y, assumed.position_mm[2]), assumed.rotation
    )
    done = commands.run("ronna-plan", "check", *case, "--markers", "--robot-from-ct", *_pose_words(there))
    assert done.returncode == 0, done.stderr
    far = Pose((assumed.position_mm[0] + 800.0, *assumed.position_mm[1:]), assumed.rotation)
    words = (*case, "--robot-from-ct", *_pose_words(far), "--within", "60")
    done = commands.run("ronna-plan", "place", *words)
    assert done.returncode == 3
    assert "PLAN-020" in done.stderr
