"""Bodies of two arms for display: each where it stands, with its own joints, and how far apart they are."""

from __future__ import annotations

from math import dist
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from ideal_arm import IdealArm

from procedures.engine.body_view import BodyView
from procedures.engine.events import ArmsApart, Bodies, EventContent, EventStream, Pose
from procedures.workcell import Workcell
from procedures.workcell.placed_arms import PlacedArms
from ronna_hw.arm.pose import Pose as BasePose
from ronna_hw.roles import ASSISTANT, MASTER

HOME = IdealArm.kinematics.home_rad
BESIDE = BasePose(position_mm=(0.0, -800.0, 0.0))
TURNED = (HOME[0] + 0.5, *HOME[1:])


@pytest.fixture
def placed() -> PlacedArms:
    return PlacedArms((MASTER, ASSISTANT), lambda _role: IdealArm.kinematics)


@pytest.fixture
def view(placed: PlacedArms) -> BodyView:
    arms = {
        role: SimpleNamespace(role=role, name=name, spoken_name=f"the {role}", tool=None, streaming=False)
        for role, name in ((MASTER, "arm"), (ASSISTANT, "assistant"))
    }
    calibrations = SimpleNamespace(stereo_head=None)
    cell: Any = SimpleNamespace(
        arms=arms, master=arms[MASTER], motion=SimpleNamespace(placed=placed), calibrations=calibrations
    )
    return BodyView(cast("Workcell", cell))


def pose(arm: str, joints_rad: tuple[float, ...] = HOME) -> Pose:
    return Pose(arm=arm, joints_rad=joints_rad, age_s=0.0)


def published(view: BodyView) -> list[EventContent]:
    events = EventStream()
    reader = events.subscribe()
    view.publish(events)
    return [event.what for event in reader.read(0.0).events]


def test_an_arm_is_not_drawn_before_it_is_known_where_it_stands(view: BodyView) -> None:
    assert view.at(pose("arm")).bodies_mm
    assert view.at(pose("assistant")) == pose("assistant")
    assert [one.arm for one in published(view) if isinstance(one, Bodies)] == ["arm"]


def test_each_arm_is_drawn_where_it_stands_with_its_own_joints(view: BodyView, placed: PlacedArms) -> None:
    placed.place(ASSISTANT, BESIDE, 0.0)
    own = view.at(pose("arm")).bodies_mm
    beside = view.at(pose("assistant")).bodies_mm
    assert np.subtract(own, beside) == pytest.approx(np.tile([0.0, 800.0, 0.0] * 2, (len(own), 1)), abs=0.11)
    turned = view.at(pose("assistant", TURNED)).bodies_mm
    assert dist(turned[-1][:3], beside[-1][:3]) > 100.0
    assert view.at(pose("arm")).bodies_mm == own


def test_the_bodies_of_a_second_arm_are_named_after_it(view: BodyView, placed: PlacedArms) -> None:
    placed.place(ASSISTANT, BESIDE, 0.0)
    first, second = (one for one in published(view) if isinstance(one, Bodies))
    assert not any("assistant" in body.name for body in (*first.moving, *first.fixed))
    assert all("assistant" in body.name for body in (*second.moving, *second.fixed))


def test_the_distance_between_the_arms_is_published_when_one_has_moved(
    view: BodyView, placed: PlacedArms
) -> None:
    placed.place(ASSISTANT, BESIDE, 0.0)
    view.at(pose("arm"))
    view.at(pose("assistant"))
    (at_home,) = (one for one in published(view) if isinstance(one, ArmsApart))
    assert at_home.arms == ("arm", "assistant")
    assert not [one for one in published(view) if isinstance(one, ArmsApart)]
    view.at(pose("assistant", TURNED))
    (turned,) = (one for one in published(view) if isinstance(one, ArmsApart))
    assert turned.distance_mm < at_home.distance_mm - 100.0
