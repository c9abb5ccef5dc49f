"""The scene shows what is known at the moment, and nothing of before."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace

import pytest
from nicegui import Client, ui

from console.case_view import CaseView, ReportedPose
from console.scene.theatre_scene import TheatreScene
from procedures.engine.events import Bodies, Body, Pose, Questioned
from procedures.reporting.case_figures import CaseFigures, TrajectoryFigure
from ronna_hw.frames import Frame, Transform

PLACED = CaseFigures(
    robot_from_ct=Transform.of(
        Frame.ROBOT, Frame.CT, translation_mm=(700.0, 0.0, 300.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)
    )
)
BODIES = Bodies(
    moving=(Body(name="hand", radius_mm=10.0),),
    fixed=(Body(name="column", radius_mm=50.0, ends_mm=(0, 0, 0, 0, 0, 100)),),
    pairs=((0, 0),),
)
NEAR = Pose(arm="arm", joints_rad=(0.0,), age_s=0.0, bodies_mm=((100, 0, 0, 100, 0, 100),))
FAR = NEAR.model_copy(update={"bodies_mm": ((5000, 0, 0, 5000, 0, 100),)})
OTHER_TOOL = NEAR.model_copy(update={"bodies_mm": (*NEAR.bodies_mm, *NEAR.bodies_mm)})


def in_a_scene(do: Callable[[TheatreScene], None]) -> None:
    async def page() -> None:
        with Client(ui.page("/of-a-test"), request=None):
            do(TheatreScene(low=True))

    asyncio.run(page())


def test_a_head_whose_place_is_no_longer_known_is_not_drawn_until_it_is_known_again() -> None:
    def do(scene: TheatreScene) -> None:
        scene.show(CaseView(), PLACED, 1)
        assert scene._head.visible_
        scene.show(CaseView(), replace(PLACED, robot_from_ct=None), 1)
        assert not scene._head.visible_
        scene.show(CaseView(), PLACED, 1)
        assert scene._head.visible_
        scene.show(CaseView(), None, 1)
        assert not scene._head.visible_

    in_a_scene(do)


def test_the_clearance_disappears_when_nothing_is_near_and_when_it_is_not_known() -> None:
    def do(scene: TheatreScene) -> None:
        near = CaseView(bodies=BODIES, pose=ReportedPose(NEAR, 0.0))
        for other in (
            replace(near, pose=ReportedPose(FAR, 0.0)),
            replace(near, pose=ReportedPose(OTHER_TOOL, 0.0)),
            replace(near, pose=None),
            replace(near, pose=None, bodies=BODIES.model_copy()),
        ):
            scene.show(near, None, 0)
            assert scene.closest is not None
            assert scene._near.group.visible_
            scene.show(other, None, 0)
            assert scene.closest is None
            assert not scene._near.group.visible_

    in_a_scene(do)


def test_the_instrument_is_drawn_from_the_end_of_the_guide_to_the_planned_target_while_it_is_there() -> None:
    tool = ((0, 0, 400, 0, 0, 190), (-8, 2, 180, 8, 2, 180))  # of a guide that ends 30 mm before the entry
    links = ((500, 0, 0, 500, 0, 900),) * 4
    pose = NEAR.model_copy(update={"bodies_mm": (*links, *tool)})
    path = TrajectoryFigure("T2", entry_mm=(0.0, 0.0, 150.0), target_mm=(0.0, 0.0, 100.0))
    there = CaseFigures(trajectories=(path,))
    asked = Questioned(
        question=1, topic="at_target:T2", subject="s", value="v", answers=("done", "hold"), timeout_s=None
    )

    def do(scene: TheatreScene) -> None:
        view = CaseView(pose=ReportedPose(pose, 0.0), question=asked)
        scene.show(view, there, 0)
        assert scene._inserted == ((0.0, 0.0, 180.0), path.target_mm)
        rod, caption = scene._instrument
        assert (rod.z, rod.sz) == (pytest.approx(0.18), pytest.approx(0.08))
        assert caption.args[0] == "instrument, as planned"
        for other in (None, asked.model_copy(update={"topic": "retreat:T2"})):
            scene.show(view, there, 0)
            scene.show(replace(view, question=other), there, 0)
            assert scene._instrument == []
        scene.show(view, None, 0)
        assert scene._instrument == []

    in_a_scene(do)
