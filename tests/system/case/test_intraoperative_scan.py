"""A whole case goes on with a scan of the clamped head: a sphere that moved since the CT does not matter."""

from __future__ import annotations

import json

import pytest
from simulated_case import SimulatedCase

from sim.world.scene.named_scenes import draw_scene

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
SEED, MOVED_MM = 1005, (1.5, 0.0, 0.5)
LIMIT_MM = 1.0  # uncalibrated arm


def test_a_sphere_that_moved_since_the_ct_is_used_where_the_scan_shows_it(case: SimulatedCase) -> None:
    scene = draw_scene("default", seed=SEED, targets=1)
    first, *others = scene.head.fiducials
    moved = (first.model_copy(update={"displaced_mm": MOVED_MM}), *others)
    scene = scene.model_copy(update={"head": scene.head.model_copy(update={"fiducials": moved})})
    ran = case.run("--intraoperative", scene=scene)
    assert ran.returncode == 0, ran.stderr
    outcome = json.loads(ran.stdout)
    assert outcome["registration"]["n"] == len(scene.head.fiducials)
    assert outcome["max_application_error_mm"] < LIMIT_MM
    found = [line["text"] for line in case.journal if line["entry"] == "finding"]
    assert any("has moved by 1." in text for text in found)
