"""`ronna-plan place` on a simulated case: a position is proposed, drawn, and passes the path check."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from user_commands import Commands

from ronna_hw.arm.pose import Pose

# The base stands a metre from the head, whose spheres are 60 mm apart: the tracker's error is magnified.
TRACKED_MM, TRACKED_DEG = 12.0, 0.6


def _pose_words(pose: Pose) -> list[str]:
    return [f"{value:.6f}" for value in pose.to_kuka()]


def _run_beside(commands: Commands, place: Path, push_mm: tuple[float, float], out: Path) -> None:
    """In a case the proposal lies beside the plan: the cart, which nobody pushed, stands that far off."""
    options = ("--sim", "--scene", "mini", "--seed", "3", "--out", str(out))
    stepping = commands.start("ronna-procedure", "step", *options, stdin=subprocess.PIPE)
    assert stepping.stdin is not None
    assert stepping.stdout is not None
    stepping.stdin.write("to head_clamp\n")
    stepping.stdin.flush()
    assert any(line.startswith("done head_clamp") for line in stepping.stdout)
    (run,) = out.iterdir()
    shutil.copy(place, run / "case")
    stepping.communicate("run cart_lock\nquit\n", timeout=60)
    (record,) = (run / "records").glob("*-cart_lock.json")
    locked = json.loads(record.read_text())["payload"]
    assert locked["beside_mm"] == pytest.approx([-way for way in push_mm], abs=TRACKED_MM)
    assert locked["turned_deg"] == pytest.approx(0.0, abs=TRACKED_DEG)


@pytest.mark.slow
@pytest.mark.hazard(49)
@pytest.mark.timeout(170)
def test_the_proposed_position_is_drawn_and_passes_the_path_check(commands: Commands, tmp_path: Path) -> None:
    words = ("run", "--sim", "--scene", "mini", "--seed", "3", "--out", str(tmp_path), "--json")
    run = tmp_path / json.loads(commands.run("ronna-procedure", *words).stdout)["run"]
    scene = json.loads((run / "theatre/scene.json").read_text())
    true = scene["head"]["robot_from_ct"]
    assumed = Pose.from_quaternion(tuple(true["translation_mm"]), tuple(true["quaternion_wxyz"]))
    pose = ("--robot-from-ct-of", str(run / "theatre/scene.json"))
    plan = (str(run / "case/plan.toml"), "--ct", str(run / "case/ct"))
    case = (*plan, "--config", str(run / "theatre/theatre.toml"))
    out = tmp_path / "place"
    words = (*case, *pose, "--within", "60", "--out", str(out), "--json")
    done = commands.run("ronna-plan", "place", *words)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["assumed_place_serves"] is True
    assert found["assumed_robot_from_ct"] == pytest.approx(list(assumed.to_kuka()), abs=1e-6)
    assert found["sight"] == "not judged"
    assert "sight not judged" in done.stderr
    assert "<svg" in (out / "place.svg").read_text()
    assert json.loads((out / "place.json").read_text())["best_mm"] == found["best_mm"]
    x, y = found["best_mm"]
    there = Pose(
        (assumed.position_mm[0] - x, assumed.position_mm[1] - y, assumed.position_mm[2]), assumed.rotation
    )
    done = commands.run("ronna-plan", "check", *case, "--markers", "--robot-from-ct", *_pose_words(there))
    assert done.returncode == 0, done.stderr
    _run_beside(commands, out / "place.json", (x, y), tmp_path / "case")
    far = Pose((assumed.position_mm[0] + 800.0, *assumed.position_mm[1:]), assumed.rotation)
    words = (*case, "--robot-from-ct", *_pose_words(far), "--within", "60")
    done = commands.run("ronna-plan", "place", *words)
    assert done.returncode == 3
    assert "PLAN-020" in done.stderr
