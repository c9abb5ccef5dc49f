"""Worlds in which a change is drawn as the looks show least and the target feels most, and their verdicts."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arrays import Array
from ronna_hw.errors import EXIT_REFUSED, EXIT_USAGE
from sim.world.displacements import ShiftedRoom, rigid_move
from sim.world.faults import check_faults, parse_faults
from sim.world.process import load_scene
from sim.world.rigid import apply, inverse
from sim.world.scene.model import Scene
from sim.world.truth import TrueGuide
from sim.world.world import ArmState, World
from studies.worlds import adversarial, adversary
from studies.worlds.adversary import (
    LEAST_EFFECT_MM,
    MOST_EFFECT_MM,
    MOST_SIGMAS,
    AdversarialWorld,
    draw_adversarial_world,
)
from studies.worlds.looks import FRAME_MM, Looks, MovedBody, find_hidden_moves
from studies.worlds.silence import CaseEnding, Silence, judge_case
from studies.worlds.world import MINI

CASES = 90


@cache
def drawn() -> list[AdversarialWorld]:
    return [draw_adversarial_world(1, number) for number in range(CASES)]


@cache
def looks_of(scene: str = MINI, seed: int = 3, *, dual: bool = False) -> Looks:
    return Looks(load_scene(scene, seed=seed, dual=dual), 0)


def truth_of(world: AdversarialWorld) -> Scene:
    on_frame = world.fiducials is adversary.Carrier.XFRAME
    return load_scene(
        world.scene,
        seed=world.scene_seed,
        markers=None if on_frame else world.markers,
        targets=world.targets,
        fiducials=world.fiducials,
        arm=world.arm,
        calibrated=world.calibrated,
        dual=world.assistant_arm is not None,
        assistant_arm=world.assistant_arm or ArmChoice.KR6,
    )


def test_the_same_seed_and_number_draw_the_same_world() -> None:
    assert drawn()[:4] == [draw_adversarial_world(1, number) for number in range(4)]
    assert drawn()[0] != draw_adversarial_world(2, 0)
    assert [one.scene for one in drawn()[:6]] == 2 * ["mini", "mini", "default"]


def test_every_drawn_change_is_a_script_for_its_scene_within_the_stated_sizes() -> None:
    for world in drawn():
        change = world.change
        check_faults(parse_faults(change.script), truth_of(world))
        if change.bodies == ("tracker",):
            assert change.effect_mm == 0.0
            continue
        assert change.effect_mm * 1.000001 >= LEAST_EFFECT_MM
        assert change.effect_mm <= MOST_EFFECT_MM
        assert change.sigmas <= MOST_SIGMAS or change.effect_mm == pytest.approx(LEAST_EFFECT_MM)
    assert {body for one in drawn() for body in one.change.bodies} == {body.value for body in MovedBody}
    killed = sum(one.killed_after_s is not None for one in drawn())
    assert 0.1 * CASES < killed < 0.4 * CASES


@pytest.mark.parametrize("dual", [False, True])
@pytest.mark.parametrize(
    "bodies", [(MovedBody.HEAD,), (MovedBody.CART,), (MovedBody.SEAT,), (MovedBody.HEAD, MovedBody.CART)]
)
def test_no_move_of_a_body_is_felt_more_for_what_the_looks_show_than_the_worst(
    bodies: tuple[MovedBody, ...], dual: bool
) -> None:
    looks = looks_of(dual=dual)
    worst = find_hidden_moves(looks, bodies)[0]
    draws = np.random.default_rng(0)
    for _ in range(200):
        twists = draws.standard_normal((len(bodies), 6))
        pairs = list(zip(bodies, twists, strict=True))
        felt_mm = np.linalg.norm(sum(looks.feeling(body) @ twist for body, twist in pairs))
        sigmas = sum(twist @ looks.information(body) @ twist for body, twist in pairs) ** 0.5
        assert felt_mm / sigmas <= worst.effect_mm * (1.0 + 1e-9)


def test_the_worst_move_of_a_cart_leaves_the_frame_on_its_arm_and_displaces_the_target() -> None:
    looks = looks_of()
    move = find_hidden_moves(looks, (MovedBody.CART,))[0]
    moved = looks.displacement(MovedBody.CART, move.twist_mm)
    frame_mm = looks.home_frame_mm.mean(axis=0)
    assert np.linalg.norm(apply(moved, frame_mm) - frame_mm) < FRAME_MM
    felt_mm = np.linalg.norm(apply(moved, looks.target_mm) - looks.target_mm)
    assert felt_mm == pytest.approx(move.effect_mm, rel=1e-3)
    assert felt_mm > 5.0 * FRAME_MM


def test_a_tracker_that_may_have_moved_hides_more() -> None:
    looks = looks_of()
    for body in (MovedBody.HEAD, MovedBody.CART):
        hidden = looks.information(body) - looks.shared_information(body)
        assert np.linalg.eigvalsh(hidden).min() > -1e-6 * np.abs(hidden).max()
    alone, covered = (
        find_hidden_moves(looks, bodies)[0].effect_mm
        for bodies in ((MovedBody.HEAD,), (MovedBody.HEAD, MovedBody.TRACKER))
    )
    assert covered > 2.0 * alone


@pytest.mark.parametrize("body", [MovedBody.HEAD, MovedBody.CART, MovedBody.SEAT, MovedBody.GUIDE])
def test_the_lines_of_a_script_move_the_guide_against_the_target_as_drawn(body: MovedBody) -> None:
    looks = looks_of()
    move = find_hidden_moves(looks, (body,))[0]
    displacement = looks.displacement(body, 5.0 * move.twist_mm)
    world = World.create(looks.scene, paced=False)
    flange = looks.mount_frame @ inverse(looks.flange_from_marker)
    world.publish_arm(ArmState((0.0,) * 6, flange, 1, True))
    guide, room = TrueGuide(world), ShiftedRoom(world)

    def in_guide_mm() -> Array:
        now = room.now()
        target_mm = apply(rigid_move(now.head_rad, now.head_mm), looks.target_mm)
        return apply(inverse(guide.tip_frame()), target_mm)

    before_mm = in_guide_mm()
    lines = adversary.format_lines(looks, body, displacement, "")
    world.set_fault_script("".join(f"at 0 s: {one}\n" for one in lines))
    assert np.linalg.norm(in_guide_mm() - before_mm) == pytest.approx(5.0 * move.effect_mm, rel=0.01)


JOURNAL = (
    {"entry": "intent", "step": "positioning:T1", "theatre_time_s": 10.0},
    {"entry": "result", "record": "11-registration-T1", "theatre_time_s": 11.0},
    {"entry": "work", "task": "seated", "trajectory": "T1", "theatre_time_s": 12.0},
    {"entry": "closed", "theatre_time_s": 20.0},
)
FINDING = {"entry": "finding", "text": "T1: the guide was pushed", "theatre_time_s": 13.0}
EARLIER = {**FINDING, "theatre_time_s": 10.4}  # than the change
USUAL = {
    "entry": "finding",
    "text": "over T1, by the tracker: the instrument is seen 0.05 mm beside the bore, within 0.23 mm",
    "theatre_time_s": 13.0,
}
RESTART = {
    "entry": "voided",
    "what": "PRO-027: the mounted tool may have been touched: the program was not running",
    "supersedes": ["15-positioning-T1"],
    "theatre_time_s": 13.0,
}
DIVERGED = {"outcome": "failed", "error": {"code": "STE-007", "what": "the residual has not decreased"}}
MOVED_AT_T1 = {"outcome": "failed", "error": {"code": "PRO-032", "what": "the cart was moved, at T1"}}
OUT_OF_REACH = {"outcome": "failed", "error": {"code": "PLAN-007", "what": "out of reach"}}
BOUND = {"outcome": "failed", "error": {"code": "CTL-002", "what": "SIM-015: it binds"}}
RMS_MM, LIMIT_MM = 0.3, 0.5


@pytest.mark.parametrize(
    ("error_mm", "line", "printed", "exit_code", "expected"),
    [
        (0.4, None, {"outcome": "done"}, 0, (Silence.OK, CaseEnding.DONE)),
        (0.55, None, {"outcome": "done"}, 0, (Silence.BEYOND, CaseEnding.DONE)),
        (0.61, None, {"outcome": "done"}, 0, (Silence.SILENT, CaseEnding.DONE)),
        (0.61, USUAL, {"outcome": "done"}, 0, (Silence.SILENT, CaseEnding.DONE)),
        (0.61, RESTART, {"outcome": "done"}, 0, (Silence.SILENT, CaseEnding.DONE)),
        (None, None, OUT_OF_REACH, EXIT_REFUSED, (Silence.NOT_POSSIBLE, CaseEnding.NOT_POSSIBLE)),
        (0.61, FINDING, {"outcome": "done"}, 0, (Silence.TOLD, CaseEnding.DONE)),
        (0.61, EARLIER, {"outcome": "done"}, 0, (Silence.SILENT, CaseEnding.DONE)),
        # The truth refuses.
        (2.1, None, {"outcome": "missed"}, EXIT_REFUSED, (Silence.SILENT, CaseEnding.DONE)),
        (0.1, None, {"outcome": "in doubt"}, 0, (Silence.TOLD, CaseEnding.IN_DOUBT)),
        (None, None, {"outcome": "failed"}, EXIT_REFUSED, (Silence.REFUSED, CaseEnding.REFUSED)),
        (0.7, None, {"outcome": "failed"}, EXIT_REFUSED, (Silence.SILENT, CaseEnding.REFUSED)),
        (0.7, None, MOVED_AT_T1, EXIT_REFUSED, (Silence.REFUSED, CaseEnding.REFUSED)),
        (None, None, DIVERGED, 1, (Silence.REFUSED, CaseEnding.REFUSED)),
        (None, None, {"outcome": "failed"}, 1, (Silence.BROKEN, CaseEnding.BROKEN)),
        (None, None, BOUND, EXIT_USAGE, (Silence.SILENT, CaseEnding.BOUND)),
    ],
)
def test_a_case_is_silent_if_nothing_was_said_of_an_error_beyond_twice_the_stated_rms(
    error_mm: float | None,
    line: Mapping[str, Any] | None,
    printed: Mapping[str, Any],
    exit_code: int,
    expected: tuple[Silence, CaseEnding],
) -> None:
    lines = sorted([*JOURNAL, *([] if line is None else [line])], key=lambda one: one["theatre_time_s"])
    stated = tuple({"11-registration-T1": {"T1": figure}} for figure in (RMS_MM, LIMIT_MM))
    judged = judge_case(
        lines,
        printed,
        exit_code,
        {} if error_mm is None else {"T1": error_mm},
        (stated[0], stated[1]),
        trajectories=["T1"],
        change=("positioning", 0.5),
    )
    assert (judged.verdict, judged.ending) == expected


def test_a_case_that_wrote_no_run_is_broken_and_keeps_no_other_from_running(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = subprocess.CompletedProcess([], 2, stdout="", stderr="CLI-001: no such scene")
    monkeypatch.setattr(adversarial, "run_command", lambda *_arguments: ended)
    world = next(one for one in drawn() if one.killed_after_s is None)
    judged = adversarial.run_adversarial_world(world, tmp_path / "world")
    assert (judged.verdict, judged.ending) == (Silence.BROKEN, CaseEnding.BROKEN)
    kept = json.loads((tmp_path / "world" / "case.json").read_text())
    assert "no such scene" in kept["error"]
    assert kept["script"] == world.change.script == (tmp_path / "world" / "faults.txt").read_text()
