"""Worlds drawn at random: what is drawn, and how a case in one is judged."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from sim.world.faults import check_faults, parse_faults
from sim.world.scene.named_scenes import named_scene
from studies.errors import WorldNotRun
from studies.worlds import study as worlds_study
from studies.worlds.study import WorldsStudy
from studies.worlds.verdict import RANKS, Verdict, judge, limits_used_mm
from studies.worlds.world import MOST_BENT_MM, MOST_DEG, MOST_MM, STEPS_S, What, draw_world

LIMITS_MM = {"T1": 0.3, "T2": 0.4}
CHANGE = ("positioning:T1", 1.0)  # begins at 11 s


def journal(*more: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A case of two targets: re-localized at 5 s, T1 approached at 10 s, T2 at 20 s, closed at 30 s."""
    lines = [
        {"entry": "result", "step": "relocalization:T2", "theatre_time_s": 5.0},
        {"entry": "intent", "step": "positioning:T1", "theatre_time_s": 10.0},
        {"entry": "intent", "step": "positioning:T2", "theatre_time_s": 20.0},
        {"entry": "closed", "theatre_time_s": 30.0},
    ]
    return sorted([*lines, *more], key=lambda line: float(line["theatre_time_s"]))


def verdict(
    errors_mm: Mapping[str, float], *more: Mapping[str, Any], change: tuple[str, float] | None = CHANGE
) -> Verdict:
    return judge(journal(*more), errors_mm, LIMITS_MM, trajectories=("T1", "T2"), change=change).verdict


def finding(text: str, at_s: float) -> Mapping[str, Any]:
    return {"entry": "finding", "text": text, "theatre_time_s": at_s}


@pytest.mark.parametrize("scene", ["mini", "default"])
def test_the_same_seed_and_number_draw_the_same_world_whatever_else_is_drawn(scene: str) -> None:
    once = [draw_world(3, number, scene) for number in range(50)]
    assert once == [draw_world(3, number, scene) for number in range(50)]
    assert len({one.scene_seed for one in once}) > 40
    assert once != [draw_world(4, number, scene) for number in range(50)]


@pytest.mark.parametrize("scene", ["mini", "default"])
def test_every_drawn_script_is_valid_in_its_scene(scene: str) -> None:
    drawn = [draw_world(1, number, scene) for number in range(200)]
    for world in drawn:
        assert world.change is not None
        truth = named_scene(scene, seed=0, markers=world.markers, targets=world.targets)
        faults = parse_faults(world.change.script)
        check_faults(faults, truth)
        assert all(one.lasts and one.after_s == pytest.approx(world.change.after_s) for one in faults)
    assert {one.change.what for one in drawn if one.change} == set(What)
    assert {one.change.step.partition(":")[0] for one in drawn if one.change} == set(STEPS_S)
    hidden = sum(bool(one.change and one.change.hidden) for one in drawn)
    assert 0.35 * len(drawn) < hidden < 0.65 * len(drawn)


def test_no_change_is_larger_than_stated() -> None:
    most = {"shift": MOST_MM, "turn": MOST_DEG, "bent": MOST_BENT_MM}
    for number in range(300):
        change = draw_world(2, number).change
        assert change is not None
        for fault in parse_faults(change.script):
            numbers = [float(one) for one in fault.arguments if one[0] in "+-"]
            if fault.kind.name in most:
                assert math.hypot(*numbers) <= most[fault.kind.name] + 0.002


def test_a_quiet_world_has_no_change() -> None:
    assert all(draw_world(0, number, quiet=True).change is None for number in range(20))


def test_an_error_within_its_limit_is_well() -> None:
    assert verdict({"T1": 0.29, "T2": 0.39}) is Verdict.OK


@pytest.mark.parametrize(
    ("error_mm", "expected"), [(0.31, Verdict.SILENT), (0.6, Verdict.SILENT), (0.61, Verdict.SILENT2)]
)
def test_an_error_beyond_its_limit_without_a_finding_is_silent(error_mm: float, expected: Verdict) -> None:
    assert verdict({"T1": error_mm}) is expected


def test_a_finding_that_names_another_target_does_not_warn_of_this_one() -> None:
    assert verdict({"T1": 0.9, "T2": 0.1}, finding("T2 in doubt", 25.0)) is Verdict.SILENT2
    assert verdict({"T1": 0.9, "T2": 0.1}, finding("T1 in doubt", 25.0)) is Verdict.WARNED


def test_a_finding_without_a_name_touches_the_trajectory_of_its_step() -> None:
    assert verdict({"T1": 0.9}, finding("the head moved", 15.0)) is Verdict.WARNED
    assert verdict({"T1": 0.9}, finding("the head moved", 25.0)) is Verdict.SILENT2


def test_a_finding_before_the_change_does_not_warn_of_it() -> None:
    assert verdict({"T1": 0.9}, finding("T1 in doubt", 10.5)) is Verdict.SILENT2


