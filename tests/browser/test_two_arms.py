"""A case with two arms in the browser: both are drawn, each where it stands and with its own joints."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from console_clicks import answer, answer_until, await_next, run_to, take_seat
from operated_case import MINI, OperatedCase, OperatedCases, enter

from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.pose import Pose
from ronna_hw.vectors import joint_vector

LINKS = ("upper arm", "forearm", "wrist", "hand")
REACH_MM, LARGEST_DEG = 900.0, 0.1  # of any joint, as seen at the hand
BASE_MM = 1.0  # by which the base of the second arm may be off, as it was measured
ENDS = """names => {
  const scene = window[Object.keys(window).find(key => key.startsWith("scene_"))];
  scene.updateMatrixWorld(true);
  return names.map(name => scene.getObjectByName(name).matrixWorld.elements.slice(12, 15));
}"""  # metres


def drawn_mm(page: Any, arm: str) -> Any:
    """Return the beginnings of an arm's links, (links, 3) mm, as the page draws them."""
    names = [link if arm == "arm" else f"{link} of the {arm}" for link in LINKS]
    return 1000.0 * np.array(page.evaluate(ENDS, names))


def true_mm(case: OperatedCase, arm: str) -> Any:
    """Return the same by the joints and the base of the simulated room."""
    theatre = case.run / "theatre"
    joints_rad = joint_vector(json.loads((theatre / "world.json").read_text())[arm]["joints_rad"])
    scene = json.loads((theatre / "scene.json").read_text())
    base = Pose()
    if arm == "assistant":
        stands = scene["assistant"]["robot_from_base"]
        base = Pose.from_quaternion(stands["translation_mm"], stands["quaternion_wxyz"])
    links, _ = find_arm("kr6_r900_sixx").kinematics.link_segments(joints_rad)
    return np.array([base.apply(start) for start, _ in links])


def largest_off_mm(page: Any, case: OperatedCase) -> dict[str, float]:
    return {
        arm: float(np.linalg.norm(drawn_mm(page, arm) - true_mm(case, arm), axis=1).max())
        for arm in ("arm", "assistant")
    }


@pytest.mark.slow  # a whole case with two arms
def test_each_joint_of_both_arms_is_drawn_as_it_is(start: OperatedCases, page: Any) -> None:
    case = start("step", scene=(*MINI, "--dual"))
    enter(page, case.addresses["url"])
    take_seat(page)
    await_next(page, "ct_import")
    limit_mm = REACH_MM * math.radians(LARGEST_DEG) + BASE_MM
    run_to(page, "at_target:T1")
    for asked in ("the tool been exchanged", "the instrument at depth"):
        answer_until(page, asked)
        off_mm = largest_off_mm(page, case)
        assert max(off_mm.values()) < limit_mm, f"{asked}: {off_mm}"
        said = page.locator(".scenebox").inner_text()
        assert "closest to arm" in said
        assert "closest to assistant" in said
        assert "between the arms" in said
        answer(page)
