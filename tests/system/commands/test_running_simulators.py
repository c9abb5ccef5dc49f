"""Simulators in the background: one command starts, names, or ends one, and none is left behind."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from coded_errors import raises
from user_commands import Commands, in_this_process, one_error
from waiting import eventually

from ronna_hw.errors import EXIT_REFUSED, EXIT_USAGE
from sim.cli import app as ronna_sim
from sim.errors import NOT_RUNNING, RegisterNotOwn
from sim.world import running
from sim.world.running import (
    NO_VARIABLES,
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
    lines = in_this_process(ronna_sim, "env", "polaris").stdout
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
    assert in_this_process(ronna_sim, "env").returncode == EXIT_REFUSED


def test_a_detached_simulator_that_cannot_start_says_why_with_its_own_exit_code(sim: Commands) -> None:
    refused = sim.run("ronna-sim", "polaris", "--detach", "--scene", "nope")
    assert refused.returncode == EXIT_USAGE
    assert refused.stderr.startswith("SIM-001: ")
    assert refused.stdout == ""
    assert sim.await_no_survivors() == []


def test_a_simulator_whose_command_is_killed_before_it_is_ready_does_not_stay(sim: Commands) -> None:
    starting = sim.start("ronna-sim", "polaris", "--detach")
    eventually(lambda: len(sim.survivors()) >= 2)  # the child tells nobody that it exists
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
    assert variables_of({"endpoints": {"ur": {"rtde": "tcp://127.0.0.9:30004"}}}) == {"ARM": "127.0.0.9"}


@pytest.mark.parametrize(
    ("assistant", "named"),
    [
        ({"rtde": "tcp://127.0.0.9:30004"}, {"ASSISTANT_ARM": "127.0.0.9"}),
        (
            {"rsi": "udp://127.0.0.1:1", "eki_project": "tcp://127.0.0.1:3"},
            {"ASSISTANT_STREAM": "udp://127.0.0.1:1", "ASSISTANT_CONTROLLER": "tcp://127.0.0.1:3"},
        ),
    ],
)
def test_the_assistant_of_a_theatre_has_variables_of_its_own(
    assistant: dict[str, str], named: dict[str, str]
) -> None:
    ready = {"endpoints": {"ur": {"rtde": "tcp://127.0.0.8:30004"}, "assistant": assistant}}
    assert variables_of(ready) == {"ARM": "127.0.0.8", **named}


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
    with raises(NOT_RUNNING, match=r"several .*'cell'.*pid 1.*pid 2"):
        find_running("cell")
    with raises(NOT_RUNNING, match="no simulator 'other'"):
        find_running("other")
    (tmp_path / "b").mkdir()
    monkeypatch.chdir(tmp_path / "b")
    assert find_running("cell") is cells[1]  # that of this folder


def test_the_entry_of_a_killed_simulator_is_removed(own_register: Path) -> None:
    (register_folder() / "7.json").write_text("{}")
    assert list_running() == ()
    assert list(own_register.iterdir()) == []


def test_a_register_that_others_can_read_is_not_used(own_register: Path) -> None:
    own_register.mkdir()
    os.chmod(own_register, 0o755)
    with pytest.raises(RegisterNotOwn, match="mode 700") as refused:
        register_folder()
    assert "XDG_RUNTIME_DIR" in refused.value.advice


@pytest.fixture
def held(own_register: Path) -> Iterator[Callable[[int, object], Path]]:
    """Entries held by a living process, this one."""
    open_files = []

    def hold(number: int, entry: object) -> Path:
        path = register_folder() / f"{number}.json"
        path.write_text(json.dumps(entry))
        file = path.open("rb")
        fcntl.flock(file, fcntl.LOCK_EX)
        open_files.append(file)
        return path

    yield hold
    for file in open_files:
        file.close()


def entry(name: str, ready: object) -> dict[str, object]:
    return {"name": name, "in_background": False, "folder": None, "ready": ready}


def test_what_is_no_entry_is_skipped_and_named(
    held: Callable[[int, object], Path], own_register: Path
) -> None:
    held(1, entry("polaris", {"device": "polaris", "endpoint": "serial:///dev/pts/9"}))
    bad = [
        held(number, content)
        for number, content in (
            (2, entry("no device", {})),
            (3, entry("a list", {"device": "kuka", "endpoints": []})),
            (4, entry("a number", {"device": "kuka", "endpoint": 4})),
            (5, []),
        )
    ]
    os.mkfifo(pipe := own_register / "9.json")
    listed = in_this_process(ronna_sim, "list", "--json")
    assert [one["name"] for one in json.loads(listed.stdout)["running"]] == ["polaris"]
    assert all(path.name in listed.stderr for path in (*bad, pipe))
    assert len(list(own_register.iterdir())) == 6


def test_after_a_cell_that_does_not_run_the_eval_fails_and_no_variable_of_another_is_left() -> None:
    refused = in_this_process(ronna_sim, "env", "theatre")
    assert refused.returncode == EXIT_REFUSED
    script = 'RONNA_CONTROL=old; eval "$1" && echo used; echo "${RONNA_CONTROL-none}"'
    shown = subprocess.run(
        ("sh", "-c", script, "sh", refused.stdout), capture_output=True, text=True, check=True
    )
    assert shown.stdout == "none\n"
    assert set(variables_of(THEATRE)) <= set(NO_VARIABLES.removesuffix("; false").split())


def test_the_theatre_of_a_run_is_registered_as_that_run(own_register: Path) -> None:
    code = (
        "import sys; from sim.world.running import *; "
        f"register({THEATRE!r}, in_background=False, run='2026-case'); print(list_running()[0].name)"
    )
    shown = subprocess.run((sys.executable, "-c", code), capture_output=True, text=True, check=True)
    assert shown.stdout == "2026-case\n"


def test_a_theatre_is_not_started_in_a_folder_whose_name_acts_on_a_terminal(tmp_path: Path) -> None:
    refused = in_this_process(ronna_sim, "theatre", "--detach", "--out", tmp_path / "a\n\x1b[2Jb")
    assert one_error(refused.stderr)[0].startswith("CLI-005")
    assert "\x1b[2J" not in refused.stderr
