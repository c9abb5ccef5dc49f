"""A theatre's start: the world it may continue, and parameters by device."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

import pytest
from coded_errors import raises
from user_commands import in_this_process, one_error

from drivers.ndi_polaris.options import PolarisOptions
from drivers.ndi_polaris.shipped_tools import find_definition
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.bounded_input import InputRefused, read_toml
from ronna_hw.config import read_theatre_file
from ronna_hw.errors import EXIT_FAILED, EXIT_USAGE
from ronna_hw.wire.kuka_context import OWN_CONTEXT
from sim.cli import app as ronna_sim
from sim.errors import BAD_DEVICE_PARAMETER
from sim.theatre.arm_controllers import check_cycle
from sim.theatre.launch import THEATRE_FILE, LaunchedTheatre, parameters_by_device
from sim.theatre.theatre_file import write_theatre_file
from sim.universal_robots.errors import UNKNOWN_PARAMETER
from sim.world.saved_world import WORLD_FILE, read_saved_world
from sim.world.scene.assistant import add_assistant
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene
from sim.world.truth import SCENE_FILE

REFUSED_LATER = ("--set", "robot.tea=1")  # so that no theatre is started


@pytest.fixture
def left(tmp_path: Path) -> Path:
    """The folder of a theatre that was left."""
    (tmp_path / SCENE_FILE).write_text(draw_scene("mini", seed=4).model_dump_json(by_alias=True))
    for name in (WORLD_FILE, THEATRE_FILE):
        (tmp_path / name).touch()  # read only once the options are accepted
    return tmp_path


def test_a_model_of_an_assistant_that_is_not_asked_for_is_refused(tmp_path: Path) -> None:
    given = ("--out", tmp_path, "--assistant-arm", "ur5e", *REFUSED_LATER)
    done = in_this_process(ronna_sim, "theatre", *given)
    assert done.returncode == EXIT_USAGE
    assert "CLI-001: --assistant-arm ur5e requires --dual" in done.stderr
    assert "requires" not in in_this_process(ronna_sim, "theatre", *given, "--dual").stderr


def _refusal(folder: Path, *options: str) -> str:
    done = in_this_process(ronna_sim, "theatre", *options, "--out", folder, "--continue", *REFUSED_LATER)
    assert done.returncode == EXIT_USAGE
    return " ".join(one_error(done.stderr))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scene", "default", "--seed", "4"), "cannot be changed; expected mini, got default"),
        (("--scene", "mini", "--seed", "5"), "cannot be changed; expected 4, got 5"),
        (("--seed", "5"), "the seed of the world left in"),
        (("--markers", "6"), "the markers of the world left in"),
        (("--targets", "4"), "the targets of the world left in"),
    ],
)
def test_a_theatre_is_not_continued_with_another_scene_seed_or_head(
    left: Path, options: tuple[str, ...], said: str
) -> None:
    assert said in _refusal(left, *options)


@pytest.mark.parametrize(
    "options", [(), ("--scene", "mini", "--seed", "4"), ("--seed", "4"), ("--markers", "3")]
)
def test_a_theatre_is_continued_with_its_own_scene_and_seed_or_without_any(
    left: Path, options: tuple[str, ...]
) -> None:
    assert "unknown parameter 'tea'" in _refusal(left, *options)


@pytest.mark.parametrize("lost", [SCENE_FILE, WORLD_FILE, THEATRE_FILE])
def test_a_world_that_is_lost_is_not_continued_as_a_new_one(left: Path, lost: str) -> None:
    (left / lost).unlink()
    done = in_this_process(ronna_sim, "theatre", "--out", left, "--continue")
    (said,) = one_error(done.stderr)
    assert done.returncode == EXIT_FAILED
    assert f"{lost} missing" in said
    assert "without --continue" in said


@pytest.fixture
def without_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Theatres whose devices are addresses only."""
    rsi = {"rsi": "udp://127.0.0.1:1", "eki_project": "tcp://127.0.0.1:1"}
    endpoints = {
        "polaris": "tcp://127.0.0.1:1",
        "kuka": rsi,
        "basler": {"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"},
    }
    monkeypatch.setattr(LaunchedTheatre, "_fork_devices", lambda *_: None)
    monkeypatch.setattr(LaunchedTheatre, "_await_devices", lambda *_: endpoints)


