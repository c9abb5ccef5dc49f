"""OpenIGTLink server of a case: what clients get, and what they cannot do to it or to each other."""

from __future__ import annotations

import asyncio
import socket
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from igtl_streams import spoilt_streams
from linked_case import AWAITED_S, BEGAN, EPOCH_NS, linked_case, pose

from procedures.live.errors import ADDRESS_UNUSABLE
from procedures.live.openigtlink.answers import REFUSAL
from procedures.live.openigtlink.server import MOST_CLIENTS, LinkServer, ServerOptions
from procedures.live.records import (
    DeviceStatus,
    Fiducial,
    Fiducials,
    FramePose,
    PlannedLine,
    PlannedLines,
    RunState,
)
from ronna_hw.devices.readings import Validity
from ronna_hw.wire.openigtlink import LARGEST_BODY_BYTES, Message
from ronna_hw.wire.openigtlink_contents import (
    Command,
    Subscription,
    decode_command,
    decode_status,
    decode_string,
    decode_tracking,
    decode_transform,
    encode_command,
    encode_subscription,
)

REGISTRATION = pose("robot", "ct").model_copy(update={"is_fixed": True})
IN_ROBOT = [[0, -1, 0, 10], [1, 0, 0, 20], [0, 0, 1, 30], [0, 0, 0, 1]]
IN_RAS = [[0, 1, 0, -10], [-1, 0, 0, -20], [0, 0, 1, 30], [0, 0, 0, 1]]  # from the left by diag(-1, -1, 1, 1)
TOOL_IN_RAS = [
    [1, 0, 0, 10],
    [0, 1, 0, -30],
    [0, 0, 1, 60],
    [0, 0, 0, 1],
]  # diag @ REGISTRATION @ tool in robot
LINE = PlannedLine(name="T1", entry_mm=(1.0, 2.0, 3.0), target_mm=(4.0, 5.0, 6.0))
FAULT = DeviceStatus(
    theatre_time_s=2.0, device="tracker", state="fault", code="NDI-004", text="no answer.", advice="Look."
)
SMALL_BUFFER_BYTES = 4096  # the kernel takes no less
OFTEN = ServerOptions(rate_hz=1000.0)
HIDDEN = FramePose(
    theatre_time_s=2.0,
    parent="robot",
    child="tool",
    rotation=None,
    translation_mm=None,
    validity=Validity.MISSING,
)
END = RunState(theatre_time_s=9.0, run="R1", state="finished")


def _is_end(message: Message) -> bool:
    return message.kind == "STRING" and decode_string(message.content) == "finished"


def test_matrices_into_patient_coordinates_are_ras_and_others_stay() -> None:
    with linked_case() as case, case.connect() as client:
        case.tell(REGISTRATION, pose("tool", "robot", 2.5))
        sent = {name: client.first("TRANSFORM", name) for name in ("RobotToRas", "ToolToRobot", "ToolToRas")}
        assert decode_transform(sent["ToolToRobot"].content) == pytest.approx(np.array(IN_ROBOT))
        assert decode_transform(sent["RobotToRas"].content) == pytest.approx(np.array(IN_RAS))
        assert decode_transform(sent["ToolToRas"].content) == pytest.approx(np.array(TOOL_IN_RAS))
        assert sent["ToolToRas"].stamp_ns == EPOCH_NS + 2_500_000_000


def test_a_pose_of_the_patient_is_inverted_into_patient_coordinates() -> None:
    with linked_case() as case, case.connect() as client:
        case.tell(pose("ct", "robot"))
        inverse = np.diag([-1, -1, 1, 1]) @ np.linalg.inv(np.array(IN_ROBOT))
        assert decode_transform(client.first("TRANSFORM", "RobotToRas").content) == pytest.approx(inverse)


def test_a_hidden_tool_is_silent_at_once_and_says_why_to_readers_of_metadata() -> None:
    with linked_case(OFTEN) as case, case.connect() as client, case.connect() as other:
        other.ask_for_metadata()
        case.tell(REGISTRATION, pose("tool", "robot"))
        client.first("TRANSFORM", "ToolToRas")
        other.first("TRANSFORM", "ToolToRas")
        case.tell(HIDDEN, END)
        _, before = client.until(_is_end)
        assert [one.name for one in before if one.kind == "TRANSFORM" and "Tool" in one.name] == []
        for name, matrix in (("ToolToRobot", IN_ROBOT), ("ToolToRas", TOOL_IN_RAS)):
            hidden = other.first("TRANSFORM", name)
            assert hidden.metadata == {
                "TransformStatus": "MISSING",
                "TransformValid": "0",
                "Timestamp": "1700000002.000000000",
            }
            assert decode_transform(hidden.content) == pytest.approx(np.array(matrix))


