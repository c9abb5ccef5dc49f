"""The bytes of both links of the arm are recorded as the controller sends and receives them."""

import re

import pytest
from fake_controller import FakeController
from recorded_bytes import RecordedBytes

from drivers.kuka_rsi.errors import NoTelegram
from ronna_hw.devices.capabilities import Direction, RecordsBytes


def test_telegrams_replies_and_the_eki_session_are_recorded(make_arm, controller: FakeController) -> None:
    arm, sink = make_arm(), RecordedBytes()
    assert isinstance(arm, RecordsBytes)
    arm.record_bytes(sink)
    with arm.active():
        arm.read_tool_identity()
    arm.close()
    cycles = [ipoc for ipoc, _, _ in controller.replies]
    assert len(cycles) > 10
    answered = re.findall(rb"<IPOC>(\d+)</IPOC></Sen>", sink.sent("robot.master.rsi"))
    assert [int(ipoc) for ipoc in answered] == cycles
    said = re.findall(rb"<IPOC>(\d+)</IPOC></Rob>", sink.received("robot.master.rsi"))
    assert set(answered) <= set(said)
    assert b'<Cmd Id="1"' in sink.sent("robot.master.eki")
    assert b"<State" in sink.received("robot.master.eki")


def test_the_real_time_process_keeps_no_bytes_without_a_recorder(make_arm) -> None:
    arm = make_arm()
    with arm.active():
        assert arm._connections.link._mailbox.fetch_kept() == ([], 0)


def test_a_telegram_without_a_reply_is_recorded_too(make_arm, controller: FakeController) -> None:
    arm, sink = make_arm(), RecordedBytes()
    arm.record_bytes(sink)
    controller.root_type = "OTHER"
    arm.connect()
    arm.configure()
    with pytest.raises(NoTelegram):
        arm.activate(timeout_s=0.5)
    arm.close()
    assert {direction for direction, _ in sink.by_link["robot.master.rsi"]} == {Direction.RECEIVED}
