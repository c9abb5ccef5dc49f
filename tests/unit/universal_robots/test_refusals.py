"""What a controller must be before anything is started on it, and what it is told otherwise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from coded_errors import raises
from handmade_ur import UR5E_A, HandmadeController

from drivers.kuka_rsi.arm import KukaRsiArm
from drivers.universal_robots import power as ur_power
from drivers.universal_robots.arm import UniversalRobotsArm
from drivers.universal_robots.errors import BAD_OPTIONS, CONTROLLER_EXCHANGED, NOT_POWERED, STREAM_ERRORS
from drivers.universal_robots.rtde import RtdeSetup
from ronna_hw.arm_stream.control_channel import open_connection
from ronna_hw.clock import HostClock
from ronna_hw.config import BadTheatreFile, DeviceConfig
from ronna_hw.devices import Lifecycle, StopKind
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.errors import RonnaError

LIMIT_S = 5.0


@pytest.fixture
def controller() -> Iterator[HandmadeController]:
    made = HandmadeController()
    yield made
    made.close()


class FreeClock(HostClock):
    """Clock that notes how much time it is allowed to let pass."""

    def __init__(self) -> None:
        super().__init__()
        self.allowed_s: list[float] = []

    def let_pass(self, duration_s: float) -> None:
        self.allowed_s.append(duration_s)


def make_arm(
    controller: HandmadeController, clock: HostClock | None = None, **options: Any
) -> UniversalRobotsArm:
    config = DeviceConfig(driver="universal_robots", endpoints=controller.endpoints, options=options)
    return UniversalRobotsArm("robot.master", config, clock or HostClock())


def refused(controller: HandmadeController, **options: Any) -> RonnaError:
    """Return why the arm cannot be connected."""
    arm = make_arm(controller, **options)
    with pytest.raises(RonnaError) as raised:
        arm.connect(LIMIT_S)
    assert arm.state is Lifecycle.DISCONNECTED
    arm.close()
    return raised.value


def test_connecting_reads_identity_calibration_joints_and_inputs(controller: HandmadeController) -> None:
    controller.digital_inputs = 0b10_0110
    arm = make_arm(controller, serial="20265500001")
    identity = arm.connect(LIMIT_S)
    assert (identity.model, identity.serial, identity.firmware) == ("ur5e", "20265500001", "5.11.5.1010327")
    assert arm.read_state().joints_rad == (0.0, -1.5, -1.5, -1.5, 1.5, -1.5)
    assert arm.read_tool_identity().number == 0b0110
    fingerprint = dict(identity.details)["calibration"]
    arm.close()
    make_again = make_arm(controller, calibration=fingerprint)
    make_again.connect(LIMIT_S)
    make_again.close()


def test_a_reading_lets_no_more_theatre_time_pass_than_a_period_of_the_state(
    controller: HandmadeController,
) -> None:
    # What a case finds must not depend on how long its host took to read.
    clock = FreeClock()
    arm = make_arm(controller, clock)
    arm.connect(LIMIT_S)
    clock.allowed_s.clear()
    arm.read_state(LIMIT_S)
    arm.read_tool_identity(LIMIT_S)
    arm.close()
    assert clock.allowed_s == [0.1, 0.1]


def test_the_factory_calibration_is_that_of_the_kinematics(controller: HandmadeController) -> None:
    controller.a = (0.0, -0.4253, *UR5E_A[2:])
    measured, nominal = make_arm(controller), make_arm(controller, factory_calibration=False)
    poses = []
    for arm in (measured, nominal):
        arm.connect(LIMIT_S)
        poses.append(arm.kinematics.forward((0.0,) * 6))
        arm.close()
    assert poses[0].distance_mm(poses[1]) == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize(
    ("change", "options", "code"),
    [
        ({"answers": {"get robot model": "UR10"}}, {}, "URD-003"),
        ({"version": (3, 15, 8, 1)}, {}, "URD-003"),
        ({}, {"model": "ur5"}, "URD-003"),
        ({}, {"serial": "1"}, "URD-003"),
        ({"version": (5, 5, 1, 1)}, {}, "URD-004"),
        ({"version": (3, 8, 0, 1)}, {"model": "ur5"}, "URD-004"),
        ({"protocol_accepted": 0}, {}, "URD-004"),
        ({"output_types": "DOUBLE" + ",NOT_FOUND" * 13}, {}, "URD-004"),
        ({"output_types": "DOUBLE" + ",DOUBLE" * 13}, {}, "URD-016"),
        ({"output_types": "DOUBLE"}, {}, "URD-016"),
        ({}, {"calibration": "0123456789abcdef"}, "URD-005"),
        ({"a": (0.0, -0.6127, -0.5716, 0.0, 0.0, 0.0)}, {}, "ARM-010"),
        ({"banner": b"SSH-2.0-OpenSSH\r\n"}, {}, "URD-002"),
        ({"spoil": lambda data: b"HTTP/1.1 400\r\n"}, {}, "URD-016"),
        ({"spoil": lambda data: data[:5] + b"\xff" * 4 + data[9:]}, {}, "URD-016"),
    ],
)
def test_another_arm_version_calibration_or_service_is_refused(
    controller: HandmadeController, change: dict[str, Any], options: dict[str, Any], code: str
) -> None:
    for name, value in change.items():
        if name == "answers":
            controller.answers.update(value)
        else:
            setattr(controller, name, value)
    assert refused(controller, **options).code == code


def test_the_model_is_told_apart_by_the_software_where_the_dashboard_calls_both_alike(
    controller: HandmadeController,
) -> None:
    assert refused(controller, model="ur5").got == (
        "ur5e: the dashboard calls both generations UR5, and software 5.11.5.1010327 is that of an e-Series "
        "controller"
    )


def test_all_missing_endpoints_are_named_at_once_and_a_misspelt_one_is_recognized() -> None:
    here = "tcp://127.0.0.1:1"
    config = DeviceConfig(driver="universal_robots", endpoints={"rtde": here, "dashbord": here})
    with pytest.raises(BadTheatreFile) as raised:
        UniversalRobotsArm("robot.master", config, HostClock())
    assert "dashbord is unknown (did you mean 'dashboard'?)" in raised.value.what
    assert raised.value.expected == (
        'dashboard = "tcp://192.168.56.101:29999", primary = "tcp://192.168.56.101:30001"'
    )


@pytest.mark.parametrize(
    ("made", "options", "endpoints", "code"),
    [
        (KukaRsiArm, {"model": "ur5e"}, ("rtde", "dashboard", "primary"), "RSI-013"),
        (UniversalRobotsArm, {"variant": "kr6_r900_sixx"}, ("rsi", "eki_project"), "URD-001"),
    ],
)
def test_a_driver_of_another_make_names_wrong_options_and_endpoints_at_once(
    made: Any, options: dict[str, Any], endpoints: tuple[str, ...], code: str
) -> None:
    here = dict.fromkeys(endpoints, "tcp://127.0.0.1:1")
    config = DeviceConfig(driver="another", endpoints=here, options=options)
    option = next(iter(options))
    with pytest.raises(RonnaError, match=f"{code}: .*{option}: unknown key.* or the driver") as raised:
        made("robot.master", config, HostClock())
    assert f"endpoint {endpoints[0]} is unknown" in raised.value.what
    assert raised.value.got == ", ".join(endpoints)


def test_an_address_where_nothing_answers_is_refused(controller: HandmadeController) -> None:
    controller.endpoints["rtde"] = "tcp://127.0.0.1:1"
    error = refused(controller)
    assert (error.code, error.limit) == ("URD-002", "")
    assert "(connection refused)" in error.what
    controller.endpoints["dashboard"] = controller.endpoints["primary"]
    assert refused(controller).code == "URD-002"


def test_an_address_that_is_silent_is_refused_with_the_time_that_was_waited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def time_out(*_given: object) -> None:
        raise TimeoutError("timed out")

    monkeypatch.setattr("socket.create_connection", time_out)
    with raises(STREAM_ERRORS.not_found, match=r"\(timed out\); limit 3 s\."):
        open_connection("192.0.2.1", 29999, 2.99842, STREAM_ERRORS.not_found)


@pytest.mark.parametrize("other", ["serial", "calibration"])
def test_a_recovery_does_not_take_another_arm_for_the_one_that_was_connected(
    controller: HandmadeController, other: str
) -> None:
    arm = make_arm(controller)
    arm.connect(LIMIT_S)
    arm._watch.latch(STREAM_ERRORS.lost("the connection broke"))
    kinematics = arm.kinematics
    arm.connections.close_control()
    if other == "serial":
        controller.answers["get serial number"] = "20990000002"
    else:
        controller.a = (0.0, -0.4253, *UR5E_A[2:])
        controller.checksums = (7, 2, 3, 4, 5, 6)
    with raises(CONTROLLER_EXCHANGED):
        arm.recover("Ann", LIMIT_S)
    assert arm.state is Lifecycle.FAULT
    assert arm.kinematics is kinematics
    arm.close()


@pytest.mark.parametrize(
    ("answers", "code"),
    [
        pytest.param({"is in remote control": "false"}, "URD-006", marks=pytest.mark.hazard(55)),
        ({"safetymode": "Safetymode: ROBOT_EMERGENCY_STOP"}, "URD-007"),
        ({"robotmode": "Robotmode: POWER_OFF"}, "URD-008"),
        ({"safetymode": "Safetymode: PROTECTIVE_STOP"}, "URD-009"),
        ({"safetymode": "Safetymode: SAFEGUARD_STOP"}, "URD-010"),
        ({"safetymode": "Safetymode: FAULT"}, "URD-010"),
        ({"running": "Program running: true"}, "URD-013"),
        ({"robotmode": "Robotmode: SLEEPING"}, "URD-016"),
        ({"robotmode": "Robotmode: POWER_OFF", "power on": "No"}, "URD-017"),
    ],
)
def test_a_controller_that_is_not_ready_is_not_started(
    controller: HandmadeController, answers: dict[str, str], code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_power, "POWER_LIMIT_S", 0.05)
    arm = make_arm(controller)
    arm.connect(LIMIT_S)
    controller.answers.update(answers)
    with pytest.raises(RonnaError) as raised:
        arm.connections.start_stream(LIMIT_S, arm.limits)
    assert raised.value.code == code
    arm.close()


@pytest.mark.hazard(53)
def test_an_arm_that_is_being_switched_off_on_request_is_not_started_before_it_is_off(
    controller: HandmadeController, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_power, "POWER_LIMIT_S", 0.05)
    arm = make_arm(controller)
    arm.connect(LIMIT_S)
    arm.configure(LIMIT_S)
    controller.answers["power off"] = "Powering off"
    arm.stop(StopKind.DRIVES_OFF)
    with raises(NOT_POWERED, match="being switched off on request"):
        arm.activate(LIMIT_S)
    assert arm.state is Lifecycle.FAULT
    assert not {"power on", "brake release"} & set(controller.asked)
    controller.answers["robotmode"] = "Robotmode: POWER_OFF"
    arm.recover("Ann", LIMIT_S)
    assert arm.state is Lifecycle.CONFIGURED
    with raises(NOT_POWERED, match="was not switched on"):  # this controller never does
        arm.activate(LIMIT_S)
    assert "power on" in controller.asked
    arm.close()


@pytest.mark.hazard(52)
def test_a_speed_slider_at_zero_is_refused_and_reported(controller: HandmadeController) -> None:
    controller.speed_fraction = 0.0
    arm = make_arm(controller)
    arm.connect(LIMIT_S)
    assert [fact.name for fact in arm.readiness() if not fact.ready] == ["speed slider"]
    with pytest.raises(RonnaError) as raised:
        arm.connections.start_stream(LIMIT_S, arm.limits)
    assert raised.value.code == "URD-011"
    arm.close()


@pytest.mark.hazard(54)
def test_registers_of_another_client_are_refused(controller: HandmadeController) -> None:
    controller.input_types = controller.input_types.replace("DOUBLE", "IN_USE")
    endpoint = parse_endpoint(controller.endpoints["rtde"])
    setup = RtdeSetup(endpoint.host, endpoint.port, LIMIT_S)
    with pytest.raises(RonnaError) as raised:
        setup.set_up_inputs()
    assert raised.value.code == "URD-012"
    assert "input_double_register_24" in str(raised.value)
    setup.close()


@pytest.mark.hazard(53)
def test_a_protective_stop_is_released_in_the_name_of_a_person_when_the_controller_permits_it(
    controller: HandmadeController,
) -> None:
    arm = make_arm(controller)
    arm.connect(LIMIT_S)
    controller.answers["safetymode"] = "Safetymode: PROTECTIVE_STOP"
    controller.answers["unlock protective stop"] = "Cannot unlock protective stop until 5s after occurrence."
    with pytest.raises(RonnaError) as raised:
        arm.connections.acknowledge("Ann", deadline=0.0)
    assert raised.value.code == "URD-009"
    assert "addToLog protective stop released by Ann" in controller.asked
    arm.close()


@pytest.mark.parametrize(
    "options",
    [
        {"model": "ur10"},
        {"speed": 1},
        {"tool_inputs": [18]},
        {"tool_inputs": []},
        {"lookahead_s": 0.01},
        {"speed_fraction": 0.9},
        {"line_speed_mm_s": 0.25},
    ],
)
def test_bad_options_are_listed(controller: HandmadeController, options: dict[str, Any]) -> None:
    with raises(BAD_OPTIONS):
        make_arm(controller, **options)
