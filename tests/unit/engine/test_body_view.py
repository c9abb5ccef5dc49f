"""The arm as the bodies used for collision checks, for display."""

from __future__ import annotations

import pytest
from recording_cell import HOME, RecordingCell

from procedures.engine.display_feed import BodyView, DeviceWatch
from procedures.engine.events import Bodies, EventStream, LinkHealth, Pose
from procedures.workcell import MountedTool
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Part, Surroundings
from ronna_hw.devices.lifecycle import Lifecycle

AROUND = Surroundings(
    tool=(Part("needle", Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 100.0), 3.0)),),
    obstacles=(Obstacle("head", Capsule((800.0, 0.0, 0.0), (800.0, 0.0, 100.0), 90.0), True),),
)
POSE = Pose(arm="arm", joints_rad=HOME, age_s=0.0)


def test_bodies_are_published_only_when_the_surroundings_change(cell: RecordingCell) -> None:
    view, events = BodyView(cell.workcell), EventStream()
    reader = events.subscribe()
    for _ in range(3):
        view.at(POSE)
        view.publish(events)
    cell.workcell.surround(AROUND)
    for _ in range(3):
        view.at(POSE)
        view.publish(events)
    said = [event.what for event in reader.read(0.0).events]
    bare, tooled = (one for one in said if isinstance(one, Bodies))
    assert len(said) == 2
    assert [body.name for body in tooled.moving[-1:]] == ["needle"]
    assert len(tooled.moving) == len(bare.moving) + 1
    assert [body.name for body in tooled.fixed if body.is_head] == ["head"]
    assert all(first < len(tooled.moving) and second < len(tooled.fixed) for first, second in tooled.pairs)


def test_a_pose_has_both_ends_of_each_moving_body(cell: RecordingCell) -> None:
    cell.workcell.surround(AROUND)
    places = BodyView(cell.workcell).at(POSE).bodies_mm
    flange = cell.workcell.arm.kinematics.flange_pose(HOME)
    assert places[-1][:3] == pytest.approx(flange.translation_mm, abs=0.06)
    assert places[-1][3:] == pytest.approx(flange.apply([0.0, 0.0, 100.0]), abs=0.06)


def test_the_cameras_are_not_drawn_after_a_fault_while_the_mounted_head_is_unchecked(
    cell: RecordingCell,
) -> None:
    cell.workcell.mount.check(MountedTool.STEREO_HEAD)
    cell.workcell.surround(AROUND)
    view = BodyView(cell.workcell)
    assert len(view.at(POSE).tool_mm) == 3
    cell.arm.state = Lifecycle.FAULT
    cell.workcell.recover("arm", "A. Nurse")
    assert view.at(POSE).tool_mm == ()


def test_the_health_of_the_link_is_published_once_more_when_its_stream_has_ended(cell: RecordingCell) -> None:
    view, events = BodyView(cell.workcell), EventStream()
    reader = events.subscribe()
    for state in (Lifecycle.CONFIGURED, Lifecycle.ACTIVE, Lifecycle.CONFIGURED, Lifecycle.CONFIGURED):
        cell.arm.state = state
        view.publish(events)
    said = [event.what for event in reader.read(0.0).events]
    assert [one.cycles for one in said if isinstance(one, LinkHealth)] == [1]


def test_the_health_of_a_link_that_still_streams_is_published_at_the_last_look(cell: RecordingCell) -> None:
    events = EventStream()
    reader = events.subscribe()
    cell.arm.state = Lifecycle.ACTIVE
    with DeviceWatch({}, events, lambda: 0.0, 1000.0, BodyView(cell.workcell)):
        pass
    assert [event.what.kind for event in reader.read(0.0).events] == ["bodies", "link"]
