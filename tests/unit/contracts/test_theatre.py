"""A theatre of test devices, found by entry point like any installed driver."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises
from force_sensor import DECLARED, ForceSensor, ScaledForceSensor, install
from ideal_device import IdealDevice

from ronna_hw import Theatre, open_theatre, simulated_theatre
from ronna_hw.arguments import WrongArgument
from ronna_hw.clock import Clock, HostClock
from ronna_hw.config import BadTheatreFile, DeviceConfig, parse_theatre
from ronna_hw.devices import Lifecycle, RobotArm, StopKind
from ronna_hw.devices.errors import THEATRE_CLOSED, WRONG_KIND, NotInTheatre
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import ConnectError

FILE = f"""
theatre = "lab"
robot.left = {{ driver = "arm", endpoint = "tcp://127.0.0.1:2" }}
robot.right = {{ driver = "arm", endpoint = "tcp://127.0.0.1:3" }}
{DECLARED}"""
HAPPENED: list[str] = []


class Arm(IdealDevice):
    """Has every name of `RobotArm`, and can be stopped."""

    locals().update({name: lambda *_: None for name in vars(RobotArm) if not name.startswith("_")})

    def __init__(self, name: str, config: DeviceConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, known=set())

    observe = IdealDevice.observe

    def connect(self, timeout_s: float = 10.0) -> Identity:
        self.guard.enter(Lifecycle.CONNECTED)
        return Identity("Lab", "A1", "7", "1.0")

    def stop(self, kind: StopKind = StopKind.HOLD, timeout_s: float = 5.0) -> None:
        HAPPENED.append(f"stop {self.name}")
        self.guard.enter(Lifecycle.HOLD)


@pytest.fixture(autouse=True)
def installed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Install the drivers; returns what happens to their devices."""
    install(monkeypatch, force=ScaledForceSensor, arm=Arm)
    HAPPENED.clear()
    close = IdealDevice.close

    def closed(device: IdealDevice) -> None:
        HAPPENED.append(f"close {device.name}")
        close(device)

    monkeypatch.setattr(IdealDevice, "close", closed)
    return HAPPENED


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text(FILE)
    return path


def test_a_device_of_another_kind_is_declared_opened_and_read(path: Path) -> None:
    with open_theatre(path) as theatre, theatre.device("force", ForceSensor).active() as sensor:
        assert sensor.name == "device.force"
        assert sensor.read_force_N() == pytest.approx(3.0)


def test_nothing_is_connected_before_it_is_requested(path: Path) -> None:
    theatre = Theatre.from_file(path)
    assert theatre.arms["left"].state is Lifecycle.DISCONNECTED
    assert theatre.arms["left"] is theatre.arms["left"]
    assert sorted(theatre.arms) == ["left", "right"]
    theatre.connect()
    theatre.connect()
    assert {arm.state for arm in theatre.arms.values()} == {Lifecycle.CONFIGURED}
    theatre.close()


def test_a_missing_device_is_an_error_that_lists_the_existing_ones(path: Path) -> None:
    theatre = Theatre.from_file(path)
    with pytest.raises(NotInTheatre, match=r"^DEV-007: theatre lab has no tracker: it has robot.left"):
        _ = theatre.tracker
    with pytest.raises(NotInTheatre, match=r"no robot\.third.*Add its table"):
        _ = theatre.arms["third"]
    assert "third" not in theatre.arms
    with pytest.raises(NotInTheatre, match=r"no device\.torque"):
        theatre.device("torque", ForceSensor)
    with pytest.raises(NotInTheatre, match=r"no tracker, stereo"):
        theatre.require("tracker", "robot.left", "stereo")
    with pytest.raises(NotInTheatre, match="no calibration records"):
        _ = theatre.calibrations


def test_a_device_of_the_wrong_kind_is_refused(path: Path) -> None:
    with raises(
        WRONG_KIND, match=r"DEV-008: device\.force: driver force does not provide RobotArm: it lacks .*stop"
    ):
        Theatre.from_file(path).device("force", RobotArm)


def _leave_while_the_arms_are_active(path: Path, error: type[BaseException]) -> None:
    with open_theatre(path) as theatre:
        for arm in theatre.arms.values():
            arm.activate()
        raise error


