"""Where the collision bodies are drawn, and which two are closest."""

from __future__ import annotations

import math

import numpy as np
import pytest

from console.scene.bodies import closest_pair, rotation_along
from procedures.engine.events import Bodies, Body, Pose


@pytest.mark.parametrize("end", [(0, 0, 5), (0, 0, -5), (3, 0, 0), (1, -2, 3), (0, 4, 0)])
def test_a_capsule_is_drawn_along_its_axis_and_not_mirrored(end: tuple[float, float, float]) -> None:
    rotation = np.array(rotation_along((0.0, 0.0, 0.0), end))
    assert rotation @ [0, 0, 1] == pytest.approx(np.array(end) / math.hypot(*end))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation @ rotation.T == pytest.approx(np.eye(3))


BODIES = Bodies(
    moving=(Body(name="hand", radius_mm=10.0), Body(name="needle", radius_mm=1.0)),
    fixed=(
        Body(name="column", radius_mm=50.0, ends_mm=(0, 0, 0, 0, 0, 100)),
        Body(name="clamp", radius_mm=5.0, ends_mm=(200, -50, 0, 200, 50, 0)),
    ),
    pairs=((0, 0), (0, 1), (1, 1), (1, -1)),
)


def test_the_closest_checked_pair_is_named_with_its_clearance_and_location() -> None:
    pose = Pose(
        arm="arm",
        joints_rad=(0.0,),
        age_s=0.0,
        bodies_mm=((100, 0, 200, 150, 0, 200), (150, 0, 200, 200, 10, 40)),
    )
    closest = closest_pair(BODIES, pose)
    assert closest is not None
    assert (closest.first, closest.second) == ("needle", "hand") or closest.second == "clamp"
    without_own_arm = BODIES.model_copy(update={"pairs": BODIES.pairs[:3]})
    closest = closest_pair(without_own_arm, pose)
    assert closest is not None
    assert (closest.first, closest.second, closest.distance_mm) == ("needle", "clamp", pytest.approx(34.0))
    assert closest.from_mm == pytest.approx((200, 10, 40), abs=1e-3)
    assert closest.to_mm == pytest.approx((200, 10, 0), abs=1e-3)


def test_a_pose_without_matching_bodies_has_no_clearance() -> None:
    assert closest_pair(BODIES, Pose(arm="arm", joints_rad=(0.0,), age_s=0.0)) is None


@pytest.mark.parametrize(
    "change",
    [
        {"pairs": ((7, 0),)},
        {"pairs": ((0, -9),)},
        {"fixed": ({"name": "column", "radius_mm": 50.0, "ends_mm": (0, 0)},), "pairs": ()},
        {"cameras": ({"name": "left", "points_mm": (0, 0)},)},
    ],
)
def test_bodies_that_cannot_be_drawn_are_refused_as_the_events_are_read(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"is not there|two ends|four corners"):
        Bodies.model_validate({**BODIES.model_dump(), **change})


@pytest.mark.parametrize("change", [{"tool_mm": (1.0,)}, {"bodies_mm": ((0.0,),)}])
def test_a_pose_that_cannot_be_drawn_is_refused(change: dict[str, object]) -> None:
    pose = {"arm": "arm", "joints_rad": (0.0,), "age_s": 0.0}
    with pytest.raises(ValueError, match=r"origin|at least 6"):
        Pose.model_validate({**pose, **change})
