"""Hazards 12, 13, 46, 64: changes that the looks at home hardly show, and the target feels most.

A cart turned about the frame on its arm, or a head about the middle of its spheres: what the tracker sees
stays almost where it was. Each case must be refused, end in doubt, or be as near as it states.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from kills import killed_at
from running_case import RunningCase
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal
from ronna_hw.errors import EXIT_RECOVERY_NEEDED, EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.roles import ASSISTANT
from sim.world.saved_world import WORLD_FILE
from studies.worlds.finished_case import FINISHED, IN_DOUBT, read_predictions
from studies.worlds.verdict import limits_used_mm

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]

LIMIT_S = 900.0
MINI_3 = ("--scene", "mini", "--seed", "3")
CALIBRATED = ("--scene", "mini", "--seed", "21", "--calibrated", "--strategy", "best", "--markers", "8")
OTHER_ARMS = ((), ("--arm", "ur5e"), ("--dual", "--calibrated"))

# About the frame on the arm at home, which stays within a hundredth of a millimetre.
TURNED_CART = ("room turn cart 0 0.17 0 deg", "room shift cart -2.0743 0 1.8232 mm")
TURNED_WHILE_DEAD = ("room turn cart 0 0.42 0 deg", "room shift cart -5.1118 0 4.5159 mm")
HEAD_45 = ("room turn head 0.2761 -0.5600 0.1525 deg", "room shift head 0.8976 0.2912 -0.5557 mm")
HEAD_49 = ("room turn head 0.4586 -0.2283 -0.2631 deg", "room shift head 0.4920 0.8120 0.1530 mm")
GUIDE = (("room turn guide 0 0.42 0 deg for 8 s",), ("room push guide 60 0 0 N",))

# Seed 0 with two arms: each move turns the assistant's cart about its frame as that is by then.
DUAL_0 = ("--scene", "mini", "--seed", "0", "--dual")
BEGINS_TO_INSERT = {"entry": Entry.MOTION, "arm": ASSISTANT, "what": "insert"}
IS_AT_DEPTH = {"entry": Entry.WORK, "task": "seated"}
ASSISTANT_TURNED = (
    pytest.param(
        BEGINS_TO_INSERT, 10.0, "room move cart 2 -0.874 -17.453 0 mm 2 deg in 0.1 s", id="on the way in"
    ),
    pytest.param(IS_AT_DEPTH, 0.1, "room move cart 2 -0.928 -17.959 0 mm 2 deg in 0.1 s", id="at depth"),
)
ALONG_THE_BORE = ("insert", "withdraw")


def since(moment: str, lines: Sequence[str]) -> str:
    """Fault script of changes that begin together."""
    return "".join(f"since step == {moment}: {line}\n" for line in lines)


def run_case(
    commands: Commands, folder: Path, options: Sequence[str], script: str
) -> subprocess.CompletedProcess[str]:
    faults = folder / "faults.txt"
    faults.write_text(script)
    words = ("run", "--sim", *options, "--faults", str(faults), "--out", str(folder / "runs"), "--json")
    return commands.run("ronna-procedure", *words, timeout_s=LIMIT_S)


def assert_no_target_is_silently_off(ended: subprocess.CompletedProcess[str], runs: Path) -> None:
    """Refused by the procedure, in doubt, or each error within the 95 % limit as stated at the insertion."""
    outcome: dict[str, Any] = json.loads(ended.stdout)
    if outcome["outcome"] == IN_DOUBT:
        return
    if outcome["outcome"] not in FINISHED:
        assert ended.returncode in (EXIT_REFUSED, EXIT_SAFETY_STOP, EXIT_RECOVERY_NEEDED), ended.stderr
        return
    run = runs / outcome["run"]
    limits_mm = limits_used_mm(read_journal(run / JOURNAL_FILE), read_predictions(run))
    errors_mm = {one["id"]: one["application_error_mm"] for one in outcome["targets"]}
    assert errors_mm
    beyond = {name: (error, limits_mm[name]) for name, error in errors_mm.items() if error > limits_mm[name]}
    assert beyond == {}, f"(error, limit) in mm of {outcome['run']}"


@pytest.mark.hazard(13)
@pytest.mark.parametrize("options", [MINI_3, CALIBRATED], ids=["seed 3", "seed 21, calibrated"])
def test_a_cart_turned_about_the_frame_on_its_arm_is_never_silent(
    commands: Commands, tmp_path: Path, options: tuple[str, ...]
) -> None:
    ended = run_case(commands, tmp_path, options, since("tool_check", TURNED_CART))
    assert_no_target_is_silently_off(ended, tmp_path / "runs")


@pytest.mark.hazard(46)
@pytest.mark.parametrize("arms", OTHER_ARMS, ids=["kr6", "ur5e", "dual"])
@pytest.mark.parametrize("lines", GUIDE, ids=["turned", "pushed"])
def test_a_guide_turned_or_pushed_on_its_way_to_the_target_is_never_silent(
    commands: Commands, tmp_path: Path, lines: tuple[str, ...], arms: tuple[str, ...]
) -> None:
    ended = run_case(commands, tmp_path, (*MINI_3, *arms), since("positioning:T1 after 3.5 s", lines))
    assert_no_target_is_silently_off(ended, tmp_path / "runs")


@pytest.mark.hazard(2)
@pytest.mark.hazard(13)
def test_a_cart_turned_about_the_frame_while_the_program_was_dead_is_never_silent(
    commands: Commands, tmp_path: Path
) -> None:
    case = ("run", "--sim", *MINI_3, "--json")
    killed = killed_at(commands, case, tmp_path, '"step":"positioning:T1"')  # the guide was checked
    world = killed.folder / "theatre" / WORLD_FILE
    saved = json.loads(world.read_text())
    moved = [f"at 0 s: {line}" for line in TURNED_WHILE_DEAD]
    saved["standing_faults"] = "\n".join(filter(None, [saved["standing_faults"], *moved]))
    world.write_text(json.dumps(saved))
    ended = commands.run(
        "ronna-procedure", "resume", str(killed.folder), "--accept", "--json", timeout_s=LIMIT_S
    )
    assert_no_target_is_silently_off(ended, tmp_path)


@pytest.mark.hazard(12)
@pytest.mark.parametrize(("seed", "lines"), [(45, HEAD_45), (49, HEAD_49)])
def test_a_head_turned_about_its_spheres_is_never_silent(
    commands: Commands, tmp_path: Path, seed: int, lines: tuple[str, ...]
) -> None:
    options = ("--scene", "mini", "--seed", str(seed), "--markers", "3")
    ended = run_case(commands, tmp_path, options, since("tool_check", lines))
    assert_no_target_is_silently_off(ended, tmp_path / "runs")


@pytest.mark.hazard(64)
@pytest.mark.parametrize(("reached", "after_s", "change"), ASSISTANT_TURNED)
def test_no_arm_moves_along_the_bore_once_the_assistants_cart_is_turned_about_its_frame(
    commands: Commands, tmp_path: Path, reached: Mapping[str, str], after_s: float, change: str
) -> None:
    case = RunningCase(commands, DUAL_0, tmp_path / "runs")
    line = case.await_line(lambda line: reached.items() <= line.items())
    changed_s = theatre_s(line) + after_s
    assert case.inject(f"at {changed_s:.3f} s: {change}")
    case.end()
    assert case.process.returncode in (EXIT_REFUSED, EXIT_SAFETY_STOP)
    assert moves_after(case.folder, changed_s) == []
    commands.run("ronna-procedure", "resume", str(case.folder), "--accept", timeout_s=LIMIT_S)
    assert moves_after(case.folder, changed_s) == []


def moves_after(run: Path, changed_s: float) -> list[tuple[object, object]]:
    """Motions along the bore that begin later than the change, or arrive in spite of it."""
    later = [one for one in read_journal(run / JOURNAL_FILE) if theatre_s(one) > changed_s]
    begun = [one for one in later if one["entry"] == Entry.MOTION and one["what"] in ALONG_THE_BORE]
    seated = [one for one in later if IS_AT_DEPTH.items() <= one.items()]
    return [(one.get("arm"), one.get("what", one.get("task"))) for one in (*begun, *seated)]


def theatre_s(line: Line) -> float:
    return float(str(line["theatre_time_s"]))
