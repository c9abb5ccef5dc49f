"""The driver reads what a PLUS-like server sends, and says what is wrong with a server that is not right."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from plus_server import STATUS_OK, TOOLS, PlusServer, make_tracker, pose_at, transform

from drivers.openigtlink_tracker.errors import ServerLost, SharedName, StreamGarbled
from drivers.openigtlink_tracker.options import read_options
from drivers.openigtlink_tracker.probe import probe
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import TrackerFrame, Validity
from ronna_hw.devices.sensors import reports_strays
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Frame
from ronna_hw.wire.openigtlink import encode_message
from ronna_hw.wire.openigtlink_contents import TRACKING_3D, TRACKING_6D, TrackedTool, encode_tracking


def jitter(frame: int) -> float:
    """The noise of a measurement: no two are equal."""
    return 0.01 * (frame % 7)


def both(frame: int) -> tuple[bytes, ...]:
    return (
        transform("RobotFrameToTracker", pose_at(100.0 + jitter(frame)), frame),
        transform("XFrameToTracker", pose_at(-200.0 + jitter(frame)), frame),
        STATUS_OK,
    )


def robot_frame_alone(frame: int) -> tuple[bytes, ...]:
    return (both(frame)[0], STATUS_OK)


@pytest.fixture
def server() -> Iterator[PlusServer]:
    with PlusServer() as one:
        yield one


@pytest.fixture
def active(server: PlusServer) -> Iterator[Any]:
    """An active tracker whose server sends both tools, until the test has it send something else."""
    tracker = make_tracker(server.endpoint)
    server.push(both)
    with tracker.active():
        tracker.read_frame()
        yield tracker
    tracker.close()


def read_until(
    tracker: Any, is_awaited: Callable[[TrackerFrame], bool], limit_s: float = 2.0
) -> TrackerFrame:
    for _ in range(100):
        frame: TrackerFrame = tracker.read_frame(limit_s)
        if is_awaited(frame):
            return frame
    raise AssertionError(f"never in 100 frames, the last is {frame}")


def validities(frame: TrackerFrame) -> list[str]:
    return [tool.validity.value for tool in frame.tools]


def test_poses_keep_their_numbers(active: Any) -> None:
    frame = active.read_frame()
    pose = frame.tool("robot_frame").transform(Frame.TRACKER, Frame.MARKER)
    x, y, z = pose.translation_mm
    assert (y, z) == (20.0, -1500.0)
    assert 100.0 <= x < 100.1
    assert pose.apply([[1.0, 0.0, 0.0]])[0] - pose.translation_mm == pytest.approx(
        [0.36, -0.8, 0.48], abs=1e-6
    )
    assert frame.strays == ()
    assert frame.tool("robot_frame").fit_error_mm is None  # nobody has said one


def test_transforms_of_one_moment_are_one_measurement(active: Any) -> None:
    for _ in range(5):
        frame = active.read_frame()
        first, second = (tool.position_mm[0] for tool in frame.tools)
        assert first - 100.0 == pytest.approx(second + 200.0, abs=1e-4)  # the same noise


def test_a_tool_that_is_not_sent_is_missing(server: PlusServer, active: Any) -> None:
    server.say = robot_frame_alone
    frame = read_until(active, lambda frame: frame.tool("x_frame").validity is Validity.MISSING)
    assert validities(frame) == ["ok", "missing"]


def test_tools_are_missing_while_only_the_status_comes(server: PlusServer, active: Any) -> None:
    server.say = lambda _frame: (STATUS_OK,)
    frame = read_until(active, lambda frame: validities(frame) == ["missing", "missing"])
    assert active.state is Lifecycle.ACTIVE
    assert active.read_frame().stamp.device_clock > frame.stamp.device_clock


@pytest.mark.parametrize(
    ("sent", "validity"),
    [
        pytest.param({"TransformStatus": "OUT_OF_VOLUME"}, "out_of_volume", id="out of volume"),
        pytest.param({"TransformStatus": "OUT_OF_VIEW"}, "missing", id="out of view"),
        pytest.param({"TransformValid": "0"}, "missing", id="not valid"),
        pytest.param({"pose": np.eye(4)}, "missing", id="identity"),
        pytest.param({"pose": np.diag([1.0, 1.0, -1.0, 1.0])}, "corrupt", id="mirrored"),
        pytest.param({"pose": 2.0 * pose_at(1.0)}, "corrupt", id="scaled"),
        pytest.param({"pose": pose_at(-200.0)}, "missing", id="frozen"),
    ],
)
def test_a_pose_that_is_none_is_not_taken_for_one(
    server: PlusServer, active: Any, sent: dict[str, Any], validity: str
) -> None:
    metadata = dict(sent)
    pose = metadata.pop("pose", None)

    def say(frame: int) -> tuple[bytes, ...]:
        place = pose_at(-200.0 + jitter(frame)) if pose is None else pose
        return both(frame)[0], transform("XFrameToTracker", place, frame, **metadata)

    server.say = say
    frame = read_until(active, lambda frame: frame.tool("x_frame").validity is not Validity.OK)
    assert validities(frame) == ["ok", validity]
    assert frame.tool("x_frame").position_mm is None


def test_tracking_data_are_read_instead_of_transforms(server: PlusServer, active: Any) -> None:
    def say(frame: int) -> tuple[bytes, ...]:
        tools = [TrackedTool("RobotFrameToTracker", TRACKING_6D, pose_at(300.0 + jitter(frame)))]
        return (encode_message("TDATA", "", encode_tracking(tools), frame), *both(frame))

    server.say = say
    frame = read_until(active, lambda frame: validities(frame) == ["ok", "missing"])
    assert frame.tool("robot_frame").position_mm[0] >= 300.0


def test_a_position_without_a_rotation_is_no_pose(server: PlusServer, active: Any) -> None:
    def say(frame: int) -> tuple[bytes, ...]:
        tools = [
            TrackedTool(name, kind, pose_at(300.0 + jitter(frame)))
            for name, kind in (("RobotFrameToTracker", TRACKING_6D), ("XFrameToTracker", TRACKING_3D))
        ]
        return (encode_message("TDATA", "", encode_tracking(tools), frame), STATUS_OK)

    server.say = say
    frame = read_until(active, lambda frame: validities(frame) == ["ok", "corrupt"])
    assert frame.tool("x_frame").rotation is None


def test_names_that_a_server_cuts_are_told_apart_by_their_metadata(server: PlusServer) -> None:
    tools = [{**TOOLS[0], "name": "patient_frame"}]
    name = "PatientFrameToTracker"
    assert len(name) > 20
    server.push(
        lambda frame: (
            transform(f"{name}2", pose_at(1.0 + jitter(frame)), frame, IGTL_DEVICE_NAME=f"{name}2"),
            transform(name, pose_at(7.0 + jitter(frame)), frame, IGTL_DEVICE_NAME=name),
        )
    )
    tracker = make_tracker(server.endpoint, tools=tools)
    with tracker.active():
        assert tracker.read_frame().tools[0].position_mm[0] >= 7.0
    tracker.close()


def test_another_tools_pose_under_the_same_name_latches_a_fault(server: PlusServer, active: Any) -> None:
    server.say = lambda frame: (both(frame)[0], transform("RobotFrameToTracker", pose_at(-300.0), frame))
    with pytest.raises(SharedName, match=r"IGT-008.*RobotFrameToTracker"):
        read_until(active, lambda _frame: False)
    assert active.state is Lifecycle.FAULT


def test_a_wrong_check_sum_costs_a_message(server: PlusServer, active: Any) -> None:
    def say(frame: int) -> tuple[bytes, ...]:
        first, second, status = both(frame)
        return first, second[:-1] + bytes([second[-1] ^ 1]), status

    server.say = say
    frame = read_until(active, lambda frame: validities(frame) == ["ok", "missing"])
    assert frame.tool("robot_frame").validity is Validity.OK
    assert active.observe().says[0].name == "disturbed messages"


def test_bytes_of_another_protocol_latch_a_fault_that_recover_clears(server: PlusServer, active: Any) -> None:
    server.send(b"HTTP/1.1 400 Bad Request\r\n" * 4)
    with pytest.raises(StreamGarbled, match="IGT-007"):
        read_until(active, lambda _frame: False)
    assert active.state is Lifecycle.FAULT
    active.recover("Ana")
    with active.active():
        assert validities(active.read_frame()) == ["ok", "ok"]


def test_a_server_that_hangs_up_is_lost_until_recover(server: PlusServer, active: Any) -> None:
    server.hang_up()
    with pytest.raises(ServerLost, match="IGT-006"):
        read_until(active, lambda _frame: False)
    active.recover("Ana")
    assert active.state is Lifecycle.CONFIGURED


def test_a_server_that_falls_silent_is_late_first_and_then_lost(server: PlusServer, active: Any) -> None:
    server.say = lambda _frame: ()
    with pytest.raises(RonnaError, match="IGT-005"):
        read_until(active, lambda _frame: False, 0.2)
    with pytest.raises(ServerLost, match=r"IGT-006.*silent"):
        active.read_frame(5.0)
    assert active.state is Lifecycle.FAULT


def test_a_pose_in_another_frame_is_refused_at_configure(server: PlusServer) -> None:
    server.push(lambda frame: (transform("RobotFrameToReference", pose_at(jitter(frame)), frame), STATUS_OK))
    tracker = make_tracker(server.endpoint)
    tracker.connect()
    with pytest.raises(RonnaError, match=r"IGT-004.*expected RobotFrameToTracker, got RobotFrameToReferenc"):
        tracker.configure()
    tracker.close()


def test_an_unknown_tool_is_a_notice_that_names_what_is_sent(server: PlusServer) -> None:
    server.push(lambda frame: (transform("StylusToTracker", pose_at(jitter(frame)), frame), both(frame)[0]))
    tracker = make_tracker(server.endpoint)
    tracker.connect()
    tracker.configure()
    (notice,) = tracker.notices
    assert "x_frame is not sent as XFrameToTracker" in notice
    assert notice.endswith("it sends RobotFrameToTracker, StylusToTracker")
    tracker.close()


def test_the_first_query_asks_for_metadata_and_an_interval_is_never_asked_for(
    server: PlusServer, active: Any
) -> None:
    assert active.read_frame()
    query = next(message for message in server.heard if message.kind == "GET_STATUS")
    start = next(message for message in server.heard if message.kind == "STT_TDATA")
    assert query.version == 2
    assert start.version == 1  # this server has never sent version 2
    assert start.content[:4] == b"\0\0\0\0"  # PLUS takes milliseconds for seconds


def test_it_sees_tools_alone_and_says_so(server: PlusServer) -> None:
    assert not reports_strays(make_tracker(server.endpoint))


def test_nobody_at_the_address_and_a_mute_server_are_told_apart() -> None:
    with socket.create_server(("127.0.0.1", 0)) as mute:
        endpoint = f"igtl://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(RonnaError, match="IGT-002"):
            make_tracker(endpoint).connect(0.2)
    with pytest.raises(RonnaError, match="IGT-001"):
        make_tracker(endpoint).connect(0.2)


def test_the_doctor_names_what_a_server_sends(server: PlusServer) -> None:
    server.push(both)
    (found,) = probe.probe_endpoints([parse_endpoint(server.endpoint)], lambda _share: None)
    assert found.well
    assert found.seen == "sends RobotFrameToTracker, XFrameToTracker"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tools": [TOOLS[0], TOOLS[0]]}, "duplicate tool name robot_frame"),
        ({"tools": [{**TOOLS[0], "sent_as": "RobotFrameToReference"}]}, "does not end in ToTracker"),
        ({"tools": [{**TOOLS[0], "name": "frame_of_the_patient"}]}, "servers cut FrameOfThePatientToTracker"),
        (
            {"tools": [TOOLS[0], {**TOOLS[1], "sent_as": "RobotFrameToTracker"}]},
            "several tools are sent as RobotFrameToTracker",
        ),
        ({"tools": [{**TOOLS[0], "markers_mm": []}]}, "markers_mm"),
        ({"port": 18944}, "port"),
    ],
)
def test_a_mistake_in_the_options_is_named(options: dict[str, Any], words: str) -> None:
    config = DeviceConfig(driver="openigtlink_tracker", endpoint="igtl://127.0.0.1:1", options=options)
    with pytest.raises(RonnaError, match=f"IGT-003.*{words}"):
        read_options(config)
