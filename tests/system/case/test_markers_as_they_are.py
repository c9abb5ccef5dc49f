"""Spheres that differ from the CT: found where possible, left out only with consent.

Whole cases on the mini scene, by keys of the scene and by a fault.
"""

import json
from typing import Any

import pytest
from simulated_case import SimulatedCase

from procedures.guards.errors import PatientMoved
from procedures.registration.errors import NO_UNIQUE_MATCH
from ronna_hw.errors import EXIT_REFUSED
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400), pytest.mark.hazard(11)]
LARGEST_ERROR_MM = 1.0
ELSEWHERE_MM = (1.0, -1.0, 0.5)
Changes = dict[int, dict[str, Any]]


def changed_scene(markers: int, changes: Changes) -> Scene:
    """The mini scene with other keys of some spheres, by number."""
    scene = draw_scene("mini", seed=3, markers=markers, targets=1)
    changed = tuple(one.model_copy(update=changes.get(one.number, {})) for one in scene.head.fiducials)
    return scene.model_copy(update={"head": scene.head.model_copy(update={"fiducials": changed})})


def run(
    case: SimulatedCase, *words: str, scene: Scene | None = None, faults: str = "", answers: str = ""
) -> tuple[int, dict[str, Any], dict[str, str], str]:
    """Exit code, outcome, the answers by topic, and what was said."""
    ran = case.run(*words, scene=scene, faults=faults, answers=answers)
    asked = {str(one["topic"]): str(one["answer"]) for one in case.journal if "topic" in one}
    return ran.returncode, json.loads(ran.stdout), asked, ran.stderr


FOUND: dict[str, tuple[int, Changes, str]] = {
    "missing": (5, {2: {"missing": True}}, "unmatched_sphere"),
    "on each other's screw": (
        6,
        {2: {"base_in_theatre": 4}, 4: {"base_mm": 22.0, "base_in_theatre": 2}},
        "unmatched_sphere",
    ),
    "displaced": (5, {2: {"displaced_mm": ELSEWHERE_MM}}, "moved_sphere:T1"),
    "worn": (5, {2: {"worn_percent": 60.0}}, "sphere:T1"),
}


@pytest.mark.parametrize("what", FOUND)
def test_the_case_completes_without_the_faulty_sphere_as_the_operator_agrees(
    case: SimulatedCase, what: str
) -> None:
    markers, changes, topic = FOUND[what]
    code, outcome, asked, _ = run(case, scene=changed_scene(markers, changes))
    assert (code, outcome["registration"]["n"]) == (0, 4)
    assert asked[topic] == "leave it out"
    assert outcome["max_application_error_mm"] <= LARGEST_ERROR_MM


FIVE = ("--scene", "mini", "--seed", "3", "--markers", "5")
LOOSENS = "room loosen marker 2 1.2 -0.9 0 mm"


def test_a_screw_that_loosened_before_the_tracker_measured_is_found_by_the_fit(
    case: SimulatedCase,
) -> None:
    code, outcome, asked, _ = run(case, *FIVE, faults=f"at 0 s: {LOOSENS}")
    assert (code, outcome["registration"]["n"]) == (0, 4)
    assert asked["moved_sphere:T1"] == "leave it out"


def test_a_screw_that_loosens_later_is_named_before_a_registration_uses_it(
    case: SimulatedCase,
) -> None:
    code, _, asked, said = run(case, *FIVE, faults=f"at 5 s: {LOOSENS}")
    assert code == PatientMoved.exit_code
    assert f"{PatientMoved.code}: one sphere has moved by 1.5 mm" in said
    assert "the other 4 have not: its screw may be loose" in said
    assert "registration:T1" not in asked


def test_without_consent_the_case_ends_before_the_arm_moves(case: SimulatedCase) -> None:
    held = 'default = "first"\n[answers]\nunmatched_sphere = "hold"'
    code, _, asked, said = run(case, scene=changed_scene(5, {2: {"missing": True}}), answers=held)
    assert code == NO_UNIQUE_MATCH.exit_code
    assert NO_UNIQUE_MATCH.code in said
    assert asked["unmatched_sphere"] == "hold"
    assert "first_motion" not in asked


def test_a_displaced_sphere_among_three_ends_the_case(case: SimulatedCase) -> None:
    code, _, asked, said = run(case, scene=changed_scene(3, {2: {"displaced_mm": (1.5, -1.0, 0.5)}}))
    assert code == EXIT_REFUSED
    assert "PRO-007" in said
    assert "With three spheres it cannot be told which one has moved" in said
    assert "moved_sphere:T1" not in asked
