"""What displays are shown of a case: the arm's bodies, the views of its cameras, the state of devices."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recording_cell import HOME, RecordingArm, RecordingCell
from waiting import eventually

from procedures.engine.body_view import BodyView, camera_views
from procedures.engine.display_feed import DeviceWatch
from procedures.engine.events import Bodies, DeviceAge, DeviceState, EventStream, LinkHealth, Pose
from procedures.relocalization.triangulation import CameraModel
from procedures.workcell import MountedTool
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Part, Surroundings
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.devices.readings import Stamp, Validity
from ronna_hw.errors import LinkTimeout

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
    cell.workcell.master.surround(AROUND)
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
    cell.workcell.master.surround(AROUND)
    places = BodyView(cell.workcell).at(POSE).bodies_mm
    flange = cell.workcell.master.arm.kinematics.flange_pose(HOME)
    assert places[-1][:3] == pytest.approx(flange.translation_mm, abs=0.06)
    assert places[-1][3:] == pytest.approx(flange.apply([0.0, 0.0, 100.0]), abs=0.06)


def test_the_cameras_are_not_drawn_after_a_fault_while_the_mounted_head_is_unchecked(
    cell: RecordingCell,
) -> None:
    cell.workcell.master.mount.check(MountedTool.STEREO_HEAD)
    cell.workcell.master.surround(AROUND)
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


def test_the_corners_of_a_pyramid_match_the_picture_and_it_reaches_beyond_the_tool(
    cell: RecordingCell,
) -> None:
    head = cell.calibrations.stereo_head
    for view, camera in zip(camera_views(head), (head.left, head.right), strict=True):
        centre, *corners = np.reshape(view.points_mm, (-1, 3))
        columns, rows = camera.sensor_px
        undistorted = camera.model_copy(update={"distortion": (0.0,) * 5})
        seen = np.array([CameraModel(undistorted).project(corner)[0] for corner in corners])
        assert np.allclose(seen, [(0, 0), (columns, 0), (columns, rows), (0, rows)], atol=15.0)  # 0.05 mm
        assert np.allclose(centre, CameraModel(camera).centre_mm, atol=0.06)
        middle = np.mean(corners, axis=0) - centre
        assert np.linalg.norm(middle) > np.linalg.norm(centre)  # beyond the tool's origin


def watched(device: Any) -> tuple[DeviceWatch, Any]:
    stream = EventStream()
    return DeviceWatch({"arm": device}, stream, lambda: 5.0), stream.subscribe()


def test_a_state_is_published_on_change_and_age_and_pose_at_every_observation() -> None:
    watch, reader = watched(RecordingArm("arm"))
    watch.look()
    assert [event.what for event in reader.read(0).events] == [
        DeviceState(device="arm", state="disconnected"),
        DeviceAge(device="arm", age_s=5.0, validity="ok"),
        Pose(arm="arm", joints_rad=HOME, age_s=5.0),
    ]
    watch.look()
    assert [event.what.kind for event in reader.read(0).events] == ["age", "pose"]


def test_a_fault_is_published_once_with_its_message() -> None:
    seen = LastKnown[object](Lifecycle.FAULT, LinkTimeout("the cable is out"), None)
    watch, reader = watched(SimpleNamespace(observe=lambda: seen, notices=()))
    watch.look()
    watch.look()
    (only,) = reader.read(0).events
    assert only.what.state == "fault"
    assert "the cable is out" in only.what.fault


def test_a_final_observation_is_published_when_the_watch_ends() -> None:
    device = RecordingArm("arm")
    watch, reader = watched(device)
    with watch:
        device.state = Lifecycle.HOLD
    states = [event.what.state for event in reader.read(0).events if event.what.kind == "device"]
    assert states[-1] == "hold"


def test_a_watch_that_cannot_observe_reports_it_once_and_retries() -> None:
    looks: list[bool] = []

    def observe() -> LastKnown[object]:
        looks.append(True)
        if len(looks) < 3:
            raise RuntimeError("no such register")
        return LastKnown[object](Lifecycle.HOLD, None, None)

    stream = EventStream()
    reader = stream.subscribe()
    with DeviceWatch(
        {"arm": SimpleNamespace(observe=observe, notices=())}, stream, lambda: 5.0, period_s=0.01
    ):
        eventually(lambda: len(looks) > 3)
    kinds = [event.what.kind for event in reader.read(0).events]
    assert kinds == ["fault", "device"]


def test_the_measuring_volume_of_a_tracker_is_published_once_when_known() -> None:
    tracker = SimpleNamespace(
        observe=lambda: LastKnown[object](Lifecycle.CONNECTED, None, None), notices=(), volume_sections_mm=()
    )
    watch, reader = watched(tracker)
    watch.look()
    tracker.volume_sections_mm = ((-950.0, 200.0, 300.0),)
    tracker.observe = lambda: LastKnown[object](Lifecycle.CONFIGURED, None, None)
    watch.look()
    watch.look()
    kinds = [event.what.kind for event in reader.read(0).events]
    assert kinds == ["device", "device", "volume"]


def test_facts_reported_by_a_device_are_published_on_change() -> None:
    says = [(Fact("operating mode", "EXT"),), (Fact("operating mode", "T1", ready=False),)]
    arm = SimpleNamespace(observe=lambda: LastKnown[object](Lifecycle.HOLD, None, None, says[0]), notices=())
    watch, reader = watched(arm)
    watch.look()
    watch.look()
    del says[0]
    watch.look()
    said = [event.what.says for event in reader.read(0).events]
    assert [[(one.found, one.ready) for one in facts] for facts in said] == [[("EXT", True)], [("T1", False)]]


def test_a_failing_final_observation_raises_nothing() -> None:
    def cannot() -> LastKnown[object]:
        raise LinkTimeout("no such register")

    unseen = SimpleNamespace(observe=cannot, notices=())
    with DeviceWatch({"arm": unseen}, EventStream(), lambda: 5.0, period_s=1000.0):
        pass


def test_the_age_of_a_reading_of_another_kind_is_published_and_a_bare_number_has_none() -> None:
    pressed = SimpleNamespace(stamp=Stamp(7, 0, 4.0), validity=Validity.STALE)
    ages = []
    for reading in (pressed, 0.3, None):
        seen = LastKnown[object](Lifecycle.ACTIVE, None, reading)
        watch, reader = watched(SimpleNamespace(observe=lambda seen=seen: seen, notices=()))
        watch.look()
        ages.append([event.what for event in reader.read(0).events if event.what.kind == "age"])
    assert ages == [[DeviceAge(device="arm", age_s=1.0, validity="stale", readings=7)], [], []]
