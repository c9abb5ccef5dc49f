"""Parameters of single devices, passed on by the whole theatre."""

from pathlib import Path

import pytest

from ronna_hw.errors import EXIT_USAGE, ConfigurationError
from sim.errors import BadDeviceParameter
from sim.theatre.device_parameters import parameters_by_device
from sim.theatre.launch import Theatre
from sim.world.scene.named_scenes import named_scene


def test_settings_are_grouped_by_device() -> None:
    given = ("robot.lag_s=0.03", "tracker.line_after_close=kept", "robot.timeout_counting=total")
    assert parameters_by_device(given) == {
        "kuka": ("lag_s=0.03", "timeout_counting=total"),
        "polaris": ("line_after_close=kept",),
    }
    assert parameters_by_device(()) == {}


@pytest.mark.parametrize("setting", ["lag_s=0.03", "camera.gain=2", "robot.lag_s", "robot", "=1", ""])
def test_a_setting_without_a_known_device_is_refused_with_the_expected_syntax(setting: str) -> None:
    with pytest.raises(BadDeviceParameter, match=r"SIM-010: .*--set robot.NAME=VALUE") as caught:
        parameters_by_device((setting,))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("setting", "code"),
    [("robot.lagg=3", "KRC-003"), ("robot.lag_s=x", "KRC-003"), ("tracker.x=1", "PSU-001")],
)
def test_an_invalid_device_parameter_is_refused_before_the_device_starts(setting: str, code: str) -> None:
    with pytest.raises(ConfigurationError, match=code) as caught:
        parameters_by_device((setting,))
    assert caught.value.exit_code == EXIT_USAGE


def test_each_device_is_started_with_its_own_parameters(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started: dict[str, list[str]] = {}

    class Enough(Exception):
        pass

    def started_without_waiting(name: str, arguments: list[str], **_others: object) -> None:
        started[name] = arguments
        if len(started) == 3:
            raise Enough

    monkeypatch.setattr("sim.theatre.launch.ChildProcess", started_without_waiting)
    with pytest.raises(Enough):
        Theatre(
            named_scene("mini", seed=1),
            tmp_path,
            paced=False,
            cycle_ms=12,
            parameters=parameters_by_device(("robot.lag_s=0.03", "robot.dead_time_cycles=3")),
        )
    robot = started["ronna-sim kuka"]
    assert robot[robot.index("--cycle-ms") + 1] == "12"
    assert robot[-2:] == ["--set=lag_s=0.03", "--set=dead_time_cycles=3"]
    assert not any("--set" in word for word in (*started["ronna-sim polaris"], *started["ronna-sim basler"]))
