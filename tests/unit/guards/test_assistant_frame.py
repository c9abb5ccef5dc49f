"""The assistant's frame is watched on its way through the guide."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.guards.assistant_frame import READINGS, SHIFTED_MM, AssistantFrame
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import Validity
from ronna_hw.frames import Frame, Transform

STANDS = Transform.of(Frame.ROBOT, Frame.TRACKER)
DOWN = Transform.of(Frame.ASSISTANT, Frame.TOOL, quaternion_wxyz=(0.0, 1.0, 0.0, 0.0))


class LedAssistant:
    """Assistant on an axis that leads down, its frame 100 mm beside its flange and 150 mm from its clamp."""

    def __init__(self) -> None:
        self.at_mm = (0.0, 0.0, 0.0)
        self.place = SimpleNamespace(axis=SimpleNamespace(held=DOWN))
        self.holder = SimpleNamespace(frame="assistant_frame")
        self.base = Transform.of(Frame.ROBOT, Frame.ASSISTANT, translation_mm=(1000.0, 0.0, 0.0))
        self.flange_from_clamp = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(-50.0, 0.0, 0.0))
        reading = SimpleNamespace(joints_rad=(0.0,) * 6)
        self.arm = SimpleNamespace(observe=lambda: SimpleNamespace(reading=reading))
        self.calibrated = SimpleNamespace(forward=lambda _joints: Pose(self.at_mm))


def seen_at(place_mm: tuple[float, float, float], turn_deg: float = 0.0) -> Transform:
    half_rad = math.radians(turn_deg) / 2.0
    about_z = (math.cos(half_rad), 0.0, 0.0, math.sin(half_rad))
    return Transform.of(Frame.TRACKER, Frame.MARKER, translation_mm=place_mm, quaternion_wxyz=about_z)


def frame(seen: Transform | None) -> Any:
    validity = Validity.MISSING if seen is None else Validity.OK
    return SimpleNamespace(
        tool=lambda _name: SimpleNamespace(validity=validity, transform=lambda _target, _source: seen)
    )


def watch_way(shift_mm: tuple[float, float, float], hidden: int = 0) -> float:
    """Lead by 60 mm, the cart shifted after half of the way; return what the watch measures."""
    assistant = LedAssistant()
    watch = AssistantFrame(cast("Any", assistant))
    for number in range(4 * READINGS):
        assistant.at_mm = (0.0, 0.0, -float(number))
        dx, dy, dz = shift_mm if number >= 2 * READINGS else (0.0, 0.0, 0.0)
        seen = seen_at((1100.0 + dx, dy, -float(number) + dz))
        watch.add_frame(frame(None if number < hidden else seen), STANDS)
    return watch.shifted_mm


@pytest.mark.hazard(64)
def test_a_cart_that_moves_across_the_axis_is_noticed() -> None:
    assert watch_way((0.0, 1.2 * SHIFTED_MM, 0.0)) == pytest.approx(1.2 * SHIFTED_MM)


@pytest.mark.hazard(64)
def test_a_cart_that_turns_about_its_frame_is_noticed_where_the_clamp_is() -> None:
    watch = AssistantFrame(cast("Any", LedAssistant()))
    watch.begin_at(seen_at((1100.0, 0.0, 0.0)), STANDS)
    for _ in range(READINGS):
        watch.add_frame(frame(seen_at((1100.0, 0.0, 0.0), turn_deg=2.0)), STANDS)
    assert watch.shifted_mm == pytest.approx(150.0 * math.radians(2.0), rel=0.01)


def test_the_way_along_the_axis_and_hidden_frames_are_no_move() -> None:
    assert watch_way((0.0, 0.0, -3.0)) == pytest.approx(0.0, abs=1e-9)
    assert watch_way((0.0, 2.0, 0.0), hidden=4 * READINGS) == 0.0


@pytest.mark.hazard(64)
def test_a_cart_that_moved_after_the_look_over_the_guide_is_noticed_from_the_first_frames_on() -> None:
    watch = AssistantFrame(cast("Any", LedAssistant()))
    watch.begin_at(seen_at((1100.0, 0.0, 0.0)), STANDS)
    for _ in range(READINGS):
        watch.add_frame(frame(seen_at((1100.0, 1.2 * SHIFTED_MM, 0.0))), STANDS)
    assert watch.shifted_mm == pytest.approx(1.2 * SHIFTED_MM)


def test_what_an_earlier_watch_has_seen_stops_no_later_one() -> None:
    watch = AssistantFrame(cast("Any", LedAssistant()))
    watch.begin_at(seen_at((1100.0, 0.0, 0.0)), STANDS)
    for _ in range(READINGS):
        watch.add_frame(frame(seen_at((1100.0, 3.0, 0.0))), STANDS)
    watch.begin_watch()
    watch.add_frame(frame(None), STANDS)
    assert watch.shifted_mm == 0.0
    for _ in range(READINGS):
        watch.add_frame(frame(seen_at((1100.0, 0.1, 0.0))), STANDS)
    assert watch.shifted_mm == pytest.approx(0.1)