def test_that_the_arm_hides_the_spheres_in_a_pose_warns_of_no_error() -> None:
    hidden = finding("at T1: the tracker sees fewer than three known spheres in this pose", 15.0)
    assert verdict({"T1": 0.9}, hidden) is Verdict.SILENT2
    assert verdict({"T1": 0.1}, hidden, change=None) is Verdict.OK
    assert verdict({"T1": 0.9}, {**hidden, "targets": ["T1"]}) is Verdict.WARNED


def test_superseded_results_warn_only_of_their_own_trajectories() -> None:
    voided = {
        "entry": "voided",
        "step": "cart_lock",
        "supersedes": ["12-positioning-T2"],
        "theatre_time_s": 25.0,
    }
    assert verdict({"T1": 0.9}, voided) is Verdict.SILENT2
    assert verdict({"T1": 0.9}, {**voided, "supersedes": ["10-at_target-T1"]}) is Verdict.WARNED


def test_a_second_target_that_is_refused_does_not_warn_of_the_first() -> None:
    failed = {"entry": "failed", "step": "positioning:T2", "what": "PRO-020", "theatre_time_s": 25.0}
    found = judge(
        journal(failed),
        {"T1": 0.9},
        LIMITS_MM,
        trajectories=("T1", "T2"),
        change=CHANGE,
        done=False,
        error="PRO-020",
    )
    assert found.verdict is Verdict.SILENT2


def test_a_case_that_is_refused_with_small_errors_is_refused() -> None:
    found = judge(
        journal(), {}, LIMITS_MM, trajectories=("T1",), change=CHANGE, done=False, error="PRO-020: moved"
    )
    assert found.verdict is Verdict.REFUSED
    broken = judge(journal(), {}, LIMITS_MM, trajectories=("T1",), change=CHANGE, done=False)
    assert broken.verdict is Verdict.NO_VERDICT


def test_a_quiet_case_with_a_finding_or_an_unusual_question_is_false() -> None:
    asked = {
        "entry": "confirmation",
        "topic": "cart_moved",
        "subject": "the cart moved",
        "theatre_time_s": 8.0,
    }
    usual = {"entry": "confirmation", "topic": "retreat:T1", "subject": "retreat", "theatre_time_s": 15.0}
    assert verdict({"T1": 0.1}, usual, change=None) is Verdict.OK
    assert verdict({"T1": 0.1}, asked, change=None) is Verdict.FALSE_FINDING
    assert verdict({"T1": 0.1}, finding("the head moved", 25.0), change=None) is Verdict.FALSE_FINDING


def test_a_change_that_the_case_did_not_reach_makes_it_a_quiet_one() -> None:
    late = ("positioning:T2", 11.0)
    assert verdict({"T1": 0.1}, change=late) is Verdict.OK
    assert verdict({"T1": 0.1}, finding("the head moved", 25.0), change=late) is Verdict.FALSE_FINDING


def test_the_limit_is_the_one_that_held_when_the_instrument_went_in() -> None:
    predictions = {"11-registration-T1": {"T1": 0.3}, "21-registration-T1": {"T1": 0.5}}
    lines = [
        {"entry": "result", "record": "11-registration-T1"},
        {"entry": "work", "task": "insert", "trajectory": "T1"},
        {"entry": "result", "record": "21-registration-T1"},
    ]
    assert limits_used_mm(lines, predictions) == {"T1": 0.3}


def test_the_goals_are_missed_by_one_gross_error_or_one_false_finding(tmp_path: Path) -> None:
    def sums(*verdicts: Verdict) -> dict[str, dict[str, float]]:
        return {
            f"world {number}": {"verdict": float(RANKS[one]), "happened": 1.0}
            for number, one in enumerate(verdicts)
        }

    study = WorldsStudy(20, 0, tmp_path)
    assert study.missed_goals(sums(*[Verdict.OK] * 19, Verdict.SILENT)) == []
    assert "2 of 20" in study.missed_goals(sums(*[Verdict.OK] * 18, *[Verdict.SILENT] * 2))[0]
    assert "twice" in study.missed_goals(sums(*[Verdict.OK] * 19, Verdict.SILENT2))[0]
    quiet = WorldsStudy(20, 0, tmp_path, quiet=True)
    assert quiet.missed_goals(sums(Verdict.OK)) == []
    assert len(quiet.missed_goals(sums(Verdict.OK, Verdict.FALSE_FINDING))) == 1


def test_a_case_that_never_began_is_an_error_with_its_last_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = subprocess.CompletedProcess([], 2, stdout="", stderr="CLI-001: no such scene")
    monkeypatch.setattr(worlds_study, "finished_command", lambda *_arguments: ended)
    with pytest.raises(WorldNotRun, match=r"STU-015.*no such scene"):
        worlds_study.run_world(draw_world(0, 0), tmp_path / "world")
