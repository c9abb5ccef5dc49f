"""What is published about the devices while they are only looked at."""

from types import SimpleNamespace
from typing import Any

from recording_cell import HOME, RecordingArm
from waiting import eventually

from procedures.engine.device_watch import DeviceWatch
from procedures.engine.events import DeviceAge, DeviceState, EventStream, Pose
from ronna_hw.devices.last_known import LastKnown
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout


def watched(device: Any) -> tuple[DeviceWatch, Any]:
    stream = EventStream()
    return DeviceWatch({"arm": device}, stream, lambda: 5.0), stream.subscribe()


def test_a_state_is_published_when_it_changes_and_an_age_and_a_pose_at_every_look() -> None:
    watch, reader = watched(RecordingArm("arm"))
    watch.look()
    assert [event.what for event in reader.read(0).events] == [
        DeviceState(device="arm", state="disconnected"),
        DeviceAge(device="arm", age_s=5.0),
        Pose(arm="arm", joints_rad=HOME, age_s=5.0),
    ]
    watch.look()
    assert [event.what.kind for event in reader.read(0).events] == ["age", "pose"]


def test_a_fault_is_published_with_its_words_and_once() -> None:
    seen = LastKnown[object](Lifecycle.FAULT, LinkTimeout("the cable is out"), None)
    watch, reader = watched(SimpleNamespace(observe=lambda: seen))
    watch.look()
    watch.look()
    (only,) = reader.read(0).events
    assert only.what.state == "fault"
    assert "the cable is out" in only.what.fault


def test_the_last_look_is_made_when_the_watch_ends() -> None:
    device = RecordingArm("arm")
    watch, reader = watched(device)
    with watch:
        device.state = Lifecycle.HOLD
    states = [event.what.state for event in reader.read(0).events if event.what.kind == "device"]
    assert states[-1] == "hold"


def test_a_watch_that_cannot_look_tells_it_once_and_looks_again() -> None:
    looks: list[bool] = []

    def observe() -> LastKnown[object]:
        looks.append(True)
        if len(looks) < 3:
            raise RuntimeError("no such register")
        return LastKnown[object](Lifecycle.HOLD, None, None)

    stream = EventStream()
    reader = stream.subscribe()
    with DeviceWatch({"arm": SimpleNamespace(observe=observe)}, stream, lambda: 5.0, period_s=0.01):
        eventually(lambda: len(looks) > 3)
    kinds = [event.what.kind for event in reader.read(0).events]
    assert kinds == ["fault", "device"]
