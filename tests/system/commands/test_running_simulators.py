"""Simulators in the background: one command starts, names, or ends one, and none is left behind."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from user_commands import Commands

from ronna_hw.errors import EXIT_REFUSED, EXIT_USAGE
from sim.errors import NotRunning
from sim.world import running
from sim.world.running import (
    RunningSimulator,
    find_running,
    list_running,
    register_folder,
    variables_of,
)

CONTROL = "tcp://127.0.0.1:4?token=it's"
THEATRE = {
    "device": "theatre",
    "endpoints": {
        "polaris": "serial:///dev/pts/9",
        "kuka": {"rsi": "udp://127.0.0.1:1", "eki": "tcp://127.0.0.1:2", "eki_project": "tcp://127.0.0.1:3"},
        "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
        "control": CONTROL,
        "clock": "shm:///clock",
    },
    "file": "/lab/my cell/theatre.toml",
}


@pytest.fixture(autouse=True)
def own_register(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "ronna-sim"


@pytest.fixture
def sim(commands: Commands, own_register: Path) -> Iterator[Commands]:
    commands.environment["XDG_RUNTIME_DIR"] = str(own_register.parent)
    yield commands
    for one in list_running():
        commands.run("ronna-sim", "stop", str(one.pid))


def test_a_detached_simulator_outlives_its_command_gives_its_variables_and_is_stopped_whole(
    sim: Commands, own_register: Path
) -> None:
    started = sim.run("ronna-sim", "polaris", "--detach")
    assert started.returncode == 0, started.stderr
    assert started.stdout.startswith("READY {")
    assert "ronna-sim stop polaris" in started.stderr
    lines = sim.run("ronna-sim", "env", "polaris").stdout
    shown = subprocess.run(
        ("sh", "-c", f'{lines}\necho "$LINE"; ls -l "${{LINE#serial://}}"'),
        capture_output=True,
        text=True,
        check=True,
    )
    assert shown.stdout.startswith("serial:///dev/pts/")
    assert sim.run("ronna-sim", "stop").returncode == 0
    assert sim.await_no_survivors() == []
    assert list(own_register.iterdir()) == []
    assert sim.run("ronna-sim", "env").returncode == EXIT_REFUSED


def test_a_detached_simulator_that_cannot_start_says_why_with_its_own_exit_code(sim: Commands) -> None:
    refused = sim.run("ronna-sim", "polaris", "--detach", "--scene", "nope")
    assert refused.returncode == EXIT_USAGE
    assert refused.stderr.startswith("SIM-001: ")
    assert refused.stdout == ""
    assert sim.await_no_survivors() == []


def test_a_simulator_whose_command_is_killed_before_it_is_ready_does_not_stay(sim: Commands) -> None:
    starting = sim.start("ronna-sim", "polaris", "--detach")
    while len(sim.survivors()) < 2:
        time.sleep(0.005)  # the child tells nobody that it exists
    starting.kill()
    assert sim.await_no_survivors() == []


def test_every_endpoint_of_a_theatre_is_a_quoted_variable() -> None:
    cell = RunningSimulator("my cell", 1, True, Path("/lab/my cell"), THEATRE)
    said = subprocess.run(
        (
            "sh",
            "-c",
            "\n".join(cell.shell_lines()) + '\nprintf "%s\\n" "$RONNA_CONTROL" "$THEATRE" "$LEFT" "$STREAM"',
        ),
        capture_output=True,
        text=True,
        check=True,
    )
    assert said.stdout.splitlines() == [CONTROL, THEATRE["file"], "127.77.0.1", "udp://127.0.0.1:1"]
    assert variables_of(THEATRE)["CONTROLLER"] == "tcp://127.0.0.1:3"


def test_a_theatre_is_found_by_name_folder_or_file_and_two_of_a_name_are_told_apart(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cells = [
        RunningSimulator(
            "cell", number, True, tmp_path / place, {"file": str(tmp_path / place / "theatre.toml")}
        )
        for number, place in ((1, "a/cell"), (2, "b/cell"))
    ]
    monkeypatch.setattr(running, "list_running", lambda: tuple(cells))
    for named in (tmp_path / "b/cell", tmp_path / "b/cell/theatre.toml", 2):
        assert find_running(str(named)) is cells[1]
    with pytest.raises(NotRunning, match=r"several .*'cell'.*pid 1.*pid 2"):
        find_running("cell")
    with pytest.raises(NotRunning, match="no simulator 'other'"):
        find_running("other")


def test_the_entry_of_a_killed_simulator_is_removed(own_register: Path) -> None:
    (register_folder() / "7.json").write_text("{}")
    assert list_running() == ()
    assert list(own_register.iterdir()) == []


def test_a_register_that_others_can_read_is_not_used(own_register: Path) -> None:
    own_register.mkdir()
    os.chmod(own_register, 0o755)
    with pytest.raises(PermissionError, match="mode 700"):
        register_folder()
