"""Worlds drawn at random: what is drawn, and how a case in one is judged."""

from __future__ import annotations

import math
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises

from sim.world.faults import check_faults, parse_faults
from sim.world.scene.named_scenes import draw_scene
from studies.errors import WORLD_NOT_RUN
from studies.worlds import study as worlds_study
from studies.worlds.study import WorldsStudy
from studies.worlds.verdict import RANKS, WorldVerdict, judge, limits_used_mm
from studies.worlds.world import MOST_BENT_MM, MOST_DEG, MOST_MM, STEPS_S, ChangedObject, draw_world

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
    errors_mm: Mapping[str, float],
    *more: Mapping[str, Any],
    change: tuple[str, float] | None = CHANGE,
    **ended: Any,
) -> WorldVerdict:
    lines, trajectories = journal(*more), ("T1", "T2")
    return judge(lines, errors_mm, LIMITS_MM, trajectories=trajectories, change=change, **ended).verdict


def finding(text: str, at_s: float) -> Mapping[str, Any]:
    return {"entry": "finding", "text": text, "theatre_time_s": at_s}


@pytest.mark.parametrize("scene", ["mini", "default"])
def test_the_same_seed_and_number_draw_the_same_world_whatever_else_is_drawn(scene: str) -> None:
    once = [draw_world(3, number, scene) for number in range(50)]
    assert once == [draw_world(3, number, scene) for number in range(50)]
    assert len({one.scene_seed for one in once}) > 40
    assert once != [draw_world(4, number, scene) for number in range(50)]


built = cache(draw_scene)


@pytest.mark.parametrize("scene", ["mini", pytest.param("default", marks=pytest.mark.slow)])
def test_every_drawn_script_is_valid_in_its_scene(scene: str) -> None:
    drawn = [draw_world(1, number, scene) for number in range(200)]
    for world in drawn:
        assert world.change is not None
        truth = built(scene, seed=0, markers=world.markers, targets=world.targets)
        faults = parse_faults(world.change.script)
        check_faults(faults, truth)
        assert all(one.lasts and one.after_s == pytest.approx(world.change.after_s) for one in faults)
    assert {one.change.what for one in drawn if one.change} == set(ChangedObject)
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


HIDDEN = finding("at T1: the tracker sees fewer than three known spheres in this pose", 15.0)
VOIDED = {"entry": "voided", "step": "cart_lock", "supersedes": ["12-positioning-T2"], "theatre_time_s": 25.0}


@pytest.mark.parametrize(
    ("errors_mm", "line", "expected"),
    [
        ({"T1": 0.29, "T2": 0.39}, None, WorldVerdict.OK),
        ({"T1": 0.31}, None, WorldVerdict.SILENT),
        ({"T1": 0.6}, None, WorldVerdict.SILENT),
        ({"T1": 0.61}, None, WorldVerdict.SILENT2),
        ({"T1": 0.9, "T2": 0.1}, finding("T2 in doubt", 25.0), WorldVerdict.SILENT2),
        ({"T1": 0.9, "T2": 0.1}, finding("T1 in doubt", 25.0), WorldVerdict.WARNED),
        ({"T1": 0.9}, finding("the head moved", 15.0), WorldVerdict.WARNED),  # by the step, which is at T1
        ({"T1": 0.9}, finding("the head moved", 25.0), WorldVerdict.SILENT2),
        ({"T1": 0.9}, finding("T1 in doubt", 10.5), WorldVerdict.SILENT2),  # before the change
        ({"T1": 0.9}, HIDDEN, WorldVerdict.SILENT2),
        ({"T1": 0.9}, {**HIDDEN, "targets": ["T1"]}, WorldVerdict.WARNED),
        ({"T1": 0.9}, VOIDED, WorldVerdict.SILENT2),
        ({"T1": 0.9}, {**VOIDED, "supersedes": ["10-at_target-T1"]}, WorldVerdict.WARNED),
    ],
)
def test_an_error_beyond_its_limit_is_silent_unless_a_later_entry_names_its_target_or_step(
    errors_mm: Mapping[str, float], line: Mapping[str, Any] | None, expected: WorldVerdict
) -> None:
    assert verdict(errors_mm, *([] if line is None else [line])) is expected


