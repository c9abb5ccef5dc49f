"""What is published about devices while they are only observed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from recording_cell import HOME, RecordingArm
from waiting import eventually

from procedures.engine.display_feed import DeviceWatch
from procedures.engine.events import DeviceAge, DeviceState, EventStream, Pose
from ronna_hw.devices.capabilities import Fact
from ronna_hw.devices.lifecycle import LastKnown, Lifecycle
from ronna_hw.devices.readings import Stamp, Validity
from ronna_hw.errors import LinkTimeout


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
