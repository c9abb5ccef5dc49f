"""ur-rtde: its receive, control, I/O, dashboard and script interfaces."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from dashboard_client import DashboardClient  # type: ignore[import-not-found]
from rtde_control import RTDEControlInterface  # type: ignore[import-not-found]
from rtde_io import RTDEIOInterface  # type: ignore[import-not-found]
from rtde_receive import RTDEReceiveInterface  # type: ignore[import-not-found]
from script_client import ScriptClient  # type: ignore[import-not-found]
from simulated_peer import eventually, inject

ARM = os.environ["ARM"]
SPEED, ACCELERATION = 1.0, 5.0
CYCLE_S, LOOKAHEAD_S, GAIN = 0.002, 0.03, 500


def are_near(values: Sequence[float], wanted: Sequence[float], limit: float = 1e-6) -> bool:
    return max(abs(a - b) for a, b in zip(values, wanted, strict=True)) < limit


def connected() -> tuple[Any, Any]:
    return RTDEReceiveInterface(ARM), RTDEControlInterface(ARM)


def dashboard() -> Any:
    client = DashboardClient(ARM)
    client.connect()
    return client


def turned(joints: Sequence[float], by_rad: float = 0.1) -> list[float]:
    return [joints[0] + by_rad, *joints[1:]]


def succeeds(action: Callable[[], object]) -> bool:
    try:
        action()
    except RuntimeError:
        return False
    return True


def reads_joints_and_pose() -> None:
    receive = RTDEReceiveInterface(ARM)
    assert len(receive.getActualQ()) == 6
    assert any(receive.getActualTCPPose()[:3])


def moves_to_joints() -> None:
    receive, control = connected()
    goal = turned(receive.getActualQ())
    assert control.moveJ(goal, SPEED, ACCELERATION)
    assert eventually(lambda: are_near(receive.getActualQ(), goal))


def moves_along_a_line() -> None:
    receive, control = connected()
    goal = receive.getActualTCPPose()
    goal[2] += 0.02
    assert control.moveL(goal, 0.5, ACCELERATION)
    assert eventually(lambda: are_near(receive.getActualTCPPose()[:3], goal[:3]))


def streams_joints() -> None:
    receive, control = connected()
    start = receive.getActualQ()
    for number in range(40):
        began = control.initPeriod()
        control.servoJ(turned(start, -0.001 * number), 0, 0, CYCLE_S, LOOKAHEAD_S, GAIN)
        control.waitPeriod(began)
    assert eventually(lambda: are_near(receive.getActualQ(), turned(start, -0.039)))


def streams_speeds() -> None:
    receive, control = connected()
    for _ in range(40):
        began = control.initPeriod()
        control.speedJ([0.1, 0, 0, 0, 0, 0], ACCELERATION, CYCLE_S)
        control.waitPeriod(began)
    assert eventually(lambda: abs(receive.getTargetQd()[0] - 0.1) < 1e-6)


def stops_a_motion() -> None:
    receive, control = connected()
    control.moveJ(turned(receive.getActualQ(), 1.0), SPEED, 1.0, True)
    assert eventually(lambda: receive.getActualQd()[0] > 0.01)
    control.stopJ(10.0)
    assert eventually(lambda: are_near(receive.getTargetQd(), [0.0] * 6))


def computes_the_inverse_kinematics() -> None:
    receive, control = connected()
    found = control.getInverseKinematics(receive.getActualTCPPose())
    assert are_near(found, receive.getActualQ(), 1e-4)


def computes_the_forward_kinematics_of_now() -> None:
    receive, control = connected()
    assert are_near(control.getForwardKinematics()[:3], receive.getActualTCPPose()[:3], 1e-5)


def computes_the_forward_kinematics_of_joints() -> None:
    receive, control = connected()
    goal = turned(receive.getActualQ())
    control.moveJ(goal, SPEED, ACCELERATION)
    assert eventually(lambda: are_near(receive.getActualQ(), goal))
    found = control.getForwardKinematics(goal, [0.0] * 6)
    assert are_near(found[:3], receive.getActualTCPPose()[:3], 1e-3), "after a moveJ it is metres off"


def sets_the_tool_centre_point() -> None:
    _, control = connected()
    control.setTcp([0, 0, 0.1, 0, 0, 0])
    assert are_near(control.getTCPOffset(), [0, 0, 0.1, 0, 0, 0])


def switches_an_output() -> None:
    receive = RTDEReceiveInterface(ARM)
    RTDEIOInterface(ARM).setStandardDigitalOut(1, True)
    assert eventually(lambda: receive.getDigitalOutState(1))


def slows_by_the_speed_slider() -> None:
    receive = RTDEReceiveInterface(ARM)
    RTDEIOInterface(ARM).setSpeedSlider(0.5)
    assert eventually(lambda: receive.getTargetSpeedFraction() == 0.5)


def sends_a_script() -> None:
    receive, script = RTDEReceiveInterface(ARM), ScriptClient(ARM, 5, 11)
    script.connect()
    script.sendScriptCommand("sec outputs():\nset_digital_out(0, True)\nend\n")
    assert eventually(lambda: receive.getDigitalOutState(0))


def reads_mode_and_remote_control() -> None:
    client = dashboard()
    assert client.robotmode() == "Robotmode: RUNNING"
    assert client.isInRemoteControl()


def powers_off_and_on() -> None:
    client = dashboard()
    client.powerOff()
    assert eventually(lambda: client.robotmode() == "Robotmode: POWER_OFF")
    client.powerOn()
    assert eventually(lambda: client.robotmode() == "Robotmode: IDLE")
    client.brakeRelease()
    assert eventually(lambda: client.robotmode() == "Robotmode: RUNNING")


def tells_a_protective_stop() -> None:
    receive, control = connected()
    inject("ur protective stop")
    assert eventually(receive.isProtectiveStopped)
    assert not control.isProgramRunning()


def moves_again_after_a_protective_stop() -> None:
    client, (receive, control) = dashboard(), connected()
    inject("ur protective stop")
    assert eventually(receive.isProtectiveStopped)
    assert eventually(lambda: succeeds(client.unlockProtectiveStop) and not receive.isProtectiveStopped())
    client.stop()
    control.reuploadScript()
    assert eventually(control.isProgramRunning)
    assert control.moveJ(turned(receive.getActualQ()), SPEED, ACCELERATION)


def tells_an_emergency_stop() -> None:
    receive = RTDEReceiveInterface(ARM)
    inject("ur emergency stop pressed")
    assert eventually(receive.isEmergencyStopped)


def tells_that_the_controller_has_gone() -> None:
    receive = RTDEReceiveInterface(ARM)
    inject("ur cable pulled")
    seen_s = receive.getTimestamp()
    assert eventually(lambda: not receive.isConnected()), "it goes on to show the last state"
    assert receive.getTimestamp() >= seen_s


def reconnects_after_a_cut() -> None:
    receive = RTDEReceiveInterface(ARM)
    inject("ur cut connections")
    assert eventually(lambda: not receive.isConnected()), "it does not notice that its connection was closed"
    assert receive.reconnect()
    assert any(receive.getActualQ())


def reads_a_controller_of_the_generation_before() -> None:
    receive, control = connected()
    assert control.moveJ(turned(receive.getActualQ()), SPEED, ACCELERATION)