def test_a_second_target_that_is_refused_does_not_warn_of_the_first() -> None:
    failed = {"entry": "failed", "step": "positioning:T2", "what": "PRO-020", "theatre_time_s": 25.0}
    assert verdict({"T1": 0.9}, failed, done=False, error="PRO-020") is WorldVerdict.SILENT2


def test_a_case_that_is_refused_with_small_errors_is_refused() -> None:
    assert verdict({}, done=False, error="PRO-020: moved") is WorldVerdict.REFUSED
    assert verdict({}, done=False) is WorldVerdict.NO_VERDICT


LATE = ("positioning:T2", 11.0)  # which the case does not reach, so that it is a quiet one
USUAL = {"entry": "confirmation", "topic": "retreat:T1", "subject": "retreat", "theatre_time_s": 15.0}
ASKED = {"entry": "confirmation", "topic": "cart_moved", "subject": "it moved", "theatre_time_s": 8.0}


@pytest.mark.parametrize("change", [None, LATE])
@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (USUAL, WorldVerdict.OK),
        (HIDDEN, WorldVerdict.OK),
        (ASKED, WorldVerdict.FALSE_FINDING),
        (finding("the head moved", 25.0), WorldVerdict.FALSE_FINDING),
    ],
)
def test_a_quiet_case_with_a_finding_or_an_unusual_question_is_false(
    change: tuple[str, float] | None, line: Mapping[str, Any], expected: WorldVerdict
) -> None:
    assert verdict({"T1": 0.1}, line, change=change) is expected


def test_the_limit_is_the_one_that_held_when_the_instrument_went_in() -> None:
    predictions = {"11-registration-T1": {"T1": 0.3}, "21-registration-T1": {"T1": 0.5}}
    lines = [
        {"entry": "result", "record": "11-registration-T1"},
        {"entry": "work", "task": "insert", "trajectory": "T1"},
        {"entry": "result", "record": "21-registration-T1"},
    ]
    assert limits_used_mm(lines, predictions) == {"T1": 0.3}


def test_the_goals_are_missed_by_one_gross_error_or_one_false_finding(tmp_path: Path) -> None:
    def sums(*verdicts: WorldVerdict) -> dict[str, dict[str, float]]:
        return {
            f"world {number}": {"verdict": float(RANKS[one]), "happened": 1.0}
            for number, one in enumerate(verdicts)
        }

    study = WorldsStudy(20, 0, tmp_path)
    assert study.list_missed_goals(sums(*[WorldVerdict.OK] * 19, WorldVerdict.SILENT)) == []
    assert "2 of 20" in study.list_missed_goals(sums(*[WorldVerdict.OK] * 18, *[WorldVerdict.SILENT] * 2))[0]
    assert "twice" in study.list_missed_goals(sums(*[WorldVerdict.OK] * 19, WorldVerdict.SILENT2))[0]
    quiet = WorldsStudy(20, 0, tmp_path, quiet=True)
    assert quiet.list_missed_goals(sums(WorldVerdict.OK)) == []
    assert len(quiet.list_missed_goals(sums(WorldVerdict.OK, WorldVerdict.FALSE_FINDING))) == 1


def test_a_case_that_never_began_is_an_error_with_its_last_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = subprocess.CompletedProcess([], 2, stdout="", stderr="CLI-001: no such scene")
    monkeypatch.setattr(worlds_study, "run_command", lambda *_arguments: ended)
    with raises(WORLD_NOT_RUN, match=r"STU-015.*no such scene"):
        worlds_study.run_world(draw_world(0, 0), tmp_path / "world")
