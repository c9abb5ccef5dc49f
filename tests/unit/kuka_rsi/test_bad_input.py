"""A wrong configuration is refused before motion, with a code, a reason and an action."""

from __future__ import annotations

from typing import Any

import pytest
from coded_errors import raises
from driven_arm import THERE, activated, configured

from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.kuka_rsi.errors import (
    COMMAND_REFUSED,
    CONTEXT_UNUSABLE,
    NO_TELEGRAM,
    STREAM_ERRORS,
)
from ronna_hw.arm.errors import FORCE_NOT_SENSED
from ronna_hw.arm.pose import Pose
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import Lifecycle
from ronna_hw.devices.contact import Insertion
from ronna_hw.devices.errors import WrongState
from ronna_hw.devices.robot import JointMove
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.kuka_context import CONTEXT_INVALID


@pytest.mark.parametrize(
    ("host", "reason"),
    [("203.0.113.7", "Cannot assign requested address"), ("nowhere.invalid", "no such address")],
)
def test_configure_reports_a_stream_address_that_is_not_this_computers(
    controller: Any, host: str, reason: str
) -> None:
    endpoints = {"rsi": f"udp://{host}:59152", "eki_project": f"tcp://127.0.0.1:{controller.eki_port}"}
    arm = KukaRsiArm("robot.master", DeviceConfig(driver="kuka_rsi", endpoints=endpoints), HostClock())
    arm.connect()
    with raises(STREAM_ERRORS.not_started, match=f"{host}.*{reason}") as caught:
        arm.configure()
    assert "subnet of the controller's RSI interface" in caught.value.advice
    arm.close()
    assert not controller.replies


@pytest.mark.hazard(34)
def test_telegrams_from_another_host_than_the_configured_one_open_no_session(
    controller: Any, make_arm: Any
) -> None:
    arm = configured(make_arm(controller_host="127.0.0.9"))
    with raises(
        NO_TELEGRAM, match=r"came from elsewhere, the last from 127.0.0.1; expected telegrams of 127.0.0.9"
    ):
        arm.activate(timeout_s=1.0)
    assert arm.state is Lifecycle.FAULT
    assert not controller.replies


def test_telegrams_from_the_configured_host_are_answered(controller: Any, make_arm: Any) -> None:
    arm = activated(make_arm(controller_host="127.0.0.1"))
    arm.move(JointMove(THERE))
    assert controller.replies


@pytest.mark.parametrize(
    "options",
    [
        {"variant": "kr6_r900_2"},
        {"context": "/nowhere/context.toml"},
    ],
)
def test_options_that_do_not_fit_the_context_are_refused_at_once(make_arm: Any, options: Any) -> None:
    with raises(CONTEXT_UNUSABLE, CONTEXT_INVALID):
        make_arm(**options)


def test_a_second_client_of_the_controller_gets_no_answer(active_arm: Any, make_arm: Any) -> None:
    with raises(STREAM_ERRORS.not_found):
        make_arm().connect(timeout_s=0.5)
    active_arm.move(JointMove(THERE))  # the first one is not disturbed


# Everything that is no motion


def test_tool_and_base_can_be_set_only_at_rest(controller: Any, make_arm: Any) -> None:
    arm = configured(make_arm())
    arm.controller.set_tool(2, Pose.from_kuka(0, 0, 150, 0, 0, 0), mass_kg=1.2)
    arm.controller.set_base(1, Pose())
    arm.controller.set_override(50)
    assert controller.commands[-3:] == ["SET_TOOL", "SET_BASE", "SET_OV"]
    assert arm.controller.state().tool == 2
    controller.ack_codes["SET_OV"] = 2
    with raises(COMMAND_REFUSED, match="SET_OV"):
        arm.controller.set_override(500)
    arm.activate()
    with pytest.raises(WrongState):
        arm.controller.set_tool(2, Pose(), mass_kg=1.2)


@pytest.mark.hazard(56)
def test_an_insertion_with_a_force_limit_is_refused_by_an_arm_that_senses_none(make_arm: Any) -> None:
    target = Transform.of(Frame.ROBOT, Frame.TOOL)
    insertion = Insertion(target, Transform.of(Frame.FLANGE, Frame.TOOL), force_limit_N=15.0)
    with raises(FORCE_NOT_SENSED, match="15 N"):
        make_arm().insert(insertion)
