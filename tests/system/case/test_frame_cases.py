"""Whole cases with a frame: the x-shaped one, as a tool or as strays, and the patient's on the head clamp."""

from __future__ import annotations

import json

import pytest
from simulated_case import SimulatedCase

from ronna_hw.x_frame import NAME
from sim.world.options import Carrier
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import add_patient_frame, draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
LIMIT_MM = 1.0  # of the one target: the mini scene's CT is coarse
DRAPED = "".join(f"since step == tool_change: tracker occlude marker {number}\n" for number in (1, 2, 3))
PUSHES = (
    "since step == global_localization after 0.5 s: room shift tracker 12 -8 5 mm\n"
    "since step == tool_change: room shift tracker -20 4 9 mm\n"
)
MOVED_HEAD = "since step == at_target: room shift head 1 0.5 0 mm\n"


def without_definition() -> Scene:
    """The scene of a tracker without the frame's definition."""
    scene = draw_scene("mini", seed=3, fiducials=Carrier.XFRAME)
    tools = tuple(one for one in scene.tracker.tools if one.name != NAME)
    assert len(tools) == len(scene.tracker.tools) - 1
    return scene.model_copy(update={"tracker": scene.tracker.model_copy(update={"tools": tools})})


@pytest.mark.parametrize("as_tool", [True, False], ids=["as a tool", "as strays"])
def test_a_case_with_the_x_shaped_frame_reaches_its_target(case: SimulatedCase, as_tool: bool) -> None:
    named = ("--scene", "mini", "--seed", "3", "--fiducials", "xframe")
    ran = case.run(*named) if as_tool else case.run(scene=without_definition())
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert outcome["ct"]["found"] == 4
    assert outcome["registration"]["n"] == 4
    assert outcome["max_application_error_mm"] < LIMIT_MM


def run(case: SimulatedCase, faults: str) -> tuple[int, dict[str, object], str, list[str]]:
    """Run a case; return its exit code, outcome, last words, and what the journal found or voided."""
    ran = case.run(scene=add_patient_frame(draw_scene("mini", seed=0)), faults=faults)
    lines = [line for line in case.journal if line["entry"] in ("finding", "voided")]
    told = [str(line.get("text") or line.get("what")) for line in lines]
    return ran.returncode, json.loads(ran.stdout or "{}"), ran.stderr, told


def test_pushes_against_the_tracker_and_a_drape_over_the_head_change_no_target_and_the_head_is_in_doubt(
    case: SimulatedCase,
) -> None:
    code, outcome, said, told = run(case, DRAPED + PUSHES)
    assert code == 3, said  # nobody has seen that the head did not slip in its clamp
    assert outcome["outcome"] == "in doubt"
    assert any("may have slipped in the clamp" in one for one in told)
    assert float(str(outcome["max_application_error_mm"])) < LIMIT_MM
    assert any("the tracker was moved" in one and "the case goes on" in one for one in told)
    assert any("the spheres on the head are hidden" in one for one in told)


def test_a_head_that_moves_under_the_drape_stops_the_case(case: SimulatedCase) -> None:
    code, _, said, told = run(case, DRAPED + MOVED_HEAD)
    assert code != 0
    assert "PRO-020: the head clamp has moved" in said
    assert any("PRO-020" in one for one in told)