@pytest.mark.parametrize("lost", ["flange in robot", "tool in flange"])
def test_a_tool_is_no_more_valid_than_the_arm_that_carries_it(lost: str) -> None:
    flange, tool = pose("flange", "robot", 2.0), pose("tool", "flange", 1.0)
    carried = {"flange in robot": flange, "tool in flange": tool.model_copy(update={"is_fixed": True})}
    gone = {"rotation": None, "translation_mm": None, "validity": Validity.STALE, "theatre_time_s": 9.0}
    with linked_case(OFTEN) as case, case.connect() as client:
        client.ask_for_metadata()
        case.tell(REGISTRATION, *carried.values())
        for name in ("ToolToRobot", "ToolToRas"):
            found = client.first("TRANSFORM", name)
            assert (found.metadata["TransformStatus"], found.metadata["TransformValid"]) == ("OK", "1")
            assert found.metadata["Timestamp"] == "1700000002.000000000"
        case.tell(carried[lost].model_copy(update=gone), END)
        _, before = client.until(_is_end)
        states = {one.name: one.metadata["TransformStatus"] for one in before if one.kind == "TRANSFORM"}
        assert states["ToolToRobot"] == states["ToolToRas"] == "REQ_TIMEOUT"


def test_the_numbers_of_a_reading_that_is_not_valid_are_not_sent() -> None:
    partial = pose("tool", "robot", 2.0, x_mm=99.0).model_copy(update={"validity": Validity.PARTIAL})
    with linked_case(OFTEN) as case, case.connect() as client:
        client.ask_for_metadata()
        case.tell(partial, pose("tool", "robot"), partial)
        assert client.first("TRANSFORM").metadata["TransformStatus"] == "OK"
        last = client.first("TRANSFORM")
        assert last.metadata["TransformStatus"] == "INVALID"
        assert decode_transform(last.content) == pytest.approx(np.array(IN_ROBOT))


def test_a_valid_pose_that_waits_is_taken_back_when_the_tool_is_hidden() -> None:
    slow = ServerOptions(rate_hz=0.1)
    with linked_case(slow) as case, case.connect() as client:
        case.tell(*(pose("tool", "robot", 1.0 + number) for number in range(3)), HIDDEN, END)
        _, before = client.until(_is_end)
        stamps = {one.stamp_ns for one in before if one.name == "ToolToRobot"}
        assert stamps <= {EPOCH_NS + 1_000_000_000, EPOCH_NS + 2_000_000_000}  # the third was replaced


def test_a_voided_registration_voids_the_tool_in_the_patient() -> None:
    with linked_case(OFTEN) as case, case.connect() as client:
        client.ask_for_metadata()
        case.tell(REGISTRATION, pose("tool", "robot"))
        client.first("TRANSFORM", "ToolToRas")
        case.tell(HIDDEN.model_copy(update={"parent": "ct", "child": "robot"}))
        assert client.first("TRANSFORM", "ToolToRas").metadata["TransformValid"] == "0"


def test_a_new_client_gets_what_stands_and_where_the_arm_rests_but_no_tool_that_was_seen_before() -> None:
    seen = pose("robot_frame", "tracker")
    with linked_case() as case, case.connect() as first:
        case.tell(
            REGISTRATION,
            FAULT,
            PlannedLines(theatre_time_s=0.0, lines=(LINE,)),
            pose("tool", "robot"),
            seen,
            END,
        )
        first.until(_is_end)
        with case.connect() as client:
            _, before = client.until(_is_end)
            sent = {(one.kind, one.name): one for one in before}
            assert set(sent) == {
                ("TRANSFORM", "RobotToRas"),
                ("TRANSFORM", "ToolToRobot"),
                ("TRANSFORM", "ToolToRas"),
                ("STATUS", "tracker"),
                ("TRAJ", "Plan"),
                ("POINT", "Targets"),
                ("POINT", "Entries"),
            }
            line = struct.unpack(">64s32sBB4B3f3ff20s", sent["TRAJ", "Plan"].content)
            assert line[8:14] == (-1, -2, 3, -4, -5, 6)


def test_a_new_registration_places_the_tool_as_it_was_read_before() -> None:
    with linked_case(OFTEN) as case, case.connect() as client:
        case.tell(pose("tool", "robot", 1.0), REGISTRATION.model_copy(update={"theatre_time_s": 7.0}))
        placed = client.first("TRANSFORM", "ToolToRas")
        assert decode_transform(placed.content) == pytest.approx(np.array(TOOL_IN_RAS))
        assert placed.stamp_ns == EPOCH_NS + 1_000_000_000


