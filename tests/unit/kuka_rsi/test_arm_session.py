"""Sessions of the driver with a fake controller, from connect to close, and their recorded bytes."""

from __future__ import annotations

import os
import re
import time
from concurrent.futures import ThreadPoolExecutor
from threading import current_thread
from typing import Any

import numpy as np
import pytest
from coded_errors import raises
from driven_arm import MODEL, THERE, largest_step, moving
from fake_controller import FakeController
from recorded_bytes import RecordedBytes
from waiting import HANG_LIMIT_S

from drivers.kuka_rsi.errors import NO_TELEGRAM
from drivers.kuka_rsi.fault_watch import FaultWatch
from ronna_hw.devices import LastKnown, Lifecycle
from ronna_hw.devices.capabilities import Direction, RecordsBytes
from ronna_hw.devices.readings import Validity
from ronna_hw.devices.robot import JointMove, LineMove
from ronna_hw.frames import Frame, Transform


def test_a_session_runs_from_connect_to_close(controller: Any, make_arm: Any) -> None:
    arm = make_arm()
    identity = arm.connect()
    assert (identity.vendor, identity.model) == ("KUKA", "kr6_r900_sixx")
    assert arm.read_state().commanded_rad is None
    assert arm.read_tool_identity().number == 2
    arm.configure()
    arm.activate()
    assert arm.state is Lifecycle.ACTIVE
    reading = arm.move(JointMove(THERE))
    assert reading.joints_rad == pytest.approx(THERE, abs=4e-6)
    assert reading.commanded_rad == THERE
    assert not reading.moving
    assert reading.validity is Validity.OK
    tool = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(0.0, 0.0, 100.0))
    here = MODEL.flange_pose(THERE) @ tool
    target = Transform.of(
        Frame.ROBOT,
        Frame.TOOL,
        translation_mm=np.add(here.translation_mm, (0.0, 20.0, 0.0)),
        quaternion_wxyz=here.quaternion_wxyz,
    )
    reading = arm.move(LineMove(target, flange_from_tool=tool))
    reached = MODEL.flange_pose(reading.joints_rad) @ tool
    assert reached.translation_mm == pytest.approx(target.translation_mm, abs=0.01)
    statistics = arm.link_statistics()
    assert statistics.cycles > 100
    assert statistics.lost_cycles == statistics.late_cycles == statistics.rejected_telegrams == 0
    assert sum(statistics.histogram_counts) == statistics.cycles
    assert len(statistics.histogram_edges_us) == len(statistics.histogram_counts) + 1
    assert 0 < statistics.turnaround_median_us <= statistics.turnaround_p99_us
    arm.deactivate()
    assert arm.state is Lifecycle.CONFIGURED
    assert controller.facts["RSI"] == "0"
    arm.close()
    assert arm.state is Lifecycle.CLOSED
    arm.close()


def test_observe_works_in_every_state_from_any_thread_without_checking_for_faults(
    make_arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_in: list[str] = []  # names of threads; the reader of the EKI channel looks by itself

    arm = make_arm()
    assert arm.observe() == LastKnown(Lifecycle.DISCONNECTED, None, None)
    arm.connect()
    asked = arm.read_state()
    assert arm.observe().reading.joints_rad == asked.joints_rad
    arm.configure()
    arm.activate()
    arm.move(JointMove(THERE))
    with monkeypatch.context() as patch:
        patch.setattr(FaultWatch, "check", lambda _watch: looked_in.append(current_thread().name))
        with ThreadPoolExecutor(thread_name_prefix="observer") as elsewhere:
            seen = elsewhere.submit(arm.observe).result()
    assert not [name for name in looked_in if name.startswith("observer")]
    assert seen.state is Lifecycle.ACTIVE
    assert seen.reading.commanded_rad == THERE
    arm.close()
    assert arm.observe().state is Lifecycle.CLOSED
    assert arm.observe().reading.commanded_rad == THERE


def test_a_move_to_the_current_position_returns_the_settled_reading(active_arm: Any) -> None:
    here = active_arm.read_state().commanded_rad
    assert active_arm.move(JointMove(here)).commanded_rad == here


def test_close_is_bounded_when_the_controller_is_gone(controller: Any, active_arm: Any) -> None:
    controller.silent.set()
    controller.drop_eki()
    begun = time.monotonic()
    active_arm.close()
    assert time.monotonic() - begun < HANG_LIMIT_S
    assert active_arm.state is Lifecycle.CLOSED


@pytest.mark.slow
def test_close_during_motion_brings_the_arm_to_rest_and_ends_the_program(
    controller: Any, active_arm: Any
) -> None:
    thread, caught = moving(active_arm, controller)
    active_arm.close()
    thread.join()
    assert caught
    assert controller.facts["RSI"] == "0"
    assert controller.replies[-1][2] == 1
    assert controller.replies[-1][1] == controller.replies[-2][1]
    assert largest_step(controller.replies) < 1 / 8


def test_close_leaves_no_process(active_arm: Any) -> None:
    pid = active_arm.connections.open_link.process.pid
    active_arm.close()
    assert not os.path.exists(f"/proc/{pid}")


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
    assert b"<Cmd Id=" in sink.sent("robot.master.eki")
    assert b"<State" in sink.received("robot.master.eki")


def test_the_real_time_process_keeps_no_bytes_without_a_recorder(make_arm) -> None:
    arm = make_arm()
    with arm.active():
        assert arm.connections.link.mailbox.fetch_kept() == ([], 0)


def test_a_telegram_of_another_type_is_reported_gets_no_reply_and_is_recorded_too(
    make_arm, controller: FakeController
) -> None:
    arm, sink = make_arm(), RecordedBytes()
    arm.record_bytes(sink)
    controller.root_type = "OTHER"
    arm.connect()
    arm.configure()
    with raises(NO_TELEGRAM, match="were malformed or of another Type"):
        arm.activate(timeout_s=0.5)
    arm.close()
    assert {direction for direction, _ in sink.by_link["robot.master.rsi"]} == {Direction.RECEIVED}