def test_every_arm_is_stopped_before_any_device_is_closed(path: Path, installed: list[str]) -> None:
    with pytest.raises(ZeroDivisionError):
        _leave_while_the_arms_are_active(path, ZeroDivisionError)
    assert sorted(installed[:2]) == ["stop robot.left", "stop robot.right"]
    assert installed[2:] == ["close robot.left", "close robot.right", "close device.force"]


def test_a_stop_also_waits_for_an_arm_that_another_stop_has_put_into_hold(
    path: Path, installed: list[str]
) -> None:
    with open_theatre(path) as theatre:
        theatre.arms["left"].activate()
        theatre.stop()
        theatre.stop()
    assert installed.count("stop robot.left") == 3  # the last by leaving


def test_an_error_while_closing_one_device_does_not_keep_the_others_open(
    path: Path, installed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(arm: Arm, *_: Any) -> None:
        raise OSError("gone")

    monkeypatch.setattr(Arm, "close", fail)
    monkeypatch.setattr(Arm, "stop", fail)
    with open_theatre(path) as theatre:
        theatre.arms["left"].activate()
        assert sorted(theatre.stop()) == [
            f"robot.{name} may not be at rest, the stop failed: OSError: gone" for name in ("left", "right")
        ]
    assert installed == ["close device.force"]


def test_a_second_interrupt_does_not_keep_devices_open(
    path: Path, installed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Arm, "stop", lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        _leave_while_the_arms_are_active(path, KeyboardInterrupt)
    assert installed == ["close robot.left", "close robot.right", "close device.force"]


def test_a_missing_device_raises_the_drivers_error_and_the_others_are_closed(
    path: Path, installed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ScaledForceSensor, "plugged_in", False)
    with pytest.raises(ConnectError, match="no reply"), open_theatre(path):
        pass
    closed = [one for one in installed if one.startswith("close")]
    assert closed == ["close robot.left", "close robot.right", "close device.force"]


@pytest.mark.parametrize("cut", range(1, len(FILE) - 1, 7))
def test_a_truncated_theatre_file_is_refused_or_lacks_the_missing_devices(path: Path, cut: int) -> None:
    path.write_text(FILE[:cut])
    try:
        theatre = Theatre.from_file(path)
    except BadTheatreFile:
        return
    assert len(theatre.file.devices) < 3


def test_device_configs_have_the_names_of_their_tables_and_the_folder_of_the_file(path: Path) -> None:
    devices = Theatre.from_file(path).file.devices
    assert sorted(devices) == ["device.force", "robot.left", "robot.right"]
    assert {config.folder for config in devices.values()} == {path.parent}


def test_a_closed_theatre_provides_neither_devices_nor_clock(path: Path) -> None:
    with Theatre.from_file(path) as theatre:
        pass
    with raises(THEATRE_CLOSED, match="DEV-010"):
        theatre.device("force", ScaledForceSensor)
    with raises(THEATRE_CLOSED, match="DEV-010"):
        theatre.clock.now_s()


def test_a_theatre_can_be_made_from_parsed_content() -> None:
    content = {"theatre": "lab", "device": {"force": {"driver": "force", "endpoint": "tcp://127.0.0.1:1"}}}
    theatre = Theatre(parse_theatre(content), HostClock())
    assert theatre.device("force", ScaledForceSensor).state is Lifecycle.DISCONNECTED


@pytest.mark.parametrize(
    "given",
    [{"scene": 7}, {"seed": 1.5}, {"seed": True}, {"seed": -1}, {"timeout_s": -1.0}, {"timeout_s": "soon"}],
)
def test_a_wrong_argument_of_a_simulated_theatre_is_refused_before_it_starts(given: dict[str, Any]) -> None:
    with raises(WrongArgument), simulated_theatre(**given):
        raise AssertionError("it has started")


def test_a_theatre_without_with_says_how_it_is_opened() -> None:
    with pytest.raises(AttributeError, match=r"with simulated_theatre\(...\) as opened: opened.tracker"):
        simulated_theatre("mini").tracker  # type: ignore[attr-defined]  # noqa: B018 - as people write it