def test_points_and_plan_are_not_repeated_until_they_change() -> None:
    plan = PlannedLines(theatre_time_s=0.0, lines=(LINE,))
    with linked_case() as case, case.connect() as client:
        case.tell(REGISTRATION, plan, FAULT)
        client.first("POINT", "Targets")
        _, before = client.until(lambda one: one.name == "tracker" and one.kind == "STATUS")
        _, before = client.until(lambda one: one.name == "tracker" and one.kind == "STATUS")  # a second later
        assert {one.kind for one in before} <= {"TRANSFORM"}
        case.tell(plan)
        client.first("POINT", "Targets")


def test_a_fault_is_a_status_with_its_advice_and_comes_again_every_second() -> None:
    with linked_case() as case, case.connect() as client:
        case.tell(FAULT)
        for _ in range(2):
            status = decode_status(client.first("STATUS", "tracker").content)
            assert (status.code, status.error) == (18, "NDI-004")
            assert status.text == "fault: no answer. Look."


def test_residuals_reach_readers_with_metadata_and_without() -> None:
    spheres = (
        Fiducial(name="S1", position_mm=(1.0, 2.0, 3.0), diameter_mm=10.0, residual_mm=0.1234, is_used=True),
        Fiducial(name="S2", position_mm=(4.0, 5.0, 6.0), diameter_mm=10.0, residual_mm=1.5, is_used=False),
    )
    with linked_case() as case, case.connect() as client:
        case.tell(Fiducials(theatre_time_s=1.0, spheres=spheres))
        points = struct.iter_unpack(">64s32s4B3ff20s", client.first("POINT", "Spheres").content)
        groups = [point[1].rstrip(b"\0") for point in points]
        assert groups == [b"used, residual 0.12 mm", b"not used, residual 1.50 mm"]
        client.send("GET_POINT", "Spheres", version=2)
        metadata = client.first("POINT", "Spheres").metadata
        assert {key: metadata[key] for key in ("S1.residual_mm", "S1.used", "S2.used")} == {
            "S1.residual_mm": "0.1234",
            "S1.used": "1",
            "S2.used": "0",
        }


def test_tracking_data_come_only_when_asked_in_the_frame_that_was_asked_for() -> None:
    with linked_case(OFTEN) as case, case.connect() as client, case.connect() as other:
        client.send("STT_TDATA", "", encode_subscription(Subscription(1, "Ras")))
        assert client.first("RTS_TDATA").content == b"\0"
        case.tell(REGISTRATION, pose("tool", "robot"))
        tools = ()
        while len(tools) < 2:
            tools = decode_tracking(client.first("TDATA").content)
        poses = {tool.name: tool.pose for tool in tools}
        assert poses["Robot"] == pytest.approx(np.array(IN_RAS))
        assert poses["Tool"] == pytest.approx(np.array(TOOL_IN_RAS))
        client.send("STP_TDATA")
        client.first("RTS_TDATA")
        client.send("STT_TDATA", "", encode_subscription(Subscription(1, "Moon")))
        assert client.first("RTS_TDATA").content == b"\1"
        case.tell(END)
        assert "TDATA" not in {one.kind for one in other.until(_is_end)[1]}


@pytest.mark.parametrize("query", ["GET_TRANS", "GET_TRANSFOR"])
def test_both_spellings_of_the_question_for_a_transform_are_answered(query: str) -> None:
    with linked_case() as case, case.connect() as client:
        case.tell(pose("tool", "robot"))
        client.first("TRANSFORM")
        client.send(query, "ToolToRobot")
        assert len(client.first("TRANSFORM", "ToolToRobot").content) == 48
        client.send(query, "MoonToRobot")
        assert client.first("TRANSFORM", "MoonToRobot").content == b""


def test_whatever_would_move_or_change_something_is_refused_in_words() -> None:
    with linked_case() as case, case.connect() as client:
        client.send("COMMAND", "Robot", encode_command(Command(7, "Move", "<Command/>")))
        assert decode_command(client.first("RTS_COMMAND", "Robot").content) == Command(
            7, "AccessDenied", REFUSAL
        )
        client.send("STRING", "CMD_12", b"")
        assert REFUSAL in decode_string(client.first("STRING", "ACK_12").content)
        client.send("TRANSFORM", "ToolToRobot", bytes(48))
        assert decode_status(client.first("STATUS").content).code == 5
        client.send("GET_NDARRAY")
        assert decode_status(client.first("STATUS").content).code == 12


def test_a_ct_that_cannot_be_read_is_told_and_other_images_are_a_null_body(tmp_path: Path) -> None:
    with linked_case(ServerOptions(ct=tmp_path / "none")) as case, case.connect() as client:
        client.send("GET_IMAGE", "CT")
        status = decode_status(client.first("STATUS").content)
        assert (status.code, status.error) == (13, "NotReadable")
        assert "CT-0" in status.text
        client.send("GET_IMAGE", "CameraLeft")
        assert client.first("IMAGE", "CameraLeft").content == b""


