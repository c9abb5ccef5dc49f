"""An arm under the names of CRTK: metres and radians, states, and a stamp of 0 for what is not known."""

from __future__ import annotations

import pytest
from coded_errors import raises
from ideal_arm import Controller, IdealArm

from ronna_hw.arguments import WrongArgument
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.crtk import NO_STAMP, Crtk
from ronna_hw.devices.errors import WrongState

HOME_RAD = IdealArm.kinematics.home_rad
AWAY_RAD = (*HOME_RAD[:5], HOME_RAD[5] - 0.3)


@pytest.fixture
def arm() -> IdealArm:
    class Arm(IdealArm):
        controller = Controller(HOME_RAD)

    arm = Arm("robot.master", DeviceConfig(driver="ideal", endpoint="host:"), HostClock())
    arm.connect()
    return arm


def test_what_the_arm_has_not_reported_has_no_stamp(arm: IdealArm) -> None:
    crtk = Crtk(arm)
    assert crtk.measured_js() == (NO_STAMP, IdealArm.kinematics.axis_names, (0.0,) * 6)
    assert crtk.measured_cp().stamp_s == NO_STAMP
    assert crtk.operating_state() == ("DISABLED", False, False)


def test_an_arm_that_does_not_stream_has_measured_joints_and_no_set_point(arm: IdealArm) -> None:
    reading, crtk = arm.read_state(), Crtk(arm)
    assert crtk.measured_js() == (reading.stamp.theatre_time_s, IdealArm.kinematics.axis_names, HOME_RAD)
    assert crtk.setpoint_js().stamp_s == NO_STAMP


def test_motions_take_radians_and_metres_and_are_waited_for(arm: IdealArm) -> None:
    crtk = Crtk(arm)
    with arm.active():
        crtk.move_jp(AWAY_RAD).wait()
        assert crtk.measured_js().position_rad == pytest.approx(AWAY_RAD)
        assert crtk.setpoint_js().position_rad == pytest.approx(AWAY_RAD)
        here = crtk.measured_cp()
        assert [1000.0 * value for value in here.position_m] == pytest.approx(
            IdealArm.kinematics.forward(AWAY_RAD).position_mm
        )
        x, y, z = here.position_m
        crtk.move_cp((x, y, z - 0.01), here.rotation_wxyz).wait()
        assert crtk.measured_cp().position_m == pytest.approx((x, y, z - 0.01), abs=1e-6)
        assert crtk.operating_state() == ("ENABLED", True, False)


def test_an_arm_on_hold_is_paused_and_refuses_a_motion_when_it_is_waited_for(arm: IdealArm) -> None:
    crtk = Crtk(arm)
    with arm.active():
        arm.stop()
        assert crtk.operating_state().state == "PAUSED"
        moving = crtk.move_jp(AWAY_RAD)
        with pytest.raises(WrongState):
            moving.wait()


def test_no_joint_angles_are_refused_at_once(arm: IdealArm) -> None:
    with raises(WrongArgument):
        Crtk(arm).move_jp("home")  # type: ignore[arg-type]
