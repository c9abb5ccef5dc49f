"""Parameters of single devices, passed on by the whole theatre."""

from pathlib import Path

import pytest

from sim.theatre.launch import Theatre, parameters_by_device
from sim.world.scene.named_scenes import named_scene


def test_settings_are_grouped_by_device() -> None:
    given = ("robot.lag_s=0.03", "tracker.line_after_close=kept", "robot.timeout_counting=total")
    assert parameters_by_device(given) == {
        "kuka": ("lag_s=0.03", "timeout_counting=total"),
        "polaris": ("line_after_close=kept",),
    }
    assert parameters_by_device(()) == {}


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