def test_a_wrong_check_sum_is_told_and_not_obeyed() -> None:
    with linked_case() as case, case.connect() as client:
        spoilt = bytearray(64)
        spoilt[:58] = struct.pack(">H12s20sIIQQ", 1, b"COMMAND", b"Robot", 0, 0, 6, 1)
        client.socket.sendall(spoilt)
        message, before = client.until(lambda one: one.kind == "STATUS")
        assert decode_status(message.content).code == 9
        assert before == []


@pytest.mark.parametrize(
    "garbage",
    [b"GET / HTTP/1.1\r\n\r\n" + bytes(58), struct.pack(">H48xQQ", 1, LARGEST_BODY_BYTES + 1, 0)[-58:]],
)
def test_garbage_is_told_and_ends_only_its_own_connection(garbage: bytes) -> None:
    with linked_case() as case, case.connect() as other, case.connect() as client:
        client.socket.sendall(garbage)
        messages = list(client.messages())
        assert decode_status(messages[-1].content).error == "NotOpenIGTLink"
        case.tell(END)
        other.until(_is_end)


def test_spoilt_streams_disturb_nobody() -> None:
    with linked_case() as case, case.connect() as other:
        for stream in spoilt_streams(100, seed=5):
            with case.connect() as client:
                client.socket.sendall(stream)
        case.tell(END)
        other.until(_is_end)


def test_of_eight_clients_one_never_reads_and_no_other_misses_a_pose() -> None:
    count, frames = 500, (("tool", "robot"), ("flange", "robot"), *((f"t{n}", "tracker") for n in range(4)))
    with linked_case(ServerOptions(rate_hz=1e6)) as case:
        stopped, *clients = (case.connect() for _ in range(8))
        stopped.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL_BUFFER_BYTES)
        received = Counter[int]()
        for number in range(1, count + 1):
            case.tell(*(pose(child, parent, float(number)) for child, parent in frames))
            for place, client in enumerate(clients):
                _, before = client.until(_is_pose("T3ToTracker", number))
                received[place] += len(before) + 1
        assert received == dict.fromkeys(range(7), count * len(frames))
        _, before = stopped.until(_is_pose("T3ToTracker", count))
        assert len(before) < count * len(frames) / 2  # the others were replaced while it did not read


def _is_pose(name: str, time_s: int) -> Callable[[Message], bool]:
    return lambda one: one.name == name and one.stamp_ns == EPOCH_NS + time_s * 1_000_000_000


def test_one_client_too_many_is_told_and_the_place_of_one_that_leaves_is_free() -> None:
    with linked_case() as case:
        case.tell(FAULT)
        clients = [case.connect() for _ in range(MOST_CLIENTS)]
        for client in clients:
            client.first("STATUS", "tracker")
        with case.connect_unseen() as refused:
            (status,) = refused.messages()
            assert decode_status(status.content).error == "TooManyClients"
        clients.pop().socket.close()
        admitted = False
        while not admitted:  # the server notices the end of a connection by itself
            with case.connect_unseen() as client:
                admitted = decode_status(client.first("STATUS").content).error == "NDI-004"
        for client in clients:
            client.socket.close()


def test_clients_learn_that_the_case_has_ended() -> None:
    with linked_case() as case, case.connect() as client:
        case.tell(END)
        client.until(_is_end)
        case.tell(None)
        assert decode_status(list(client.messages())[-1].content).code == 19


def test_a_name_over_twenty_bytes_is_told_and_the_others_go_on() -> None:
    with linked_case() as case, case.connect() as client:
        case.tell(pose("camera_left", "camera_right"), pose("tool", "robot"))
        status = decode_status(client.first("STATUS").content)
        assert (status.code, status.error) == (10, "LIV-010")
        assert "CameraLeftToCameraRight" in status.text
        client.first("TRANSFORM", "ToolToRobot")


@pytest.mark.parametrize("host", ["192.0.2.1", "no address"])
def test_an_address_that_cannot_be_used_is_refused(host: str) -> None:
    with raises(ADDRESS_UNUSABLE, match="cannot listen"):
        _serve_once(ServerOptions(host=host))


def test_a_port_in_use_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, raises(ADDRESS_UNUSABLE, match="in use"):
        _serve_once(ServerOptions(port=taken.getsockname()[1]))


def _serve_once(options: ServerOptions) -> None:
    async def records():  # type: ignore[no-untyped-def]  # an async generator of one record
        yield BEGAN

    async def serve() -> None:
        await LinkServer(options, lambda _line: None).serve(records(), lambda _host, _port: None)

    asyncio.run(asyncio.wait_for(serve(), AWAITED_S))