@pytest.mark.usefixtures("without_devices")
def test_the_folder_of_a_theatre_may_be_moved_with_the_definitions_of_its_tools(tmp_path: Path) -> None:
    theatre = LaunchedTheatre(draw_scene("mini", seed=1), tmp_path / "before", paced=False)
    theatre.close()
    moved = theatre.folder.rename(tmp_path / "moved")
    config = read_theatre_file(moved / THEATRE_FILE).tracker
    tools = PolarisOptions.model_validate(config.options).tools
    assert tools
    for tool in tools:
        assert find_definition(Path(tool.rom), config.folder).parent == moved


@pytest.mark.usefixtures("without_devices")
def test_a_theatre_killed_before_anything_happened_continues_as_the_same_one(tmp_path: Path) -> None:
    scene = draw_scene("mini", seed=1)
    killed = LaunchedTheatre(scene, tmp_path, paced=False)
    first = read_toml(killed.file, InputRefused)
    first["calibration"]["stereo_head"]["created"] -= timedelta(days=1)  # as if it had begun yesterday
    write_theatre_file(first, killed.file)
    again = LaunchedTheatre(scene, tmp_path, paced=False, saved=read_saved_world(tmp_path))
    second = read_toml(again.file, InputRefused)
    killed.close()
    again.close()
    assert second["identity"] == first["identity"]
    made = {record["created"] for record in second["calibration"].values()}
    assert made == {first["calibration"]["stereo_head"]["created"]}


def test_settings_are_grouped_by_device() -> None:
    given = ("robot.lag_s=0.03", "tracker.line_after_close=kept", "robot.timeout_counting=total")
    assert parameters_by_device(given, draw_scene("mini")) == {
        "kuka": ("lag_s=0.03", "timeout_counting=total"),
        "polaris": ("line_after_close=kept",),
    }
    assert parameters_by_device((), draw_scene("mini")) == {}


@pytest.fixture(scope="module")
def mixed() -> Scene:
    """A scene whose master is a KR6 and whose assistant a UR5e."""
    scene = add_assistant(draw_scene("mini"))
    assert scene.assistant is not None
    arm = draw_scene("mini", arm=ArmChoice.UR5E).arm
    return scene.model_copy(update={"assistant": scene.assistant.model_copy(update={"arm": arm})})


def test_settings_of_two_arms_are_told_apart_and_checked_by_the_controller_of_each(mixed: Scene) -> None:
    given = ("robot.lag_s=0.03", "assistant.drive_delay_cycles=2")
    assert parameters_by_device(given, mixed) == {
        "kuka": ("lag_s=0.03",),
        "assistant": ("drive_delay_cycles=2",),
    }
    with raises(UNKNOWN_PARAMETER, match="lag_s"):
        parameters_by_device(("assistant.lag_s=0.03",), mixed)
    with raises(BAD_DEVICE_PARAMETER):
        parameters_by_device(("assistant.drive_delay_cycles=2",), draw_scene("mini"))


def test_a_cycle_that_one_of_the_arms_does_not_have_is_refused_with_the_arms_role(mixed: Scene) -> None:
    check_cycle(draw_scene("mini"), 12)
    check_cycle(mixed, None)
    with raises(BAD_DEVICE_PARAMETER, match="the assistant is a ur5e"):
        check_cycle(mixed, 12)


class Forked:
    """A device that was forked, and whether it was ended."""

    ended = False

    def terminate(self) -> None:
        self.ended = True


def test_each_device_is_forked_with_its_own_parameters_and_ended_if_another_cannot_be(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    started: dict[str, tuple[str, ...]] = {}
    forked = [Forked(), Forked()]
    scene = draw_scene("mini", seed=1)

    class Enough(Exception):
        pass

    def fork(_module: str, device: str, *arguments: str) -> Forked:
        started[device] = arguments
        if len(started) == 3:
            raise Enough
        return forked[len(started) - 1]

    monkeypatch.setattr("sim.theatre.launch.ForkedProcess", fork)
    with pytest.raises(Enough):
        LaunchedTheatre(
            scene,
            tmp_path,
            paced=False,
            cycle_ms=12,
            parameters=parameters_by_device(("robot.lag_s=0.03", "robot.dead_time_cycles=3"), scene),
        )
    robot = started["kuka"]
    assert robot[robot.index("--cycle-ms") + 1] == "12"
    assert robot[robot.index("--rsi-context") + 1] == str(OWN_CONTEXT)  # with the motor currents
    assert robot[-2:] == ("--set=lag_s=0.03", "--set=dead_time_cycles=3")
    assert not any("--set" in word for word in (*started["polaris"], *started["basler"]))
    assert [one.ended for one in forked] == [True, True]
